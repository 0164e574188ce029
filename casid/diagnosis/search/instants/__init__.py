"""Changes at an instant: when they set in and end, and how sure that is."""
