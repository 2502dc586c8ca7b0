"""The implicit system's iterations against one dense solve; their counts, options and failures."""
from functools import cache

import dense
import h5py
import numpy as np
import pytest
from runs import run
from scipy.linalg import block_diag

from petscib.coupling.kernels import KERNELS
from petscib.errors import SolveError
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.membranes import geometry, shapes
from petscib.membranes.curves import Curves
from petscib.membranes.laws import Bending, Tension
from petscib.membranes.membranes import Membranes
from petscib.problem import Problem, State
from petscib.schemes import Controls, Solvers, create
from petscib.solvers.alone import Alone, AloneExact
from petscib.solvers.block import Block
from petscib.solvers.elimination import Elimination
from petscib.solvers.force import Force
from petscib.solvers.system import ImplicitSystem, Stage

INTERVAL, RHO, MU = 0.02, 1.3, 0.7
# Each iteration: the fluid's equations, by transforms or not, the option that asks for it, and
# whether the kink is corrected.
ITERATIONS = {
    "force": ("momentum", True, "cg", True),
    "coupled force": ("coupled", True, "cg", True),
    "elimination": ("momentum", False, "cg", True),
    "block": ("momentum", False, "fgmres", True),
    "coupled block": ("coupled", False, "fgmres", True),
    "literal": ("momentum", False, "cg", False),
    "coupled literal": ("coupled", False, "fgmres", False),
}
KINDS = {"force": Force, "elimination": Elimination, "block": Block, "literal": Elimination}
every_iteration = pytest.mark.parametrize("iteration", ITERATIONS)


def curves():
    """Two closed curves, of different marker spacing, and an open one: markers of each."""
    along = np.linspace(0.0, 1.0, 13)[:, None]
    return [shapes.ellipse((0.3, 0.5), (-0.55, 0.05), 15.0, 24),
            shapes.ellipse((0.25, 0.2), (0.5, -0.35), 40.0, 16),
            (0.15, 0.35) + along * (0.85, 0.2) + 0.1 * np.sin(3 * along) * (-0.2, 1.0)]


SPACINGS, CLOSED = (0.11, 0.085, 0.07), (True, True, False)
RIGIDITY = 0.01, 0.03, 0.02


