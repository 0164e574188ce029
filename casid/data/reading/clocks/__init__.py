"""Clocks of records: time stamps as seconds, even clocks, absent rows, several in one file."""
