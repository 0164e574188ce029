"""Figures that all results share: their look, their panels, records and estimates in them."""