class Case:
    """Three membranes in extensional flow; what the system is made of, and the same densely.

    Without the kink correction, very stiff ones go without the area projector too: it is left to
    the Krylov method there, which round-off then ends.
    """

    def __init__(self, sigma0=1e5, corrected=True, flow="extensional", cells=(24, 20)):
        self.grid = Grid(cells, (-1.5, 1.5, -1.0, 1.0))
        sides = Sides(self.grid, flow, 0.8 if flow != "rest" else 0.0)
        here = self.grid.comm.rank == 0
        self.parts = curves()
        self.markers = np.concatenate(self.parts)
        self.sigma0 = sigma0, sigma0 / 7, sigma0 / 2
        lines = Curves([24, 16, 13], SPACINGS, CLOSED)
        self.stretch = 1.02 * lines.stretching(self.markers)
        self.rest = lines.stretching(self.markers) * (
            0.9 + 0.2 * np.random.default_rng(4).random(len(self.stretch)))
        if not here:
            lines = Curves([], [])
        laws = [Tension(lines, np.repeat(self.sigma0, np.diff(lines.edge_starts)) if here else 0.0,
                        self.here(self.rest)),
                Bending(lines, np.repeat(RIGIDITY, (24, 16, 11)) if here else 0.0)]
        membranes = Membranes(3, lines, laws, self.here(self.rest))
        self.keeps_areas = corrected or sigma0 < 1e6
        areas = geometry.signed_area(self.here(self.markers), lines) if self.keeps_areas else None
        self.problem = Problem(
            self.grid, Operators(self.grid, sides), RHO, MU, membranes, KERNELS["yang"],
            kink_correction=corrected, areas=areas)
        velocity = self.grid.velocity_vector()
        sides.fill(velocity)
        random = np.random.default_rng(1).standard_normal(
            len(dense.velocity_numbers(self.grid))) * dense.inner_faces(self.grid)
        self.rhs = self.grid.velocity_vector()
        dense.set_velocity(self.grid, velocity, dense.velocity(self.grid, velocity) + 0.1 * random)
        self.state = State(0, 0.0, velocity, self.grid.pressure_vector(),
                           self.here(self.markers), self.here(self.stretch))
        self.stress = self.problem.stress(self.state)
        self.set_interval(INTERVAL)

    def here(self, array):
        """What this rank holds of marker data."""
        return array if self.grid.comm.rank == 0 else array[:0]

    def set_interval(self, interval):
        self.interval = interval
        self.problem.fluid_rhs(self.state, interval, self.rhs)

    def turned(self, turn):
        """Markers at the end of a step in which the curves turn and bend by about `turn`."""
        x, y = self.markers.T
        return self.markers + turn * np.stack((np.sin(2 * y), np.cos(3 * x) * x), axis=1)

    def operators(self, turn=0.02):
        """Operators on the way to `turned` markers, with J at the mean."""
        end = self.turned(turn)
        interpolation = self.problem.interpolation(self.here((self.markers + end) / 2))
        return self.problem.operators_between(
            self.here(self.markers), self.here(end), interpolation)

    def new_stage(self):
        return Stage(self.grid.velocity_vector(), self.grid.pressure_vector(),
                     np.zeros_like(self.stress))

    def fluid(self, equations, transforms):
        solvers = Solvers(self.problem, Controls(fft=transforms))
        return solvers.momentum() if equations == "momentum" else solvers.stokes()

    def system(self, equations, transforms, interval=INTERVAL):
        problem = self.problem
        return ImplicitSystem(self.fluid(equations, transforms), problem.membranes,
                              problem.kernel, problem.kink_correction, interval)

    def found(self, stage, operators, motion):
        """w, p, U and f on every rank."""
        comm = self.grid.comm.tompi4py()
        force = comm.bcast(operators.force(stage.stress))
        return (dense.velocity(self.grid, stage.velocity),
                dense.pressure(self.grid, stage.pressure), comm.bcast(motion), force)

    def exact(self, equations, turn=0.02, advection=None):
        """The same by one dense solve; with a matrix of advection added to the fluid's."""
        grid, kink = self.grid, self.problem.kink_correction
        first, (end, middle) = 0, (self.turned(turn), (self.markers + self.turned(turn)) / 2)
        slips, stiffnesses, forces, projectors = [], [], [], []
        edge = 0
        for part, ds, closed, sigma0, rigidity in zip(
                self.parts, SPACINGS, CLOSED, self.sigma0, RIGIDITY):
            where = slice(first, first + len(part))
            table = dense.to_half_points(len(part), ds)
            second = np.kron(-table.T @ table, np.eye(2))
            slip = dense.slip(grid, MU, middle[where], ds, dense.KINK["yang"])
            if not closed:
                table, second = table[1:], second[2:-2]
                slip = open_slip(grid, middle[where], slip)
            ahead, behind = table @ end[where], table @ part
            tangent = (ahead + behind) / (np.hypot(*ahead.T) + np.hypot(*behind.T))[:, None]
            rate = (table[:, :, None] * tangent[:, None, :]).reshape(len(table), -1)
            excess = (self.stretch - self.rest)[edge : edge + len(table)]
            stiffnesses.append(ds * (sigma0 * rate.T @ rate + rigidity * second.T @ second))
            forces.append(-ds * (rate.T @ (sigma0 * excess)
                                 + rigidity * second.T @ second @ part.ravel()))
            slips.append(slip / ds)
            projectors.append(dense.projector(middle[where], ds) if closed and self.keeps_areas
                              else np.eye(2 * len(part)))
            first, edge = where.stop, edge + len(table)
        projector, slip = block_diag(*projectors), kink * block_diag(*slips)
        carry = projector @ dense.interpolation(grid, self.problem.kernel, middle)
        walls = dense.velocity(grid, self.state.velocity)[~dense.inner_faces(grid)]
        rhs, comm, found = dense.velocity(grid, self.rhs), grid.comm.tompi4py(), None
        if advection is None:
            advection = np.zeros((len(rhs), len(rhs)))
        rhs = rhs - advection[:, ~dense.inner_faces(grid)] @ walls
        if comm.rank == 0:  # as the ranks share the processors
            found = dense.stage(
                grid, RHO / self.interval, MU, rhs, walls, carry, slip,
                self.interval * block_diag(*stiffnesses), np.concatenate(forces),
                equations == "coupled", advection)
        w, p, f = comm.bcast(found)
        return w, p, (carry @ w + slip @ f).reshape(-1, 2), f.reshape(-1, 2)


