"""Misfit that no catalogued effect explains: where it acts and what it depends on.

`description.unexplained` tries every place: `missing_force` finds what is missing there, over time
(`smoothed_force`) and as a function of what is known.
"""
