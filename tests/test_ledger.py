"""The energy law: every term of every implicit scheme's ledger, and energy that never rises."""
import dense
import numpy as np
import pytest
from mpi4py import MPI

from petscib import energy
from petscib.schemes import SCHEMES, create

IMPLICIT = [name for name in SCHEMES if name != "ep"]
TOLERANCE = 1e-8  # of the largest energy so far, with solvers to 1e-11
TIGHT = {f"{solver}_ksp_rtol": 1e-11 for solver in ("momentum", "poisson", "coupled")}
MOVING = {"shear": 1.0, "extensional": 0.5, "poiseuille": 1.0}


def run(scheme, steps, dt_over_h=1.0, flow="rest", **values):
    """Yield problem, Step and Ledger of each step on 32 x 32 (ellipse 0.2 x 0.5)."""
    options = {"flow": flow, "shear_rate": MOVING.get(flow), **values}
    if "vesicles" not in values:
        options["axes"] = "0.2,0.5"
    problem, state = dense.problem(**options)
    dt = dt_over_h * min(problem.grid.dx, problem.grid.dy)
    with dense.petsc_options(**TIGHT):
        stepper = create(scheme, problem)
        for _ in range(steps):
            step = stepper.step(state, dt)
            yield problem, step, energy.balance(problem, step)
            state = step.end
        stepper.destroy()


def largest_defect(steps):
    """Largest defect of the ledger relative to the largest energy so far."""
    largest = defect = 0.0
    for problem, step, ledger in steps:
        if not largest:
            largest = energy.measure(problem, step.start).total
        largest = max(largest, energy.measure(problem, step.end).total)
        defect = max(defect, abs(ledger.defect) / largest)
    return defect


@pytest.mark.parametrize("scheme", IMPLICIT)
@pytest.mark.parametrize("dt_over_h", [0.25, 1.0, 4.0])
@pytest.mark.parametrize("sigma0", [1e5, 1e9])
@pytest.mark.parametrize("stretch, flow", [("evolve", "rest"), ("recompute", "shear")])
def test_ledger_balances(scheme, dt_over_h, sigma0, stretch, flow):
    steps = run(scheme, 3, dt_over_h, flow, sigma0=sigma0, stretch=stretch)
    assert largest_defect(steps) <= TOLERANCE


@pytest.mark.parametrize("scheme", IMPLICIT)
@pytest.mark.parametrize("flow, stretch, cells", [
    ("extensional", "recompute", 28), ("poiseuille", "evolve", 32), ("shear", "evolve", 32),
    ("rest", "recompute", 40)])
def test_ledger_balances_with_other_walls_and_cells(scheme, flow, stretch, cells):
    """Normal flow through walls included, oblong cells, other fluid, an elastic membrane."""
    steps = run(scheme, 3, 1.0, flow, stretch=stretch, stag_grid_y=cells, rho=2.5, mu=0.4,
                sigma0=300, rest_length=0.9, angle=20)
    assert largest_defect(steps) <= TOLERANCE


@pytest.mark.parametrize("scheme", IMPLICIT)
def test_ledger_without_a_membrane(scheme):
    assert largest_defect(run(scheme, 3, flow="poiseuille", vesicles=0)) <= TOLERANCE


@pytest.mark.parallel(3)
@pytest.mark.parametrize("scheme", IMPLICIT)
def test_ledger_on_several_ranks_balances_and_is_equal_on_all(scheme):
    steps = list(run(scheme, 2, flow="extensional"))
    assert largest_defect(steps) <= TOLERANCE
    for _, _, ledger in steps:
        assert len(set(MPI.COMM_WORLD.allgather(repr(ledger)))) == 1


# ---------------------------------------------------------------- the terms


@pytest.mark.parametrize("scheme", IMPLICIT)
def test_terms_have_their_signs(scheme):
    for _, _, ledger in run(scheme, 3, stretch="evolve", rest_length=0.9, sigma0=100):
        assert ledger.viscous < 0
        assert max(ledger.inertia, ledger.projection, ledger.tension, ledger.bending) <= 0
        euler = scheme.endswith("be")
        assert (ledger.inertia < 0) == (ledger.tension < 0) == (ledger.bending < 0) == euler
        assert (ledger.projection < 0) == (scheme in ("mbe", "mcn"))
        assert ledger.wall_power == 0