def open_slip(grid, markers, slip):
    """K of an open curve from that of a closed one: the ends have one edge each."""
    ends = markers[[0, 1, -2, -1]]
    for place, edge in ((slice(0, 2), ends[1] - ends[0]), (slice(-2, None), ends[3] - ends[2])):
        # A closed curve's marker with that edge on either side.
        three = np.outer(np.arange(3), edge)
        slip[place, place] = dense.slip(grid, MU, three, SPACINGS[2], dense.KINK["yang"])[2:4, 2:4]
    return slip


@cache
def exact(equations, sigma0, corrected, turn=0.02, interval=INTERVAL):
    case = Case(sigma0, corrected)
    case.set_interval(interval)
    return case.exact(equations, turn)


def options(equations, ksp_type="cg", **more):
    chosen = {"ksp_rtol": 1e-12, **more}
    if equations == "momentum":
        chosen["ksp_type"] = ksp_type
    return dense.petsc_options(**{f"{equations}_{name}": text for name, text in chosen.items()})


def close(found, expected, tolerance):
    return all(np.abs(one - other).max(initial=0.0) <= tolerance * np.abs(other).max(initial=0.0)
               for one, other in zip(found, expected) if other.size)


def solve(case, iteration, **more):
    """Answer and iterations of one solve, and what solved."""
    equations, transforms, ksp_type, _ = ITERATIONS[iteration]
    with options(equations, ksp_type, **more):
        system = case.system(equations, transforms)
        stage, operators = case.new_stage(), case.operators()
        count = system.solve(case.rhs, stage, case.interval, operators, case.stress)
        found = case.found(stage, operators, system.marker_velocity())
        kind = type(system._iteration)
        system.destroy()
    return found, count, kind


def tolerance(sigma0, corrected):
    """Of the dense answer, in which round-off grows with the stiffness."""
    return 1e-9 if sigma0 < 1e9 else 1e-6 if corrected else 1e-5


@pytest.mark.parallel([1, 3])
@every_iteration
@pytest.mark.parametrize("sigma0", [1e5, 1e9])
def test_all_iterations_find_the_dense_stage(sigma0, iteration):
    equations, _, _, corrected = ITERATIONS[iteration]
    found, count, kind = solve(Case(sigma0, corrected), iteration)
    assert kind is KINDS[iteration.split()[-1]] and count >= 1
    assert close(found, exact(equations, sigma0, corrected), tolerance(sigma0, corrected))


@pytest.mark.parallel([1, 3])
@every_iteration
def test_one_system_follows_time_step_and_membranes(iteration):
    """Nothing stale is kept: no matrix, preconditioner, model, window or factor."""
    equations, transforms, ksp_type, corrected = ITERATIONS[iteration]
    case = Case(1e5, corrected)
    with options(equations, ksp_type):
        system = case.system(equations, transforms)
        for interval, turn in ((0.02, 0.02), (0.02, 0.04), (0.005, 0.04), (0.02, -0.15)):
            case.set_interval(interval)
            stage, operators = case.new_stage(), case.operators(turn)
            system.solve(case.rhs, stage, interval, operators, case.stress)
            found = case.found(stage, operators, system.marker_velocity())
            assert close(found, exact(equations, 1e5, corrected, turn, interval), 1e-9)
        system.destroy()


