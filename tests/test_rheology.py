"""The resistance to being sheared."""
import dense
import numpy as np
import pytest

from petscib.rheology import effective_viscosity

MU, RATE = 0.7, 1.6
CHANNEL = dict(flow="shear", shear_rate=RATE, periodic="x", vesicles=0, mu=MU,
               domain="-1,2,-1,1", stag_grid_x=12, stag_grid_y=10)


def set_u(problem, velocity, function):
    grid = problem.grid
    x, y = grid.u_points()
    values = np.zeros(len(dense.velocity_numbers(grid)))
    values[: grid.u_index.size] = np.broadcast_to(function(x, y), grid.u_index.shape).ravel()
    dense.set_velocity(grid, velocity, values)


@pytest.mark.parallel([1, 3])
def test_the_force_on_both_walls_by_hand():
    """The flow alone has mu; layers of other slopes at the walls have their mean."""
    problem, state = dense.problem(**CHANNEL)
    assert effective_viscosity(problem, state.velocity) == pytest.approx(MU, rel=1e-13)

    def layers(x, y):
        """The walls' velocities -RATE and RATE, and slopes that change along them."""
        below = -RATE + (5.0 + np.cos(2 * np.pi * x / 3)) * (y + 1)
        above = RATE - (2.0 + np.sin(2 * np.pi * x / 3)) * (1 - y)
        return np.where(y < 0, below, above)

    set_u(problem, state.velocity, layers)
    # stress mu du/dy, its mean over both walls (5 + 2) / 2, over the shear rate
    assert effective_viscosity(problem, state.velocity) == pytest.approx(
        MU * 3.5 / RATE, rel=1e-12)


@pytest.mark.parametrize("change", [
    dict(flow="rest"), dict(flow="cavity"), dict(periodic="none"), dict(shear_rate=0.0),
    dict(flow="rest", periodic="xy")])
def test_it_means_nothing_elsewhere(change):
    problem, state = dense.problem(**{**CHANNEL, **change})
    assert effective_viscosity(problem, state.velocity) is None
