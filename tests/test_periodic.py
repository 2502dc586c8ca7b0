"""Periodic sides and the body force, from the options to the files."""
import atexit
from dataclasses import replace

import dense
import numpy as np
import pytest
from mpi4py import MPI
from runs import arrays, assert_same_run, prepare, run

from petscib import options, schemes
from petscib.driver import Driver
from petscib.errors import InputError
from petscib.output.xdmf import Series, cell_fields
from petscib.problem import Step

RHO, MU = 1.3, 0.7
BOX = {"stag_grid_x": "24", "stag_grid_y": "21", "domain": "-1,2,0.5,2", "rho": str(RHO),
       "mu": str(MU)}
SCHEMES = list(schemes.SCHEMES)
SOLVERS = {
    "GAMG": {f"{name}_ksp_rtol": 1e-11 for name in ("momentum", "poisson", "coupled")},
    "fft": {},
}

every_solver = pytest.mark.parametrize("solver", SOLVERS)


def simulation_of(folder, solver, **words):
    """A simulation with tight solvers, not yet run; the fluid starts at rest.  Collective."""
    given = {"flow": "rest", "monitor": "none", "plot": "no", **BOX, **words, "output": str(folder)}
    if solver == "fft":
        given["fft"] = "yes"
    with dense.petsc_options(**SOLVERS[solver]):
        simulation = Driver(options.read(given))
    atexit.register(simulation.destroy)  # PETSc must not find it at its own end
    return simulation


def fluid_alone(folder, solver, **words):
    """The same without vesicle."""
    return simulation_of(folder, solver, vesicles="0", **words)


def final(simulation):
    """u, v and p of the end of a run, in natural order on every rank.  Collective."""
    simulation.run()
    grid, state = simulation.problem.grid, simulation.state
    velocity, pressure = dense.velocity(grid, state.velocity), dense.pressure(grid, state.pressure)
    split = grid.u_index.size
    simulation.destroy()
    return (velocity[:split].reshape(grid.u_index.shape),
            velocity[split:].reshape(grid.v_index.shape), pressure.reshape(grid.p_index.shape))


# ---------------------------------------------------------------- exact solutions


@pytest.mark.parallel([1, 3])
@every_solver
@pytest.mark.parametrize("scheme", ["mbe", "be"])
@pytest.mark.parametrize("periodic", ["x", "y"])
def test_a_body_force_drives_poiseuille_flow(tmp_path, periodic, scheme, solver):
    """The force across the channel is balanced by the pressure."""
    force = 2.0, -3.0
    simulation = fluid_alone(tmp_path, solver, periodic=periodic, scheme=scheme,
                             body_force="2,-3", ts_dt="1e3", ts_max_time="3e3")
    u, v, p = final(simulation)
    a, b, c, d = -1.0, 2.0, 0.5, 2.0
    grid = simulation.problem.grid
    if periodic == "x":
        along, across, h, ends, s = u, v, grid.dy, (c, d), grid.u_points()[1]
        slope, drive, balanced = np.diff(p, axis=0) / h, *force
    else:
        along, across, h, ends, s = v, u, grid.dx, (a, b), grid.v_points()[0]
        slope, (balanced, drive) = np.diff(p, axis=1) / h, force
    # The ghost values beyond the walls add the constant.
    profile = drive / (2 * MU) * ((s - ends[0]) * (ends[1] - s) + h**2 / 4)
    assert np.abs(along - profile).max() <= 1e-6 * np.abs(profile).max()
    assert np.abs(across).max() <= 1e-8 * np.abs(profile).max()
    assert np.abs(slope - balanced).max() <= 1e-6 * abs(balanced)


@pytest.mark.parallel([1, 2])
@every_solver
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_box_without_walls_falls_freely(tmp_path, scheme, solver):
    simulation = fluid_alone(tmp_path, solver, periodic="xy", scheme=scheme, ts_max_steps="4",
                             body_force="2,-3", ts_dt="0.1", ts_max_time="10")
    u, v, p = final(simulation)
    time = simulation.state.time
    assert np.allclose(u, 2.0 * time / RHO, rtol=1e-9)
    assert np.allclose(v, -3.0 * time / RHO, rtol=1e-9)
    assert np.abs(p).max() <= 1e-9