@pytest.mark.parallel([1, 3])
@every_iteration
def test_passes_of_a_step_end_at_the_answer_of_the_last(iteration):
    """Each starts from the last one's answer; the motion is known before the step is finished."""
    equations, transforms, ksp_type, corrected = ITERATIONS[iteration]
    case = Case(1e7, corrected)
    with options(equations, ksp_type):
        system = case.system(equations, transforms)
        for _ in range(2):
            stage = case.new_stage()
            system.begin(case.rhs, stage)
            for turn, accuracy in ((0.0, 1e-2), (0.1, 1e-2), (0.1, 1e-5), (0.0201, 1e-9),
                                   (0.02, 1e-12)):
                operators = case.operators(turn)
                system.update(INTERVAL, operators, case.stress)
                system.iterate(accuracy)
            early = system.marker_velocity()
            system.finish()
            late = operators.interpolate(stage.velocity) + operators.slip_velocity(
                operators.force(stage.stress))
            assert np.abs(late - early).max(initial=0.0) <= 1e-10
            found = case.found(stage, operators, early)
            assert close(found, exact(equations, 1e7, corrected), 1e-7)
        system.destroy()


@every_iteration
def test_a_pass_answers_its_own_configuration(iteration):
    """As accurately as asked, from the answer of another."""
    equations, transforms, ksp_type, corrected = ITERATIONS[iteration]
    case = Case(1e5, corrected)
    with options(equations, ksp_type):
        system, stage = case.system(equations, transforms), case.new_stage()
        system.begin(case.rhs, stage)
        for turn, accuracy in ((0.02, 1e-12), (0.1, 3e-3), (0.02, 1e-5), (0.1, 1e-8)):
            operators = case.operators(turn)
            system.update(INTERVAL, operators, case.stress)
            system.iterate(accuracy)
            expected = exact(equations, 1e5, corrected, turn)[2]
            error = np.abs(system.marker_velocity() - expected).max()
            assert error <= 20 * max(accuracy, 1e-11) * np.abs(expected).max()
        system.destroy()


# ---------------------------------------------------------------- which iteration, and its options


@pytest.mark.parametrize("transforms, corrected, interval, option, kind", [
    (False, True, 0.001, {}, Elimination), (False, True, 50.0, {}, Block),
    (False, True, 0.001, {"momentum_ksp_type": "fgmres"}, Block),
    (False, True, 50.0, {"momentum_ksp_type": "cg"}, Elimination),
    (True, True, 0.001, {}, Force), (True, True, 50.0, {}, Force),
    (True, True, 0.001, {"momentum_ksp_type": "fgmres"}, Force),
    (False, False, 50.0, {}, Elimination), (True, False, 0.001, {}, Elimination)])
def test_the_iteration_of_the_momentum_system(transforms, corrected, interval, option, kind):
    """By how far momentum diffuses in a step, unless transforms or the user decide."""
    case = Case(corrected=corrected)
    with dense.petsc_options(**option):
        system = case.system("momentum", transforms, interval)
        assert type(system._iteration) is kind
        assert kind is not Elimination or system._iteration.literal is not corrected
        system.destroy()


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("transforms", [True, False])
@pytest.mark.parametrize("equations", ["momentum", "coupled"])
def test_without_membranes_the_fluid_is_solved_alone(equations, transforms):
    case = Case()
    with options(equations):
        for membranes in (None, Membranes(1, case.problem.membranes.curves, [], case.rest)):
            system = ImplicitSystem(
                case.fluid(equations, transforms), membranes, case.problem.kernel, True, INTERVAL)
            stage = case.new_stage()
            count = system.solve(case.rhs, stage, INTERVAL)
            assert type(system._iteration) is (AloneExact if transforms else Alone)
            assert (count == 1) == transforms
            system.destroy()
            nothing = np.zeros((0, 0))
            walls = dense.velocity(case.grid, case.rhs)[~dense.inner_faces(case.grid)]
            rhs = dense.velocity(case.grid, case.rhs)
            w, p, _ = dense.stage(
                case.grid, RHO / INTERVAL, MU, rhs, walls * INTERVAL / RHO,
                np.zeros((0, len(rhs))), nothing, nothing, np.zeros(0), equations == "coupled")
            found = (dense.velocity(case.grid, stage.velocity),
                     dense.pressure(case.grid, stage.pressure))
            assert close(found, (w, p), 1e-9)


