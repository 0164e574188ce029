"""Causes that a record cannot separate or detect, and experiments that can.

`recommendation.recommend` says what to do next. Causes that are tied have experiments planned
(`next_experiment`), whose records are predicted (`planned_records`) from the motion that was fitted
(`fitted_motion`). `isolability` and `undetectable` are what this record does not show.
"""
