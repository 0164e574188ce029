"""The simulation error: a model integrated with its sensitivities, compared with records.

The folders are in the order in which they are used; each imports from those above it alone.

- `integration`: Runge-Kutta steps with their sensitivities, interpreted or as machine code;
- `channels`: what sensors, actuators and clocks do to signals;
- `records`: signals in the order and units of a model, gaps, states that are measured;
- `input_noise`: the noise of inputs and sensors that the records themselves show.

`simulation_error` is the criterion, `minimization` its minima, `fit` a fit with integration steps
as fine as it needs. Unstable models begin at `instability` and `short_horizons`.
"""