@every_iteration
def test_relative_tolerance_is_the_power_of_the_error(iteration):
    """Relative to that of the right-hand side, of fluid and membranes; multigrid roughly tells it.

    Box at rest: what the momentum matrix says of a velocity is its power.
    """
    equations, _, _, corrected = ITERATIONS[iteration]
    case = Case(1e5, corrected, "rest")
    expected, rhs = case.exact(equations)[0], dense.velocity(case.grid, case.rhs)
    table = RHO / INTERVAL * np.eye(len(rhs)) - MU * dense.laplacian(case.grid)
    power = np.sqrt(rhs @ np.linalg.solve(table, rhs)
                    + case.stress @ case.stress / INTERVAL / case.grid.cell_area)
    errors = []
    for rtol in (1e-3, 1e-6):
        error = solve(case, iteration, ksp_rtol=rtol)[0][0] - expected
        errors.append(np.sqrt(error @ table @ error))
        assert errors[-1] <= 10 * rtol * power
    assert errors[0] > 10 * errors[1]


@pytest.mark.parallel([1, 2])
@every_iteration
def test_each_solve_is_measured_by_its_own_right_hand_side(iteration):
    equations, transforms, ksp_type, corrected = ITERATIONS[iteration]
    case, answers = Case(1e5, corrected, "rest"), []
    with options(equations, ksp_type, ksp_rtol=1e-9):
        system = case.system(equations, transforms)
        for factor in (1.0, 1e-6):
            rhs = case.rhs.copy()
            rhs.scale(factor)
            stage, operators = case.new_stage(), case.operators()
            system.solve(rhs, stage, INTERVAL, operators, factor * case.stress)
            answers.append([part / factor for part in case.found(
                stage, operators, system.marker_velocity())])
        system.destroy()
    assert close(*answers, 1e-6)


@pytest.mark.parallel([1, 2])
@every_iteration
def test_a_guess_much_too_fast_costs_no_accuracy(iteration):
    equations, transforms, ksp_type, corrected = ITERATIONS[iteration]
    case, expected = Case(1e5, corrected), exact(equations, 1e5, corrected)
    with options(equations, ksp_type, ksp_rtol=1e-7):
        system = case.system(equations, transforms)
        for factor in (1.0, 1e3):
            stage, operators = case.new_stage(), case.operators()
            dense.set_velocity(case.grid, stage.velocity, factor * expected[0])
            stage.stress = factor * case.stress
            system.solve(case.rhs, stage, INTERVAL, operators, case.stress)
            found = case.found(stage, operators, system.marker_velocity())
            assert close(found[:1], expected[:1], 1e-5)
        system.destroy()


@pytest.mark.parametrize("iteration, worse", [
    ("elimination", {"pc_type": "jacobi"}), ("block", {"velocity_pc_type": "jacobi"}),
    ("coupled block", {"velocity_pc_type": "jacobi"}),
    ("coupled block", {"poisson_pc_type": "jacobi"}), ("force", {"pc_type": "none"}),
    ("coupled force", {"pc_type": "none"}), ("literal", {"pc_type": "jacobi"})])
def test_options_of_the_preconditioners_act(iteration, worse):
    equations, _, _, corrected = ITERATIONS[iteration]
    case = Case(1e5, corrected)
    _, count, _ = solve(case, iteration, ksp_rtol=1e-8)
    found, more, _ = solve(case, iteration, ksp_rtol=1e-11, ksp_max_it=20000, **worse)
    assert more > 1.5 * count
    assert close(found[:1], exact(equations, 1e5, corrected)[:1], 1e-5)


@pytest.mark.parametrize("iteration, part", [
    ("elimination", "stress_"), ("block", "model_"), ("force", "model_"),
    ("coupled block", "model_"), ("coupled literal", "direct_")])
