"""Every solver at hand on the thesis's estimation problems: who arrives, how fast, and why not."""
