"""What an input that nobody measures costs, and what can be done about it."""