def test_options_of_the_direct_solvers_act(iteration, part):
    equations, _, _, corrected = ITERATIONS[iteration]
    case, expected = Case(1e5, corrected), exact(equations, 1e5, corrected)
    kind = "lu" if iteration == "coupled literal" else "cholesky"
    for package in ("mumps", "petsc"):
        chosen = {part + "pc_type": kind, part + "pc_factor_mat_solver_type": package}
        found, _, _ = solve(case, iteration, **chosen)
        assert close(found, expected, 1e-8), package


@pytest.mark.parallel([1, 3])
@every_iteration
def test_a_failed_solve_raises_on_every_rank(iteration):
    equations, _, _, corrected = ITERATIONS[iteration]
    # One iteration of a direct factorisation solves.
    more = {"pc_type": "none"} if "literal" in iteration else {}
    with pytest.raises(SolveError, match=f"{equations} solve failed: DIVERGED_(MAX_)?ITS? after 1 "
                       f"it.*-{equations}_ksp_max_it"):
        solve(Case(1e5, corrected), iteration, ksp_max_it=1, **more)


@pytest.mark.parametrize("iteration, says", [
    ("force", ["unknowns: membrane stresses, fluid", "in marker space", "exact, by sine"]),
    ("elimination", ["unknowns: fluid, membrane stresses eliminated", "type: gamg"]),
    ("coupled block", ["unknowns: fluid and membrane stresses", "block triangular", "type: gamg",
                       "coupled_poisson_", "coupled_velocity_"]),
    ("literal", ["stresses eliminated", "type: cholesky"]),
    ("coupled literal", ["stresses eliminated", "coupled_direct_", "type: lu"])])
def test_the_view_says_what_solves(iteration, says, tmp_path):
    solve(Case(1e5, ITERATIONS[iteration][3]), iteration, ksp_view=f"ascii:{tmp_path}/view")
    text = (tmp_path / "view").read_text()
    for words in says:
        assert words in text, words


# ---------------------------------------------------------------- counts


COUNTS = {  # scheme, transforms, Krylov method, most iterations to 1e-6, their growth with sigma0
    "force": ("mbe", True, "cg", 12, 1),
    "coupled force": ("be", True, "cg", 12, 1),
    "elimination": ("mbe", False, "cg", 42, 16),
    "block": ("mbe", False, "fgmres", 16, 2),
    "coupled block": ("be", False, "fgmres", 26, 2),
}


@pytest.mark.parametrize("iteration", COUNTS)
def test_iterations_hardly_grow_with_the_stiffness(iteration):
    """64^2, ellipse 0.1 x 0.5, dt = h.  With the stresses eliminated, they may grow."""
    scheme, transforms, ksp_type, most, growth = COUNTS[iteration]
    counts = []
    for sigma0 in (1e5, 1e9, 1e13):
        problem, state = dense.problem(stag_grid_x=64, axes="0.1,0.5", sigma0=sigma0,
                                       bending=0.01, flow="shear", shear_rate=1, delta="yang")
        equations = "momentum" if scheme == "mbe" else "coupled"
        with options(equations, ksp_type, ksp_rtol=1e-6):
            stepper, largest = create(scheme, problem, Controls(fft=transforms)), 0
            for _ in range(3):
                step = stepper.step(state, problem.grid.dx)
                largest, state = max(largest, step.iterations[equations]), step.end
            stepper.destroy()
        counts.append(largest)
    assert max(counts) <= most and max(counts) <= counts[0] + growth


@pytest.mark.parametrize("sigma0", ["1e5", "1e9"])
@pytest.mark.parametrize("method", ["cg", "fgmres"])
def test_the_default_tolerance_is_as_good_for_stiff_membranes(tmp_path, sigma0, method):
    """Where each step begins with a tension that is large and nearly all goes."""
    found = []
    for number, way in enumerate(({"fft": "yes"}, {"momentum_ksp_type": method})):
        folder = tmp_path / str(number)
        run(folder, scheme="mbe", sigma0=sigma0, stag_grid_x="32", ts_dt="0.06", ts_max_steps="6",
            flow="shear", **way)
        with h5py.File(folder / "final.h5") as file:
            found.append(file["fluid/u"][...])
    assert abs(found[0] - found[1]).max() < 1e-5 * np.ptp(found[0])
