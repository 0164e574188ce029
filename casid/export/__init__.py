"""The fitted model taken away: problem file, CasADi, C, python-control, Modelica, FMU."""
