"""Advection: the operator, its energy, its solves, and what the program does with it."""
import os
from contextlib import contextmanager

import dense
import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from runs import assert_same_run, rows

from petscib import options, restart
from petscib.driver import Driver
from petscib.errors import InputError, SolveError
from petscib.fluid.advection import LARGEST_CFL, Advection
from petscib.fluid.flows import FLOWS
from petscib.stepsize import StepSize
from petscib.studies import cylinder, navierstokes
from petscib.studies.campaign import Campaign

comm = MPI.COMM_WORLD
SCHEMES = "mbe", "mcn", "be", "cn", "gbe", "gcn"
TREATMENTS = "explicit", "implicit"
TIGHT = {f"{name}_ksp_rtol": 1e-11 for name in (
    "momentum", "poisson", "coupled", "momentum_advection", "coupled_advection")}
QUIET = {"monitor": "none", "plot": "no", "ts_max_time": "1e3"}
VESICLE = {"axes": "0.25,0.4", "sigma0": "1e3", "bending": "1e-3"}
PERIODIC = {"flow": "rest", "periodic": "xy", "vesicles": "0"}
CAVITY = {"flow": "cavity", "domain": "0,1,0,1", "vesicles": "0"}

every_treatment = pytest.mark.parametrize("advection", TREATMENTS)


@contextmanager
def simulation_of(folder, solver=None, communicator=None, **words):
    """A simulation, not yet run, with PETSc's options in `solver`.  Collective."""
    given = {**QUIET, **{name: str(value) for name, value in words.items()}}
    with dense.petsc_options(**(solver or {})):
        given = restart.merge({"output": str(folder), **given}, comm)
        simulation = Driver(options.read(given), communicator)
        try:
            yield simulation
        finally:
            simulation.destroy()


def run(folder, **words):
    """The simulation at its end; its solvers are gone.  Collective."""
    with simulation_of(folder, **words) as simulation:
        simulation.run()
    return simulation


def velocity_of(simulation):
    """u and v in natural order on every rank.  Collective."""
    grid = simulation.problem.grid
    values = dense.velocity(grid, simulation.state.velocity)
    split = grid.u_index.size
    return (values[:split].reshape(grid.u_index.shape),
            values[split:].reshape(grid.v_index.shape))


# ---------------------------------------------------------------- the operator


