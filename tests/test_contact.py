"""What every law promises, and what contact, tethers, loads and lines do to a run."""
from types import SimpleNamespace

import dense
import numpy as np
import pytest
from runs import arrays, assert_same_run, comm, prepare, rows, run
from scipy.optimize import least_squares
from test_vesicles import GCN, TWO, largest_residual

from petscib import options
from petscib.driver import Driver
from petscib.membranes import laws, shapes
from petscib.membranes.curves import Curves
from petscib.membranes.membranes import Membranes
from petscib.schemes import Controls, create, registry

GRID = SimpleNamespace(domain=(-1.0, 1.0, -1.0, 1.0), periodic=(True, False), dx=0.05, dy=0.05)
SCHEMES = ["mbe", "mcn", "be", "cn", "gbe", "gcn"]
# Two that touch nearly, one of them across the periodic side and near a wall; a line; a plate.
PARTS = [
    shapes.ellipse((0.2, 0.3), (0.75, -0.5), 20, 40),
    shapes.ellipse((0.2, 0.3), (1.18, -0.66), -10, 44) - (2.0, 0.0),
    shapes.line((-1, 0.4), (1, 0.4), 0.1, 60)[0],
    shapes.plate(0.15, (0.1, 0.65), 70, 12),
]
MARKERS = np.concatenate(PARTS)


def curves():
    return Curves([len(part) for part in PARTS], [0.04, 0.035, 0.034, 0.027],
                  [True, True, True, False], [(0, 0), (0, 0), (2, 0), (0, 0)])


def make(name):
    along = curves()
    random = np.random.default_rng(3)
    if name == "tension":
        return laws.Tension(along, random.uniform(1, 5, len(along.edges)),
                            random.uniform(0.5, 1, len(along.edges)))
    if name == "bending":
        return laws.Bending(along, random.uniform(1, 5, len(along.triples)))
    if name == "tether":
        stiffness = random.uniform(1, 5, len(MARKERS)) * (np.arange(len(MARKERS)) % 3 > 0)
        return laws.Tether(along, stiffness, MARKERS + 0.01)
    return laws.LAWS[name](along, 30.0, 0.12, GRID)


def moved(size, seed=0):
    return MARKERS + size * np.random.default_rng(seed).standard_normal(MARKERS.shape)


def rate_matrix(law, before, after):
    """C of one law as a dense matrix."""
    if hasattr(law, "cover"):
        law.cover(before, after)
    table = np.zeros((len(law.columns), MARKERS.size))
    np.add.at(table, (np.arange(len(table))[:, None], law.columns), law.weights(before, after))
    return table


def energy(law, markers):
    if hasattr(law, "energy"):
        return law.energy(markers)
    stress = law.stress(markers, curves().stretching(markers))
    return stress @ stress / 2


@pytest.mark.parametrize("name", laws.LAWS)
@pytest.mark.parametrize("size", [1e-3, 0.02, 0.2])
def test_c_is_the_exact_difference(name, size):
    law, before, after = make(name), moved(0.002, 1), moved(size, 2)
    table = rate_matrix(law, before, after)
    change = (law.stress(after, curves().stretching(after))
              - law.stress(before, curves().stretching(before)))
    np.testing.assert_allclose(table @ (after - before).ravel(), change, rtol=0,
                               atol=1e-12 * max(1, abs(change).max()))
    assert abs(change).max() > 1e-4


@pytest.mark.parametrize("name", laws.LAWS)
def test_the_force_is_minus_the_gradient_of_the_energy(name):
    law, at = make(name), moved(0.002)
    table = rate_matrix(law, at, at)
    force = -table.T @ law.stress(at, curves().stretching(at))
    direction = np.random.default_rng(5).standard_normal(MARKERS.shape)
    step = 1e-6
    slope = (energy(law, at + step * direction) - energy(law, at - step * direction)) / (2 * step)
    assert abs(slope) > 1e-3
    assert force @ direction.ravel() == pytest.approx(-slope, rel=1e-6)


