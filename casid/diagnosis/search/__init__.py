"""The search for causes: candidates, joint refits and forward selection.

`findings.search_causes` has `selection` adopt causes one after another. For each, `rounds` scores
every effect, refits the best of them and ranks these; `residual_check` ends the search. The folders
are in the order of that work; each imports from those above it alone.

- `refits`: one effect refitted jointly with all parameters;
- `instants`: when a change sets in and ends;
- `comparison`: which candidate is best, and which raises the simulation error (`refusals`);
- `disturbance`: whether a random disturbance alone explains as much;
- `adoption`: the adopted causes, revised as a set;
- `noise_assumptions`: the search once more, beside a disturbance or under the sensors' noise alone.
"""
