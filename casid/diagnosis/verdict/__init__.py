"""The verdict: causes with sizes and alternatives, the gain, and what remains.

`judgement.judge` makes it of the findings: `reported_causes` states what was adopted, `gain` the
errors before and after, `tested_remainder` what is left. Where that has no name, `unknown_cause`
and `unnamed_alternatives` stand for it; `not_accepted` says what was refused; `sentences` puts all
in words. `cause` and `remainder` hold the classes that a report shows.
"""
