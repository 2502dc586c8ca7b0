"""Resistance of what is in the box to being sheared."""

import numpy as np


def effective_viscosity(problem, velocity):
    """Mean force along the lower and upper walls per length and shear rate.  Collective.

    It is mu without vesicles.  The velocity beside a wall gives its slope there, as the ghost value
    2 u_wall - u_inside does in the viscous operator.

    Parameters
    ----------
    problem : Problem
    velocity : PETSc.Vec

    Returns
    -------
    float or None
        None but for a shear flow between two walls, periodic along them: side walls would take
        part of the force.
    """
    grid, sides = problem.grid, problem.operators.sides
    if sides.flow != "shear" or not sides.shear_rate or grid.periodic != (True, False):
        return None
    u = grid.velocity_blocks(velocity)[0]
    rows, columns = grid.u_box
    slope = 0.0
    if rows.start == 0:
        slope += np.sum(u[0] - sides.tangential["bottom"][columns])
    if rows.stop == grid.n:
        slope += np.sum(sides.tangential["top"][columns] - u[-1])
    slope = grid.comm.tompi4py().allreduce(slope) / (grid.dy / 2) / (2 * grid.m)
    return float(problem.mu * slope / sides.shear_rate)
