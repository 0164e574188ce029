"""The laboratory pendulum, made synthetically: stages, joint, noise models, validation, limits."""
