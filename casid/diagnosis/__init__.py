"""What the model is missing: evidence, search, verdict and advice.

`diagnose.diagnose` goes through them once: `evidence.baseline.fit_baseline` fits the model as it
is, `search.findings.search_causes` finds what it lacks, `verdict.judgement.judge` names and
measures that, and `advice.recommendation.recommend` says what to do next. The result is a
`diagnosis.Diagnosis`. Each of the four imports from those before it alone.
"""