@pytest.mark.parallel([1, 2])
@every_solver
@pytest.mark.parametrize("scheme", SCHEMES[1:])
def test_vortices_decay_at_the_rate_of_the_scheme(tmp_path, scheme, solver):
    """The curl of a product of sines is an eigenvector of all operators in a periodic box."""
    dt, steps = 0.02, 3
    simulation = fluid_alone(tmp_path, solver, periodic="xy", scheme=scheme, startup="0",
                             ts_dt=str(dt), ts_max_steps=str(steps), ts_max_time="10")
    grid = simulation.problem.grid
    k_x, k_y = 2 * np.pi / 3.0, 4 * np.pi / 1.5

    def stream(x, y):
        return np.sin(k_x * (x + 1) + 0.3) * np.cos(k_y * (y - 0.5) + 0.1)

    (x_u, y_u), (x_v, y_v) = grid.u_points(), grid.v_points()
    u = (stream(x_u, y_u + grid.dy / 2) - stream(x_u, y_u - grid.dy / 2)) / grid.dy
    v = -(stream(x_v + grid.dx / 2, y_v) - stream(x_v - grid.dx / 2, y_v)) / grid.dx
    dense.set_velocity(grid, simulation.state.velocity, np.concatenate((u.ravel(), v.ravel())))
    found = final(simulation)
    rate = MU / RHO * dt * ((2 / grid.dx * np.sin(k_x * grid.dx / 2))**2
                            + (2 / grid.dy * np.sin(k_y * grid.dy / 2))**2)
    implicit = scheme in ("mbe", "be", "gbe")
    factor = 1 / (1 + rate) if implicit else (1 - rate / 2) / (1 + rate / 2)
    assert np.abs(found[0] - factor**steps * u).max() <= 1e-8 * np.abs(u).max()
    assert np.abs(found[1] - factor**steps * v).max() <= 1e-8 * np.abs(v).max()
    assert np.abs(found[2]).max() <= 1e-8


# ---------------------------------------------------------------- any origin


def rolled(array, shift, periodic):
    """An array in natural order, moved on by (columns, rows) where the box is periodic."""
    for axis, name in ((1, "x"), (0, "y")):
        if name in periodic:
            array = np.roll(array, shift[1 - axis], axis)
    return array


@pytest.mark.parallel([1, 3])
@every_solver
@pytest.mark.parametrize("scheme", ["mbe", "gcn"])
@pytest.mark.parametrize("periodic", ["x", "y", "xy"])
def test_the_fluid_does_not_know_its_origin(tmp_path, periodic, scheme, solver):
    shift = 7, 5
    answers = []
    for cells in ((0, 0), shift):
        simulation = fluid_alone(tmp_path, solver, periodic=periodic, scheme=scheme,
                                 body_force="2,-3", ts_dt="0.001", ts_max_steps="2")
        grid, random = simulation.problem.grid, np.random.default_rng(4)
        u, v = random.standard_normal(grid.u_index.shape), random.standard_normal(
            grid.v_index.shape)
        if "x" not in periodic:
            u[:, [0, -1]] = 0.0
        if "y" not in periodic:
            v[[0, -1]] = 0.0
        moved = [rolled(part, cells, periodic).ravel() for part in (u, v)]
        dense.set_velocity(grid, simulation.state.velocity, np.concatenate(moved))
        answers.append(final(simulation))
    speed = np.abs(answers[0][0]).max()
    assert speed > 0.1
    for one, other, scale in zip(*answers, (speed, speed, MU * speed / grid.dy)):
        assert np.abs(rolled(one, shift, periodic) - other).max() <= 1e-8 * scale


VESICLE = {**BOX, "flow": "rest", "axes": "0.2,0.4", "angle": "30", "sigma0": "100",
           "bending": "0.01", "scheme": "ep", "ts_dt": "0.005", "ts_max_time": "1"}


def drifting(periodic):
    """Flow that carries a vesicle along the periodic directions."""
    force = {"x": "20,0", "y": "0,20", "xy": "20,10"}[periodic]
    return {**VESICLE, "periodic": periodic, "body_force": force}


