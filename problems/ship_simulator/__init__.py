"""The ship that `problems/ship_4dof.py` simulates: hull, equations, rudder, sensors, waves."""
