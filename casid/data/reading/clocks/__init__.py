"""Clocks of records: time stamps as seconds, even clocks, absent rows, resampling."""