@pytest.mark.parametrize("name", [name for name in laws.LAWS if name != "tether"])
def test_force_has_no_sum_where_nothing_outside_exerts_any(name):
    law, at = make(name), moved(0.002)
    force = (rate_matrix(law, at, at).T @ law.stress(at, curves().stretching(at))).reshape(-1, 2)
    size = abs(force).max()
    assert size > 0 and abs(force.sum(axis=0)[0]) < 1e-11 * size * len(force)
    assert (abs(force.sum(axis=0)[1]) > size) == (name == "wall_contact")


@pytest.mark.parametrize("name", ["contact", "wall_contact"])
def test_rows_at_hand_are_all_that_count(name):
    """The energy of the rows is that of all pairs, whatever the membranes did before."""
    law = make(name)
    random = np.random.default_rng(8)
    before = MARKERS
    for k in range(30):
        after = before + (0.002 if k % 3 else 0.05) * random.standard_normal(2) * (
            np.arange(len(MARKERS)) < 40)[:, None]
        after = np.where(np.abs(after[:40, 1]).max() < 0.98, after, MARKERS)
        law.cover(before, after)
        for at in (before, after):
            stress = law.stress(at, None)
            assert stress @ stress / 2 == pytest.approx(by_hand(name, at), rel=1e-12, abs=1e-15)
            assert law.energy(at) == pytest.approx(by_hand(name, at), rel=1e-12, abs=1e-15)
        before = after
    assert by_hand(name, MARKERS) > 1e-4


def by_hand(name, at):
    """Contact energy by all pairs of markers."""
    along = curves()
    if name == "wall_contact":
        near = np.maximum(1 - np.stack((at[:, 1] + 1, 1 - at[:, 1])) / 0.12, 0)
        return 30 * 0.12 / 2 * np.sum(along.ds * near**4)
    apart = at[:, None] - at
    apart[:, :, 0] -= 2 * np.round(apart[:, :, 0] / 2)
    near = np.maximum(1 - np.hypot(*apart.transpose(2, 0, 1)) / 0.12, 0)
    near[along.owner[:, None] == along.owner] = 0
    return 30 / 2 * np.sum(np.outer(along.ds, along.ds) * near**4) / 2


def test_the_matrix_keeps_its_entries_while_markers_move_little():
    membranes = Membranes(4, curves(), [make("contact"), make("tension")], None)
    assert [law.name for law in membranes.laws] == ["tension", "contact"]
    first = membranes.rates(MARKERS, MARKERS)
    version, before = membranes.version, MARKERS
    for _ in range(4):
        after = before + 0.004
        assert membranes.rates(before, after).nnz == first.nnz
        before = after
    assert membranes.version == version
    membranes.rates(before, before + (np.arange(len(MARKERS)) < 40)[:, None] * 0.1)
    assert membranes.version == version + 1


def test_differences_across_the_joint_of_a_line_are_local():
    along = curves()
    assert along.stretching(MARKERS).max() < 1.3
    law = laws.Bending(along, 1.0)
    straight = MARKERS.copy()
    straight[84:144] = shapes.line((-1, 0.4), (1, 0.4), 0.0, 60)[0]
    stress = law.stress(straight, None)
    rows = np.repeat((along.triples[:, 1] >= 84) & (along.triples[:, 1] < 144), 2)
    assert np.abs(stress[rows]).max() < 1e-10
    # The same line cut elsewhere.
    turned = np.roll(straight[84:144], -20, axis=0)
    turned[-20:, 0] += 2
    np.testing.assert_allclose(np.diff(turned, axis=0), np.diff(straight[84:144], axis=0))


# ---------------------------------------------------------------- runs


CLOSE = {**TWO, "axes": "0.2,0.2", "vesicle_0_center": "-0.26,0.1", "vesicle_1_center": "0.26,-0.1",
         "contact": "100", "contact_range": "3", "shear_rate": "2"}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_energy_law_with_contact(tmp_path, scheme):
    assert largest_residual(tmp_path, **{**CLOSE, "scheme": scheme}) < 1e-10
    table = rows(tmp_path)
    assert table["contact_energy"].max() > 1e-3 and not table["wall_contact_energy"].any()
    # After the damped start, if there is one.
    lost = table["ledger_contact"][2:]
    assert (lost < 0).all() if scheme in ("mbe", "be", "gbe") else not lost.any()


