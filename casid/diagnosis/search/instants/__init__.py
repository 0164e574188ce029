"""Changes at an instant: when they set in and end, how sure that is, and what they are called."""
