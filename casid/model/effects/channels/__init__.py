"""Effects in what is recorded: sensors, commands and their actuators."""