@pytest.mark.parametrize("iteration, words", [
    ("Elimination", {"momentum_ksp_type": "cg"}), ("Block", {"momentum_ksp_type": "fgmres"})])
def test_contact_with_every_iteration(tmp_path, iteration, words):
    found = []
    for fft in ("yes", "no"):
        simulation = prepare(tmp_path / fft, **{**CLOSE, "scheme": "mbe", "fft": fft},
                             ts_max_steps="4", momentum_ksp_rtol="1e-10",
                             **(words if fft == "no" else {}))
        simulation.run()
        kind = type(simulation.scheme.system._iteration).__name__
        assert kind == ("Force" if fft == "yes" else iteration)
        simulation.destroy()
        found.append(arrays(tmp_path / fft / "final.h5"))
    for name in ("vesicle_0/X", "vesicle_1/X"):
        np.testing.assert_allclose(found[1][name], found[0][name], atol=1e-6)


def test_contact_keeps_apart(tmp_path):
    """Driven onto each other in steps that make them cross without it."""
    words = {**TWO, "flow": "rest", "stag_grid_x": "24", "axes": "0.2,0.2", "ts_dt": "0.02",
             "vesicle_0_center": "-0.3,0", "vesicle_1_center": "0.3,0", "ts_max_steps": "30",
             "vesicle_0_load": "20,0", "vesicle_1_load": "-20,0", "scheme": "mbe",
             "contact_range": "2"}
    run(tmp_path / "without", **words)
    run(tmp_path / "with", **words, contact="1000")
    without, kept = (rows(tmp_path / name)["min_gap"][-1] for name in ("without", "with"))
    assert without < 0.5 * 2 / 24 and kept > 2 * without


def test_contact_with_a_wall(tmp_path):
    words = {**GCN, "axes": "0.2,0.2", "stag_grid_x": "24", "delta": "roma3", "flow": "rest",
             "load": "0,-10", "center": "0,-0.45", "contact": "300", "contact_range": "4",
             "ts_dt": "0.02"}
    assert largest_residual(tmp_path, **words, ts_max_steps="15", picard_rtol="1e-9") < 1e-9
    table = rows(tmp_path)
    assert table["wall_contact_energy"][-1] > 0.1
    assert table["min_gap"][-1] > 2 * 2 / 24


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_energy_law_with_tethers_and_loads(tmp_path, scheme):
    words = {**TWO, "vesicle_0_tether": "500", "vesicle_1_load": "3,-4", "scheme": scheme}
    assert largest_residual(tmp_path, **words) < 1e-10
    table = rows(tmp_path)
    assert table["tether_energy"][-1] > 1e-3 and (abs(table["ledger_load_power"][1:]) > 1e-3).all()


@pytest.mark.parametrize("scheme", ["mbe", "gbe", "gcn"])
def test_tethers_that_are_moved_do_work(tmp_path, scheme):
    """By a function of time: the ledger still balances, and the vesicle follows."""
    positions = []

    def move(simulation):
        membranes, start = simulation.problem.membranes, simulation.state.markers.copy()
        held = laws.Tether(membranes.curves, 2000.0, lambda time: start + (0.3 * time**2, 0.0))
        membranes.laws = [held if law.name == "tether" else law for law in membranes.laws]
        positions.append(simulation.state)

    words = {**GCN, "scheme": scheme, "ts_dt": "0.05", "flow": "rest", "tether": "2000",
             "axes": "0.2,0.2", "stag_grid_x": "32", "ts_max_steps": "8"}
    assert largest_residual(tmp_path, prepared=move, **words) < 1e-10
    table = rows(tmp_path)
    start, end = positions[0].markers, arrays(tmp_path / "final.h5")["vesicle_0/X"]
    assert (table["ledger_load_power"][2:] > 0).all()
    np.testing.assert_allclose((end - start)[:, 0], 0.3 * 0.4**2, atol=0.015)