@pytest.mark.parametrize("scheme", IMPLICIT)
def test_no_reset_for_evolved_stretching_without_bending(scheme):
    for problem, step, ledger in run(scheme, 3, stretch="evolve", bending=0, rest_length=0.9,
                                     sigma0=100):
        total = energy.measure(problem, step.start).total
        assert abs(ledger.change) >= 1e-4 * total and abs(ledger.reset) <= 1e-12 * total
        assert ledger.bending == 0


def test_terms_of_mbe_by_their_formulas():
    """As in DESIGN.md, with sums over faces and markers written out."""
    for problem, step, ledger in run("mbe", 2, stretch="evolve", rest_length=0.9, rho=2.0, mu=0.3,
                                     sigma0=100, stag_grid_y=24, kink_correction="false",
                                     conserve_area="false"):
        grid, dt = problem.grid, step.dt
        star, old = (dense.velocity(grid, v) for v in (step.stage, step.start.velocity))
        new = dense.velocity(grid, step.end.velocity)
        area, ds = grid.dx * grid.dy, problem.membranes.curves.ds[0]
        markers = step.start.markers
        at_markers = (dense.interpolation(grid, problem.kernel, markers) @ star).reshape(-1, 2)
        edges = markers - np.roll(markers, 1, axis=0)
        tangent = edges / np.hypot(*edges.T)[:, None]
        rate = ((at_markers - np.roll(at_markers, 1, axis=0)) / ds * tangent).sum(axis=1)
        bent = (np.roll(at_markers, -1, axis=0) - 2 * at_markers
                + np.roll(at_markers, 1, axis=0)) / ds**2
        expected = {
            "inertia": -1.0 * area * ((star - old) ** 2).sum(),
            "projection": -1.0 * area * ((star - new) ** 2).sum(),  # dt grad phi
            "viscous": 0.3 * dt * area * star @ dense.laplacian(grid) @ star,
            "tension": -50 * dt**2 * ds * (rate**2).sum(),
            "bending": -0.005 * dt**2 * ds * (bent**2).sum(),
        }
        for name, value in expected.items():
            assert getattr(ledger, name) == pytest.approx(value, rel=1e-9), name


def test_energies_by_their_formulas():
    """Half of a wall face's cell lies in the box, so it counts half."""
    problem, state = dense.problem(flow="extensional", shear_rate=0.5, axes="0.2,0.5", rho=2.0,
                                   rest_length=0.9, sigma0=100)
    measured, grid = energy.measure(problem, state), problem.grid
    ds = problem.membranes.curves.ds[0]
    weights = np.where(dense.inner_faces(grid), 1.0, 0.5) * grid.dx * grid.dy
    velocity = dense.velocity(grid, state.velocity)
    assert measured.kinetic == pytest.approx(1.0 * (weights * velocity**2).sum(), rel=1e-12)
    stretch = problem.membranes.curves.stretching(state.markers)
    assert measured.tension == pytest.approx(50 * ds * ((stretch - 0.9) ** 2).sum(), rel=1e-12)
    fourth = dense.fourth_difference(len(state.markers), ds)
    X = state.markers.ravel()
    assert measured.bending == pytest.approx(0.005 * ds * X @ fourth @ X, rel=1e-9)
    assert measured.total == measured.kinetic + measured.tension + measured.bending


# ---------------------------------------------------------------- stability


@pytest.mark.parametrize("scheme", [name for name in ("mbe", "be") if name in SCHEMES])
def test_energy_never_rises_at_huge_time_steps(scheme):
    """Evolved stretching, no bending, dt = 100 h."""
    energies = []
    for problem, step, _ in run(scheme, 60, 100.0, stretch="evolve", bending=0, rest_length=0.9,
                                sigma0=100):
        energies.append(energy.measure(problem, step.start).total)
    energies = np.array(energies)
    assert energies[0] > 0.1
    assert (np.diff(energies) <= TOLERANCE * energies[0]).all()
    assert energies[-1] < energies[0]
