"""Evidence of a missing effect: is the residual more than noise, and which effects explain it?

`baseline.fit_baseline` comes first: it fits the model as it is, and weighs it by its noise. The
folders are in the order of its use of them; each imports from those above it alone.

- `recording_faults`: samples that a sensor or logger got wrong, which are left out;
- `scores`: score tests of every effect of the catalogue at once;
- `whitening`: the noise found at a fit, and the fit under it;
- `residual`: whatever the whitened residual still holds, as functions of what is known;
- `records`: what the records hold, and whether they can determine an answer.

`disturbances` and `gain_under_disturbance` treat forces that nobody recorded as random.
"""
