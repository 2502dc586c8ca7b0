"""Linear solvers: momentum, pressure Poisson, coupled, and their preconditioners."""
