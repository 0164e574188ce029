"""Moment equations and instruments: from cross moments to physical parameters and their errors."""