def test_stiff_tethers_hold_a_plate_at_any_step(tmp_path):
    """An open curve: no area, no inclination; the flow goes around it."""
    words = {**GCN, "shape": "plate", "axes": "0.1,0.25", "tether": "1e9", "ts_dt": "1",
             "angle": "30", "scheme": "be", "bending": "0.01"}
    assert largest_residual(tmp_path, **words, ts_max_steps="3", xdmf_every="3") < 1e-9
    table = rows(tmp_path)
    for name in ("area", "area_error", "inclination", "treading_frequency"):
        assert np.isnan(table[name]).all()
    assert table["perimeter"][0] == pytest.approx(0.5)
    found = arrays(tmp_path / "final.h5")
    count = len(found["vesicle_0/X"])
    assert np.abs(found["vesicle_0/X"] - found["vesicle_0/target"]).max() < 1e-5
    assert len(found["vesicle_0/stretch"]) == count - 1
    frame = arrays(tmp_path / "fields-00000003.h5")
    assert frame["vesicle_0/edges"].tolist() == [[k, k + 1] for k in range(count - 1)]


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("scheme", ["ep", *SCHEMES])
def test_tethers_hold_against_what_the_fluid_lacks(tmp_path, scheme):
    """A plate in a periodic box: its drag and lift are body force less change of momentum."""
    words = {**GCN, "shape": "plate", "axes": "0.1,0.25", "tether": "1e3", "ts_dt": "0.02",
             "angle": "30", "bending": "0", "sigma0": "0", "flow": "rest", "periodic": "xy",
             "body_force": "3,1", "scheme": scheme, "rho": "10", "advection": "explicit"}
    simulation = prepare(tmp_path, **words, ts_max_steps="4")
    momentum = []

    def note():
        momentum.append([10 * simulation.problem.grid.cell_area * comm.allreduce(part.sum())
                         for part in simulation.problem.grid.velocity_blocks(
                             simulation.state.velocity)])

    note()
    for _ in simulation.steps():
        note()
    simulation.destroy()
    if comm.rank == 0:
        table = rows(tmp_path)
        held = np.stack((table["drag"][1:], table["lift"][1:]), axis=1)
        given = 4.0 * np.array((3.0, 1.0)) - np.diff(momentum, axis=0) / 0.02
        # The damped start of cn and gcn shows the force of the second of its half steps alone.
        first = registry.SCHEMES[scheme].startup
        np.testing.assert_allclose(held[first:], given[first:], rtol=0, atol=1e-7)
        assert abs(held[-1]).min() > 0.1


def test_tethers_hold_the_start_after_a_restart(tmp_path):
    words = {**GCN, "axes": "0.2,0.3", "tether": "30", "stag_grid_x": "24",
             "checkpoint_every": "3"}
    run(tmp_path / "whole", **words, ts_max_steps="6")
    run(tmp_path / "parts", **words, ts_max_steps="3")
    run(tmp_path / "parts", restart=str(tmp_path / "parts/final.h5"), ts_max_steps="6")
    assert_same_run(tmp_path / "whole", tmp_path / "parts")


@pytest.mark.parametrize("scheme", ["mbe", "be", "gcn"])
def test_a_load_without_forces_of_the_membrane(tmp_path, scheme):
    """Markers alone carry it: the same flow as with the load spread by hand."""
    words = {**GCN, "scheme": scheme, "axes": "0.2,0.2", "sigma0": "0", "bending": "0",
             "load": "0,-2", "stag_grid_x": "24", "flow": "rest"}
    assert largest_residual(tmp_path, **words) < 1e-10
    table = rows(tmp_path)
    assert (np.diff(table["centroid_y"]) < 0).all()
    assert (table["ledger_load_power"][1:] > 0).all()


@pytest.mark.parametrize("scheme", ["be", "gbe", "gcn"])
def test_the_power_of_a_load_is_that_of_the_markers_motion(scheme):
    """Where no kink is corrected, markers move with the fluid."""
    problem, state = dense.problem(
        stag_grid_x=16, axes="0.3,0.2", load="1,-2", kink_correction="no")
    stepper = create(scheme, problem, Controls(fft=True))
    step = stepper.step(state, 0.1)
    work = np.sum(problem.membranes.load(0.1) * step.marker_velocity) * 0.1
    assert step.ledger["load_power"] == pytest.approx(work, rel=1e-8)
    stepper.destroy()