def carried(grid, flow, transport, w):
    """N(U) w by its formula, face by face, and the boundary sum; natural order, both in one array.

    `flow` gives the velocity of the walls; all arrays are u and v.
    """
    U, V = transport
    a, b, c, d = grid.domain
    ends = (a, b), (c, d)
    spacing, result, boundary = (grid.dx, grid.dy), [], 0.0
    for number, part in enumerate(w):
        out = np.zeros_like(part)
        points = (grid.u_points, grid.v_points)[number]()
        lines, columns = part.shape
        for j in range(lines):
            for i in range(columns):
                place = (i, j)
                # walls keep their faces' values
                if not grid.periodic[number] and place[number] in (0, part.shape[1 - number] - 1):
                    continue
                for axis in (0, 1):
                    for side in (-1, 1):
                        step = [0, 0]
                        step[axis] = side
                        there = i + step[0], j + step[1]
                        link = link_velocity((U, V), number, axis, (i, j), side)
                        factor = side * link / (2 * spacing[axis])
                        count = part.shape[1 - axis]
                        if grid.periodic[axis]:
                            there = tuple(np.mod(there, part.shape[::-1]))
                        inside = 0 <= there[axis] < count
                        value = part[there[1], there[0]] if inside else None
                        if not inside:
                            at = [points[0].ravel()[i], points[1].ravel()[j]]
                            at[axis] = ends[axis][(side + 1) // 2]
                            wall = flow(*map(np.array, at))[number].item()
                            value = 2 * wall - part[j, i]
                            boundary += factor * (wall**2 - (wall - part[j, i]) ** 2)
                        elif (axis == number and not grid.periodic[axis]
                              and there[axis] in (0, count - 1)):
                            boundary += factor * value * part[j, i]
                        out[j, i] += factor * value
        result.append(out)
    return result, boundary * grid.dx * grid.dy


def link_velocity(transport, number, axis, place, side):
    """U or V on the link from a face of component `number` to its neighbour along an axis."""
    field = transport[axis]
    i, j = place

    def at(i, j):
        return field[j % field.shape[0], i % field.shape[1]]

    if axis == number:
        return (at(i, j) + at(*(p + side * (k == axis) for k, p in enumerate(place)))) / 2
    # a corner: the two faces of the other component that meet there
    corner = [i, j]
    corner[axis] += side == 1
    before = list(corner)
    before[number] -= 1
    return (at(*corner) + at(*before)) / 2


BOXES = {
    "walls at rest": dict(flow="rest"),
    "lid": dict(flow="cavity"),
    "shear": dict(flow="shear"),
    "extensional": dict(flow="extensional", shear_rate=0.7),
    "channel": dict(flow="shear", periodic="x"),
    "periodic in y": dict(flow="rest", periodic="y"),
    "periodic": dict(flow="taylor-green", periodic="xy"),
}


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("box", BOXES)
def test_the_operator_is_the_formula_and_its_power_that_of_the_boundary(box):
    problem, state = dense.problem(stag_grid_x=11, stag_grid_y=9, domain="-1,1.2,0,1",
                                   vesicles=0, rho=1.7, **BOXES[box])
    grid, rate = problem.grid, {"shear_rate": 1.0, **BOXES[box]}["shear_rate"]
    advection = Advection(problem.operators, problem.rho, True)
    random, split = np.random.default_rng(1), grid.u_index.size
    walls = dense.velocity(grid, state.velocity)
    inner = dense.inner_faces(grid)
    fields, vectors = [], []
    for _ in range(2):
        values = np.where(inner, random.standard_normal(len(walls)), walls)
        fields.append((values[:split].reshape(grid.u_index.shape),
                       values[split:].reshape(grid.v_index.shape)))
        vectors.append(grid.velocity_vector())
        dense.set_velocity(grid, vectors[-1], values)

    def flow(x, y):
        return FLOWS[BOXES[box]["flow"]](x, y, rate, grid.domain)

    expected, boundary = carried(grid, flow, *fields)
    expected = 1.7 * np.concatenate([part.ravel() for part in expected])
    result = grid.velocity_vector()
    advection.carry(vectors[0])
    advection.add(vectors[1], result)
    if advection.source is not None:
        result.axpy(1.0, advection.source)
    found = dense.velocity(grid, result)
    assert np.abs(found - expected).max() <= 1e-13 * np.abs(expected).max()
    power = advection.power(vectors[0], vectors[1]) * grid.dx * grid.dy
    scale = 1.7 * grid.dx * grid.dy * np.abs(expected).max() * split
    assert abs(power - 1.7 * boundary) <= 1e-15 * scale
    assert (abs(boundary) > 1e-3) == (box in ("shear", "extensional"))
    assert (advection.source is not None) == (box in ("shear", "extensional"))


@pytest.mark.parallel([1, 2])
def test_without_divergence_it_is_the_divergence_form():
    """The sum over all faces is what flows through the sides, here none."""
    problem, state = dense.problem(stag_grid_x=12, stag_grid_y=12, vesicles=0,
                                   flow="taylor-green", periodic="xy")
    grid = problem.grid
    advection = Advection(problem.operators, 1.0, True)
    w, result = grid.velocity_vector(), grid.velocity_vector()
    dense.set_velocity(grid, w, np.random.default_rng(2).standard_normal(w.getSize()))
    advection.carry(state.velocity)
    advection.add(w, result)
    u, v = np.split(dense.velocity(grid, result), 2)
    assert max(np.abs(u).max(), np.abs(v).max()) > 0.1
    assert max(abs(u.sum()), abs(v.sum())) <= 1e-12
    advection.carry(w)  # which has divergence
    result.set(0.0)
    advection.add(state.velocity, result)
    assert abs(np.split(dense.velocity(grid, result), 2)[0].sum()) > 1e-3


# ---------------------------------------------------------------- solves


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("box", ["shear", "extensional", "cavity", "periodic"])
def test_every_solver_gives_the_same(tmp_path, scheme, box):
    """Around the exact solve, within FGMRES, and with the whole matrix factored."""
    words = {"cavity": dict(CAVITY, mu="0.01"),
             "periodic": dict(flow="shear", periodic="x", **VESICLE)}.get(
        box, dict(flow=box, **VESICLE))
    words = dict(words, advection="implicit", scheme=scheme, stag_grid_x=24, rho="20",
                 ts_dt="0.05", ts_max_steps=2)
    found = []
    for name, more in (("fft", dict(fft="yes")), ("GAMG", {})):
        simulation = run(tmp_path / name, solver=TIGHT, **words, **more)
        found.append(np.concatenate([part.ravel() for part in velocity_of(simulation)]))
    assert np.abs(found[0] - found[1]).max() <= 1e-7 * np.abs(found[0]).max()
    plain = run(tmp_path / "none", solver=TIGHT, **{**words, "advection": "none"}, fft="yes")
    plain = np.concatenate([part.ravel() for part in velocity_of(plain)])
    assert np.abs(found[0] - plain).max() >= 1e-3 * np.abs(found[0]).max()


@pytest.mark.parametrize("fft", ["yes", "no"])
@pytest.mark.parametrize("scheme", ["mbe", "be", "gcn"])
def test_it_works_without_the_kink_correction(tmp_path, scheme, fft):
    simulation = run(tmp_path, solver=TIGHT, flow="shear", **VESICLE, scheme=scheme, fft=fft,
                     kink_correction="no", advection="implicit", stag_grid_x=24, rho="20",
                     ts_dt="0.05", ts_max_steps=2, ledger="record")
    assert rows(tmp_path)["ledger_residual"][1:].max() <= 1e-9
    assert simulation.state.step == 2


def test_an_implicit_step_costs_few_solves(tmp_path):
    """At CFL 2 and a cell Reynolds number of 10, from rest."""
    for scheme in ("be", "cn", "mbe", "mcn"):
        run(tmp_path / scheme, **CAVITY, scheme=scheme, startup=0, fft="yes", stag_grid_x=64,
            mu=1 / 640, ts_dt=2 / 64, ts_max_steps=20, advection="implicit")
        name = "coupled" if scheme in ("be", "cn") else "momentum"
        counts = rows(tmp_path / scheme)[f"{name}_iterations"][1:]
        assert 2 <= counts.max() <= 8


def test_too_few_solves_end_the_run(tmp_path):
    with pytest.raises(SolveError, match="advection did not converge in 2 solves"):
        run(tmp_path, **CAVITY, scheme="be", fft="yes", stag_grid_x=16, mu=0.001, ts_dt=1,
            ts_max_steps=2, advection="implicit", solver={"coupled_advection_ksp_max_it": 2})


# ---------------------------------------------------------------- the energy law


@every_treatment
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("flow", ["cavity", "shear", "poiseuille"])
@pytest.mark.parametrize("vesicles", [0, 1])
def test_the_ledger_balances(tmp_path, flow, vesicles, scheme, advection):
    """CFL 0.5, and 10 where it is implicit."""
    for cfl in (0.5, 10) if advection == "implicit" else (0.5,):
        words = dict(flow=flow, mu="0.1", rho="2", fft="yes", stag_grid_x=32, scheme=scheme,
                     advection=advection, ts_dt=cfl / 16, ts_max_steps=3, ledger="record",
                     vesicles=vesicles, **(VESICLE if vesicles else {}))
        if flow == "poiseuille":
            words.update(domain="-1,7,-1,1", stag_grid_x=128)
        run(tmp_path / str(cfl), solver=TIGHT if advection == "explicit" else {}, **words)
        table = rows(tmp_path / str(cfl))
        assert table["ledger_residual"][1:].max() <= 1e-8
        if flow == "cavity" and advection == "implicit":
            assert np.abs(table["ledger_advection"][1:]).max() <= 1e-15
        if flow != "cavity" and vesicles:
            assert np.abs(table["ledger_advection"][1:]).max() >= 1e-8


# ---------------------------------------------------------------- flows that are known


def extremes(simulation):
    """Least u on the vertical mid-line, most and least v on the horizontal one; parabolas."""
    u, v = velocity_of(simulation)
    across, up = v[len(v) // 2], u[:, u.shape[1] // 2]
    return [navierstokes.vertex(values, pick) for values, pick in (
        (up, np.argmin), (across, np.argmax), (across, np.argmin))]


def test_the_cavity_at_reynolds_number_100(tmp_path):
    """The prototype's values on the same grid, and Ghia, Ghia & Shin's (1982) to 0.01."""
    found = extremes(run(tmp_path, **CAVITY, scheme="be", fft="yes", stag_grid_x=64, mu=0.01,
                         ts_dt=10 / 64, ts_max_time=25, advection="implicit"))
    assert found == pytest.approx([-0.2128, 0.1786, -0.2530], abs=1e-3)
    assert found == pytest.approx([-0.2109, 0.1753, -0.2453], abs=1e-2)


def test_both_treatments_have_the_same_steady_state(tmp_path):
    """Whatever the time step was."""
    words = dict(**CAVITY, scheme="be", fft="yes", stag_grid_x=24, mu=0.01, ledger="record")
    first = run(tmp_path / "one", **words, advection="implicit", ts_dt=0.4, ts_max_time=120)
    steady = np.concatenate([part.ravel() for part in velocity_of(first)])
    final = tmp_path / "one" / "final.h5"
    for number, (advection, dt) in enumerate((("explicit", 0.02), ("implicit", 0.05))):
        simulation = run(tmp_path / str(number), restart=final, advection=advection, ts_dt=dt,
                         ts_max_time=121)
        after = np.concatenate([part.ravel() for part in velocity_of(simulation)])
        assert np.abs(after - steady).max() <= 1e-6 * np.abs(steady).max()


def drifting_vortices(simulation):
    """Set Taylor and Green's vortices, which a uniform flow carries through the periodic box."""
    grid = simulation.problem.grid
    u, v = FLOWS["taylor-green"](*grid.u_points(), 2.0, grid.domain), FLOWS["taylor-green"](
        *grid.v_points(), 2.0, grid.domain)
    dense.set_velocity(grid, simulation.state.velocity,
                       np.concatenate(((u[0] + 0.8).ravel(), (v[1] - 0.5).ravel())))


@every_treatment
@pytest.mark.parametrize("scheme, order", [("be", 1), ("mbe", 1), ("cn", 2), ("gcn", 2)])
def test_order_in_time(tmp_path, scheme, order, advection):
    """Without the damped start: the flow is smooth."""
    found = []
    for steps in (20, 40, 80):
        with simulation_of(
            tmp_path / str(steps), **PERIODIC, stag_grid_x=16, mu=0.02, fft="yes", scheme=scheme,
            startup=0, advection=advection, ts_dt=0.25 / steps, ts_max_time=0.25, solver=TIGHT,
        ) as simulation:
            drifting_vortices(simulation)
            simulation.run()
        found.append(np.concatenate([part.ravel() for part in velocity_of(simulation)]))
    coarse, fine = (np.abs(a - b).max() for a, b in zip(found, found[1:]))
    assert np.log2(coarse / fine) >= order - 0.1


@every_treatment
def test_order_in_time_with_a_vesicle(tmp_path, advection):
    """gcn, from a smooth start: two damped half steps, then equal ones."""
    found = []
    for steps in (8, 16, 32):
        simulation = run(tmp_path / str(steps), flow="shear", axes="0.3,0.4", sigma0=10,
                         bending=1e-3, rho=5, mu=1, stag_grid_x=24, fft="yes", scheme="gcn",
                         advection=advection, ts_dt=0.4 / steps, ts_max_time=0.4)
        found.append(simulation.state.markers)
    coarse, fine = (np.abs(a - b).max() for a, b in zip(found, found[1:]))
    assert np.log2(coarse / fine) >= 1.9


def test_order_in_space(tmp_path):
    """Vortices that decay and drift, against the exact solution."""
    errors, time, mu = [], 0.25, 0.05
    for cells in (16, 32):
        with simulation_of(
            tmp_path / str(cells), **PERIODIC, stag_grid_x=cells, mu=mu, fft="yes", scheme="cn",
            startup=0, advection="implicit", ts_dt=0.005, ts_max_time=time,
        ) as simulation:
            drifting_vortices(simulation)
            simulation.run()
        grid, (u, _) = simulation.problem.grid, velocity_of(simulation)
        x, y = grid.u_points()
        exact = FLOWS["taylor-green"](x - 0.8 * time, y + 0.5 * time, 2.0, grid.domain)[0]
        exact = 0.8 + exact * np.exp(-2 * mu * np.pi**2 * time)
        errors.append(np.abs(u - exact).max())
    assert np.log2(errors[0] / errors[1]) >= 1.8


def test_vortices_have_no_divergence_on_cells_of_any_shape(tmp_path):
    run(tmp_path, scene="taylor-green", stag_grid_x=16, stag_grid_y=20, fft="yes", scheme="cn",
        startup=0, ts_max_steps=2)
    assert rows(tmp_path)["max_divergence"].max() < 1e-13


@pytest.mark.parametrize("scheme", ["gbe", "gcn"])
def test_where_nothing_moves(tmp_path, scheme):
    simulation = run(tmp_path, scene="tanktreading", flow="rest", bending=0, axes="0.25,0.4",
                     scheme=scheme, advection="implicit", fft="yes", stag_grid_x=16, ts_max_steps=2)
    assert simulation.state.step == 2 and simulation.state.velocity.norm() == 0.0


def test_the_scene_of_decaying_vortices(tmp_path):
    simulation = run(tmp_path, scene="taylor-green", stag_grid_x=32, fft="yes", ledger="error")
    energy = rows(tmp_path)["energy"]
    expected = np.exp(-4 * 0.01 * np.pi**2 * simulation.state.time)
    assert energy[-1] / energy[0] == pytest.approx(expected, rel=1e-2)


# ---------------------------------------------------------------- runs


@pytest.mark.parallel(3)
@every_treatment
@pytest.mark.parametrize("fft", ["yes", "no"])
@pytest.mark.parametrize("scheme", ["mbe", "cn", "gcn"])
def test_ranks_agree(tmp_path, scheme, fft, advection):
    words = dict(flow="extensional", **VESICLE, stag_grid_x=27, stag_grid_y=22, rho="10",
                 scheme=scheme, fft=fft, advection=advection, ts_dt="0.02", ts_max_steps=3)
    simulation = run(tmp_path / "several", solver=TIGHT, **words)
    velocity, markers = velocity_of(simulation), simulation.state.markers
    if comm.rank == 0:
        alone = run(tmp_path / "one", solver=TIGHT, communicator=PETSc.COMM_SELF, **words)
        for found, expected in zip((*velocity, markers),
                                   (*velocity_of(alone), alone.state.markers)):
            assert np.abs(found - expected).max() <= 1e-8 * np.abs(expected).max()


@every_treatment
@pytest.mark.parametrize("scheme", ["mbe", "cn", "gcn"])
def test_a_restart_is_the_uninterrupted_run(tmp_path, scheme, advection):
    words = dict(flow="shear", **VESICLE, stag_grid_x=24, rho="20", scheme=scheme, fft="yes",
                 advection=advection, ts_dt="0.05", checkpoint_every=2)
    run(tmp_path / "whole", **words, ts_max_steps=4)
    run(tmp_path / "parts", **words, ts_max_steps=2)
    simulation = run(tmp_path / "parts", restart="latest", ts_max_steps=4)
    assert_same_run(tmp_path / "whole", tmp_path / "parts")
    keeps = scheme == "cn" or (scheme == "gcn" and advection == "explicit")
    assert ("velocity_rate" in simulation.state.history) == keeps


def test_the_transport_is_extrapolated_from_the_last_step(tmp_path):
    """Also after the two half steps of the start, and steps of other sizes."""
    with simulation_of(tmp_path, **CAVITY, stag_grid_x=16, mu=0.01, scheme="cn",
                       advection="explicit", fft="yes", ts_dt=0.02) as simulation:
        problem, scheme, state = simulation.problem, simulation.scheme, simulation.state
        transport = problem.transport(state, 0.01)
        transport.axpy(-1.0, state.velocity)
        assert transport.norm() == 0
        for dt in (0.02, 0.01, 0.03):
            step = scheme.step(state, dt)
            last = step.parts[-1] if step.parts else step
            ahead = problem.transport(step.end, 0.004)
            expected = step.end.velocity.copy()
            expected.axpby(-0.004 / last.dt, 1 + 0.004 / last.dt, last.start.velocity)
            ahead.axpy(-1.0, expected)
            assert ahead.norm() <= 1e-12 * expected.norm()
            state = step.end


def test_without_advection_nothing_is_there(tmp_path):
    simulation = run(tmp_path, **CAVITY, stag_grid_x=16, mu=0.01, scheme="cn", fft="yes",
                     ts_dt=0.02, ts_max_steps=2, ledger="record")
    assert simulation.problem.advection is None
    assert "velocity_rate" not in simulation.state.history
    assert (rows(tmp_path)["ledger_advection"][1:] == 0).all()


# ---------------------------------------------------------------- the time step, and refusals


def test_the_longest_step_of_explicit_advection():
    problem, state = dense.problem(flow="shear", shear_rate=4.0, vesicles=0, domain="-1,1,-1,1",
                                   stag_grid_x=16, stag_grid_y=32)
    speed = dense.velocity(problem.grid, state.velocity).max()
    explicit = Advection(problem.operators, 1.0, False)
    cell = 2 / 16
    assert explicit.longest_step(state.velocity, 0.01) == pytest.approx(
        LARGEST_CFL * cell / speed)
    viscous = 10.0 * speed * cell  # a cell Reynolds number of 0.1
    assert explicit.longest_step(state.velocity, viscous) == pytest.approx(
        10 * LARGEST_CFL * cell / speed)
    state.velocity.set(0.0)
    assert explicit.longest_step(state.velocity, 0.01) == np.inf
    assert Advection(problem.operators, 1.0, True).longest_step(state.velocity, 0.01) == np.inf


def test_a_limit_halves_the_step_of_adaptive_runs_alone():
    size = StepSize(1.0, adapt=True)
    size.limit(0.3)
    assert size.dt == 0.25
    for _ in range(6):
        size.accept()
    assert size.dt == 0.25
    size.limit(0.6)
    size.accept()
    assert size.dt == 0.5
    by_error = StepSize(1.0, rtol=0.1)
    by_error.limit(0.3)
    for _ in range(6):
        by_error.accept(error=1e-9)
    assert by_error.dt == 0.25
    size.limit(1e-9)
    assert size.dt >= 1e-3
    fixed = StepSize(1.0)
    fixed.limit(0.3)
    assert fixed.dt == 1.0


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("adapt", ["no", "yes"])
def test_adaptive_runs_keep_to_the_limit_and_others_are_warned(tmp_path, capfd, adapt):
    words = dict(**CAVITY, stag_grid_x=24, mu=0.001, scheme="be", advection="explicit", fft="yes",
                 ts_dt=4 / 24, ts_max_time=40 / 24, ts_adapt=adapt)
    run(tmp_path, **words)
    table = rows(tmp_path)
    warned = "explicit advection may be unstable" in capfd.readouterr().err
    if comm.rank == 0:
        assert warned == (adapt == "no")
    beyond = table["dt"][2:] * table["max_speed"][1:-1] * 24 > LARGEST_CFL * (1 + 1e-12)
    assert beyond.any() == (adapt == "no")


def test_a_tolerance_keeps_to_the_limit(tmp_path):
    """A vesicle at rest in its flow asks for longer steps than explicit advection stands."""
    words = dict(flow="shear", **VESICLE, stag_grid_x=24, rho=400, scheme="mbe", fft="yes",
                 advection="explicit", ts_dt=0.01, ts_rtol=0.3, ts_max_time=1)
    run(tmp_path, **words)
    table = rows(tmp_path)
    ratio = table["dt"][2:] * table["max_speed"][1:-1] * 12 / LARGEST_CFL
    assert 0.5 < ratio.max() <= 1 + 1e-12


@pytest.mark.parametrize("scheme, word", [("mbe", "momentum"), ("be", "coupled")])
def test_a_method_for_symmetric_systems_is_refused(tmp_path, scheme, word):
    words = dict(flow="shear", **VESICLE, stag_grid_x=24, scheme=scheme, ts_dt="0.05",
                 ts_max_steps=1)
    for method, refused in (("cg", True), ("minres", True), ("gmres", False), ("bcgs", False)):
        solver = {f"{word}_ksp_type": method}
        if refused:
            with pytest.raises(InputError, match=f"-{word}_ksp_type {method}: implicit "):
                run(tmp_path / method, solver=solver, **words, advection="implicit")
        else:
            run(tmp_path / method, solver=solver, **words, advection="implicit")
    run(tmp_path / "fft", solver={f"{word}_ksp_type": "cg"}, **words, advection="implicit",
        fft="yes")


# ---------------------------------------------------------------- the studies


@pytest.fixture
def no_launcher(monkeypatch):
    """Leave no launcher's variables to processes that studies start."""
    for name in list(os.environ):
        if name.startswith(("OMPI_", "PRTE_")):
            monkeypatch.delenv(name)


def test_the_study_makes_its_tables(tmp_path, monkeypatch, no_launcher):
    monkeypatch.setattr(navierstokes, "TREATMENTS", ("implicit",))
    monkeypatch.setattr(navierstokes, "TIMED", {"vortices": ("cn",), "vesicle": ("gcn",)})
    monkeypatch.setattr(navierstokes, "CAVITY_TIMES", {100: 4.0})
    one = Campaign("navierstokes", str(tmp_path))
    navierstokes.study(one, orders=(16,), cavity=((100, 16),), cfls=(0.5,), reynolds=(10.0,),
                       reduced_areas=(0.8,), grids=(24, 24), strain=0.25)
    assert one.exit_status == 0
    text = open(one.path("navierstokes.md")).read()
    assert "| vortices | cn | implicit |" in text and "| Re 100 | 16^2 | u_min | -0.1" in text
    assert "| 0.8 | 10 | 0.4" in text
    with open(one.path("navierstokes.png"), "rb") as file:
        assert file.read(4) == b"\x89PNG"


def test_the_studys_extremes_and_spreads():
    x = np.linspace(0, 1, 11)
    assert navierstokes.vertex((x - 0.43) ** 2 - 0.7, np.argmin) == pytest.approx(-0.7)
    assert all(len(values) == len(places) for profiles in navierstokes.GHIA.values()
               for values, places in zip(profiles, (navierstokes.GHIA_Y, navierstokes.GHIA_X)))
    records = [dict(part="vesicle", case=f"V 0.7, box {box}", x=1.0, quantity="frequency",
                    cells=cells, value=value)
               for box, cells, value in ((1, 48, 0.2), (1, 96, 0.21), (2, 96, 0.23))]
    assert navierstokes.spread(records, 0.7, 1.0, "frequency") == (0.21, 0.2, 0.23)
    assert navierstokes.spread(records, 0.9, 1.0, "frequency") is None


def test_the_cylinders_study(tmp_path, no_launcher):
    one = Campaign("cylinder", str(tmp_path))
    steady, shedding = cylinder.study(
        one, ((40, "12 x 8", 4, 5), (100, "12 x 8", 4, 5)), end={40: 4.0, 100: 1.0})
    assert one.exit_status == 0
    assert 1.5 < steady["drag"] < 3.0 and abs(steady["lift"]) < 0.1
    assert np.isnan(shedding["strouhal"]) and abs(shedding["lift"]) > 1e-3
    assert "| 40 | 12 x 8 | 4 | 0.2 |" in open(one.path("cylinder.md")).read()
    with open(one.path("cylinder.png"), "rb") as file:
        assert file.read(4) == b"\x89PNG"


def test_the_frequency_of_shedding():
    time = np.linspace(0.0, 10.0, 300)
    assert cylinder.frequency(time, 0.2 + np.sin(2 * np.pi * 0.7 * time)) == pytest.approx(
        0.7, rel=1e-3)
    assert np.isnan(cylinder.frequency(time, time))
