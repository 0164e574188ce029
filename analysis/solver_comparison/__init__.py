"""Every available solver on the thesis's estimation problems: convergence, time, failures."""