@pytest.mark.parametrize("scheme", ["mbe", "gbe"])
@pytest.mark.parametrize("fft", ["yes", "no"])
def test_contact_alone_with_nothing_near(tmp_path, scheme, fft):
    words = {**GCN, "scheme": scheme, "fft": fft, "sigma0": "0", "bending": "0", "contact": "20"}
    assert largest_residual(tmp_path, **words) < 1e-10


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("steps", [{}, {"scheme": "ep", "ts_dt": "1e-4"}])
def test_restart_and_ranks_with_contact(tmp_path, steps):
    words = {**CLOSE, "vesicle_0_tether": "1", "load": "0,1", **steps}
    run(tmp_path / "whole", **words, checkpoint_every="3", ts_max_steps="6")
    run(tmp_path / "parts", **words, ts_max_steps="3")
    run(tmp_path / "parts", restart=str(tmp_path / "parts/final.h5"), ts_max_steps="6")
    if comm.rank == 0:
        assert_same_run(tmp_path / "whole", tmp_path / "parts")


# ---------------------------------------------------------------- a line across a periodic box

# Of truth.json: mu, sigma, rho, decay rate, frequency.
FLAT = [(0.1, 1.0, 1.0, -3.335, 8.583), (0.1, 5.0, 1.0, -4.485, 21.305),
        (0.5, 2.0, 10.0, -1.606, 3.754)]


@pytest.mark.parametrize("mu, sigma, rho, decay, frequency", FLAT)
def test_a_flat_membrane_swings_as_linear_theory_says(tmp_path, mu, sigma, rho, decay, frequency):
    """From the exact mode, within 1 percent in both rates on 64 cells across, as the scene is."""
    end = 1.2 * 2 * np.pi / frequency
    simulation = Driver(options.read(dict(
        scene="ripple", stag_grid_x="64", mu=str(mu), rho=str(rho), sigma0=str(sigma),
        amplitude="1e-3", startup="0", fft="yes", picard_rtol="1e-6",
        ts_max_time=repr(end), output=str(tmp_path), monitor="none", plot="no")))
    k, rate = 2 * np.pi, decay + 1j * frequency
    alpha = np.sqrt(k**2 + rho * rate / mu)
    assert rate**2 == pytest.approx(-sigma * k**3 * (1 - k / alpha) / (2 * rho), rel=1e-3)
    grid, strength = simulation.problem.grid, rate * 1e-3 / (1 - k / alpha)
    x, y = grid.u_points()[0], grid.v_points()[1]
    low, high = grid.domain[2:]
    y = np.append(y, high)[:, None]
    # The stream function of the mode, and of its images across the box, at the corners.
    images = [abs(y - n * (high - low)) for n in range(-2, 3)]
    wave = sum(np.exp(-k * d) - k / alpha * np.exp(-alpha * d) for d in images)
    psi = (strength * wave).real * np.cos(k * np.append(x, 1.0)) / k
    u, v = np.diff(psi, axis=0)[:, :-1] / grid.dy, -np.diff(psi, axis=1)[:-1] / grid.dx
    grid.set_velocity(simulation.state.velocity, u[grid.u_box], v[grid.v_box])

    heights, times = [], []

    def note():
        markers = simulation.state.markers
        sine = np.sin(2 * np.pi * np.arange(len(markers)) / len(markers))
        heights.append(2 * np.mean(markers[:, 1] * sine) / 1e-3)
        times.append(simulation.state.time)

    note()
    for _ in simulation.steps():
        note()
    simulation.destroy()
    times, heights = np.array(times), np.array(heights)

    def misfit(fitted):
        a, b, real, imaginary = fitted
        return np.real((a + 1j * b) * np.exp((real + 1j * imaginary) * times)) - heights

    found = least_squares(misfit, [1, 0, decay, frequency])
    assert np.abs(found.fun).max() < 2e-3  # what bspline32 makes of markers h/2 apart
    assert found.x[2] == pytest.approx(decay, rel=0.01)
    assert found.x[3] == pytest.approx(frequency, rel=0.01)