@pytest.mark.parallel([1, 3])
@every_solver
@pytest.mark.parametrize("periodic", ["x", "y", "xy"])
def test_a_vesicle_may_cross_periodic_sides(tmp_path, periodic, solver):
    """Wherever the origin is put, even several boxes away, to the tolerance of the solvers."""
    size = 3.0, 1.5
    shift = np.array([size[0] * 13 / 24 if "x" in periodic else 0.0,
                      -size[1] * (11 / 21 + 4) if "y" in periodic else 0.0])
    found = []
    for name, moved in (("one", (0.0, 0.0)), ("other", shift)):
        x, y = np.array([0.5, 1.25]) + moved
        center = f"{float(x)!r},{float(y)!r}"
        words = {**drifting(periodic), "center": center, "ts_max_steps": "10"}
        simulation = simulation_of(tmp_path / name, solver, **words)
        simulation.run()
        simulation.destroy()
        MPI.COMM_WORLD.Barrier()
        found.append(arrays(tmp_path / name / "final.h5"))
    one, other = found
    cells = 13, -(11 + 4 * 21)
    assert np.abs(other["vesicle_0/X"] - one["vesicle_0/X"] - shift).max() <= 1e-9
    for name in ("u", "v", "p"):
        expected = rolled(one[f"fluid/{name}"], cells, periodic)
        assert np.abs(other[f"fluid/{name}"] - expected).max() <= 1e-7 * np.abs(expected).max()
    # It has moved, and with the fluid.
    assert np.abs(one["vesicle_0/X"].mean(axis=0) - (0.5, 1.25)).max() > 0.01


# ---------------------------------------------------------------- files


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("periodic", ["none", "x", "y", "xy"])
def test_shapes_in_the_files(tmp_path, periodic):
    fluid_alone(tmp_path, "fft", periodic=periodic, ts_max_steps="1").run()
    if MPI.COMM_WORLD.rank == 0:
        found = arrays(tmp_path / "final.h5")
        assert found["fluid/u"].shape == (21, 24 if "x" in periodic else 25)
        assert found["fluid/v"].shape == (21 if "y" in periodic else 22, 24)
        assert found["fluid/p"].shape == (21, 24)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("periodic", ["x", "xy"])
def test_restart_of_a_vesicle_that_has_left_the_box(tmp_path, periodic):
    words = {**drifting(periodic), "center": "1.9,1.25", "fft": "yes"}
    run(tmp_path / "whole", **words, ts_max_steps="12")
    run(tmp_path / "parts", **words, ts_max_steps="6")
    run(tmp_path / "parts", restart=str(tmp_path / "parts/final.h5"), ts_max_steps="12")
    if MPI.COMM_WORLD.rank == 0:
        assert_same_run(tmp_path / "whole", tmp_path / "parts")
        assert arrays(tmp_path / "whole/final.h5")["vesicle_0/X"][:, 0].max() > 2.05


def test_restart_keeps_the_sides(tmp_path):
    fluid_alone(tmp_path, "fft", periodic="x", ts_max_steps="1").run()
    with pytest.raises(InputError, match="-periodic none: a restart cannot change it.* x;"):
        prepare(tmp_path, restart=str(tmp_path / "final.h5"), periodic="none", ts_max_steps="2")


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("periodic", ["x", "y", "xy"])
def test_fields_for_paraview(tmp_path, periodic):
    simulation = fluid_alone(tmp_path, "fft", periodic=periodic)
    grid, sides = simulation.problem.grid, simulation.problem.operators.sides
    k = {"x": 2 * np.pi / 3.0, "y": 4 * np.pi / 1.5}
    u = np.cos(k["y"] * (grid.u_points()[1] - 0.5)) * np.cos(k["x"] * (grid.u_points()[0] + 1))
    v = np.cos(k["y"] * (grid.v_points()[1] - 0.5)) * np.cos(k["x"] * (grid.v_points()[0] + 1))
    vector = grid.velocity_vector()
    dense.set_velocity(grid, vector, np.concatenate((u.ravel(), v.ravel())))
    velocity, vorticity = cell_fields(grid, sides, vector)
    x, y = (part - low for part, low in zip(grid.p_points(grid.p_box), (-1, 0.5)))
    # Means over two faces, and central differences of them.
    mean = {"x": np.cos(k["x"] * grid.dx / 2), "y": np.cos(k["y"] * grid.dy / 2)}
    wave = np.cos(k["y"] * y) * np.cos(k["x"] * x)
    assert np.allclose(velocity[..., 0], mean["x"] * wave, atol=1e-13)
    assert np.allclose(velocity[..., 1], mean["y"] * wave, atol=1e-13)
    slopes = (
        -mean["y"] * np.sin(k["x"] * grid.dx) / grid.dx * np.sin(k["x"] * x) * np.cos(k["y"] * y),
        -mean["x"] * np.sin(k["y"] * grid.dy) / grid.dy * np.cos(k["x"] * x) * np.sin(k["y"] * y),
    )
    rows, columns = grid.p_box
    beside_walls = np.zeros(wave.shape, dtype=bool)
    if "y" not in periodic:
        beside_walls |= np.isin(np.arange(rows.start, rows.stop), (0, grid.n - 1))[:, None]
    if "x" not in periodic:
        beside_walls |= np.isin(np.arange(columns.start, columns.stop), (0, grid.m - 1))
    assert beside_walls.all() or np.abs(vorticity - slopes[0] + slopes[1])[
        ~beside_walls].max(initial=0) <= 1e-12


