"""Figures of results, in Plotly."""
