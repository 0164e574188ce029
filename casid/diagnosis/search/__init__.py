"""The search for causes: candidates, joint refits and forward selection.

`findings.search_causes` has `selection` adopt causes one after another. For each, `rounds` scores
every effect and refits the best of them (`joint_refit`), `alternatives` ranks these, and
`simulation_errors` says which is refused (`refusals`). `refinement` then revises the causes as a
set, `disturbance` compares them with a random disturbance in their place, and `promotion` and
`reconsideration` judge their rivals in the complete model.

The other modules are each of one kind of effect, which a score alone does not place or judge:
`dead_times`, `lags_of_channels`, `soft_stops`, `swinging_parts`, `friction`, `instants`.
"""
