"""Linear systems: state space, discretisation, difference equations, Kalman filters."""
