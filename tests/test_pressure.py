"""Jumps of the pressure across membranes that keep their area."""
import dense
import numpy as np
import pytest

from petscib.membranes import geometry
from petscib.membranes.mobility import AreaProjector
from petscib.pressure import BARE, JUMP, PLACE, ShownPressure
from petscib.schemes import Controls, create

RADII, CENTERS = (0.5, 0.35), ((-0.7, 0.1), (0.6, -0.3))
FORCES = (3.0, -0.7)  # normal ones per length, inwards
TIGHT = {"poisson_ksp_rtol": 1e-12}


def two_circles():
    problem, state = dense.problem(
        domain="-1.5,1.5,-1,1", stag_grid_x=48, stag_grid_y=32, vesicles=2,
        axes=f"{RADII[0]},{RADII[0]}", vesicle_1_axes=f"{RADII[1]},{RADII[1]}",
        center="-0.7,0.1", vesicle_1_center="0.6,-0.3")
    curves = problem.membranes.curves
    # c N with N the gradient of the signed area pushes outwards where that is positive.
    signs = np.sign(geometry.signed_area(state.markers, curves))
    normal = AreaProjector(curves, state.markers).normal
    state.history[JUMP] = curves.spread(-np.array(FORCES)[: curves.count] * signs)[:, None] * normal
    state.history[PLACE] = state.markers
    state.pressure.set(0.25)
    return problem, state


def within(grid, distance):
    """Which cells lie in each circle, by more or less than a distance."""
    x, y = grid.p_points()
    return [np.hypot(x - center[0], y - center[1]) < radius + distance
            for radius, center in zip(RADII, CENTERS)]


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("fft", [True, False])
def test_circles_under_a_uniform_normal_force(fft):
    """p_in - p_out = f, flat but for the delta function's width."""
    problem, state = two_circles()
    grid, counts = problem.grid, np.diff(problem.curves.starts)
    with dense.petsc_options(**TIGHT):
        shown = ShownPressure(problem, fft)
        shown.state(state)
        written = shown.state(state)  # of which nothing is left from the first
    p = dense.pressure(grid, written.pressure).reshape(grid.p_index.shape)
    h = max(grid.dx, grid.dy)
    outside = ~np.logical_or(*within(grid, 3 * h))
    levels = []
    for inside in (*within(grid, -3 * h), outside):
        assert inside.sum() > 20 and np.ptp(p[inside]) < 2e-4
        levels.append(p[inside].mean())
    # The gradient of a polygon's area is that much less than the arc's normal.
    turn = 2 * np.pi / np.array(grid.comm.tompi4py().bcast(counts))
    jumps = np.array(levels[:2]) - levels[2]
    np.testing.assert_allclose(jumps, FORCES * np.sin(turn) / turn, rtol=1e-4)
    assert p.mean() == pytest.approx(0.25)  # the jumps' own mean is zero
    assert shown.trouble == ""
    # The bare pressure, from which a restart goes on, is kept.
    assert written.history[BARE] is state.pressure and BARE not in state.history
    assert np.ptp(dense.pressure(grid, state.pressure)) == 0.0
    shown.destroy()


@pytest.mark.parametrize("scheme", ["be", "cn", "gcn"])
def test_it_is_that_of_the_same_step_without_the_projector(scheme):
    """But for what the uniform normal force moves through the markers; in mbe it also moves u*."""
    found = []
    for keep in ("yes", "no"):
        problem, state = dense.problem(
            stag_grid_x=24, axes="0.3,0.5", angle=20, sigma0="1e4", flow="shear", shear_rate=1,
            conserve_area=keep)
        shown = ShownPressure(problem, True)
        with dense.petsc_options(**TIGHT):
            stepper = create(scheme, problem, Controls(fft=True))
            pressure = shown.state(stepper.step(state, 0.1).end).pressure
            found.append(dense.pressure(problem.grid, pressure))
            stepper.destroy()
        shown.destroy()
    assert abs(found[0] - found[1]).max() < 0.01 * np.ptp(found[1])


def test_without_jumps_it_is_the_state_itself():
    problem, state = two_circles()
    del state.history[PLACE]
    shown = ShownPressure(problem, True)
    assert shown.state(state) is state
    shown.destroy()


def test_jumps_that_cannot_be_solved_for_are_left_out():
    problem, state = two_circles()
    with dense.petsc_options(poisson_ksp_max_it="1", **TIGHT):
        shown = ShownPressure(problem, False)
        assert shown.state(state) is state
        assert "pressure Poisson solve failed" in shown.trouble
        del state.history[PLACE]
        shown.state(state)
        assert shown.trouble == ""
        shown.destroy()
