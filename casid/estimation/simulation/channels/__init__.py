"""What sensors, actuators and clocks do to signals between and at their samples."""