def test_a_vesicle_is_written_where_its_middle_is_in_the_box(tmp_path):
    simulation = prepare(tmp_path, **drifting("xy"), center="-4.05,9.7")
    Series(str(tmp_path), simulation.problem).write(simulation.state)
    found = arrays(tmp_path / "fields-00000000.h5")["vesicle_0/X"]
    assert np.allclose(found.mean(axis=0), (-4.05 + 6.0, 9.7 - 9.0), atol=1e-3)
    assert np.allclose(found - found[0], simulation.state.markers - simulation.state.markers[0],
                       atol=1e-6)
    simulation.destroy()


def test_treading_is_seen_from_the_middle_of_a_drifting_vesicle(tmp_path):
    simulation = prepare(tmp_path, **drifting("x"), center="0.5,1.25")
    start, dt = simulation.state, 0.1
    markers = start.markers + dt * (np.array([3.0, 0.0]) + 2 * np.stack(
        (start.markers[:, 1] - 1.25, 0.5 - start.markers[:, 0]), axis=1))
    rows = []
    for drift in (0.0, 3.0):
        end = replace(start, markers=markers - dt * np.array([drift, 0.0]), time=dt)
        motion = (end.markers - start.markers) / dt
        step = Step(dt, 1.0, start, end, start.velocity, marker_velocity=motion)
        rows.append(simulation.diagnostics.row(end, step))
    assert rows[0]["treading_frequency"] > 0
    assert rows[1]["treading_frequency"] == pytest.approx(rows[0]["treading_frequency"], rel=1e-9)
    assert rows[0]["centroid_x"] - rows[1]["centroid_x"] == pytest.approx(0.3)
    simulation.destroy()


# ---------------------------------------------------------------- wrong input


@pytest.mark.parametrize("words, parts", [
    (dict(flow="shear", periodic="y"), ("-flow shear", "varies along y", "-flow rest")),
    (dict(flow="poiseuille", periodic="xy"), ("-flow poiseuille", "along y", "-flow rest")),
    (dict(flow="extensional", periodic="x"), ("-flow extensional", "along x",
                                              "rest or shear or poiseuille")),
    (dict(periodic="x", axes="1.1,0.2", angle="0"), ("-axes 1.1,0.2", "2.2 long in x", "period")),
    (dict(periodic="x", center="0,0.9"), ("-center 0,0.9", "wall y = 1")),
    (dict(periodic="z"), ("-periodic z", "no such choice", "none, x, y, xy")),
    (dict(body_force="1"), ("-body_force 1", "not 2 values")),
])
def test_refused(words, parts):
    with pytest.raises(InputError) as caught:
        options.read(words)
    for part in parts:
        assert part in str(caught.value)


def test_walls_are_felt_only_where_there_are_some():
    settings = options.read(dict(periodic="x", center="0.95,0"))
    assert settings.periodic == "x"
    with pytest.raises(InputError, match="beyond the wall x = 1"):
        options.read(dict(center="0.95,0"))
