"""Evidence of a missing effect: whitened residuals, score tests and signatures.

`baseline.fit_baseline` comes first: faulty samples are left out (`recording_faults`), records that
hold no answer are found (`sufficiency`), and the model is fitted and weighed by its noise
(`prewhitening`). The search then asks two kinds of tests:

- `score_tests` of every effect of the catalogue at once, by its columns (`signature_columns`);
- `residual_tests` of whatever is left: by forces along the path of the simulation (`signatures`,
  `linearised_path`) that follow functions of what is known (`candidate_functions`,
  `force_functions`), by `spectral_peaks`, `bursts`, `cogging_periods` and `disturbances`.
"""
