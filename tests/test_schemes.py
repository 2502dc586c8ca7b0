"""Time steps against their equations written out densely, steady flows, and the order."""
from functools import cache

import dense
import numpy as np
import pytest

from petscib.errors import SolveError
from petscib.fluid.flows import extensional
from petscib.membranes import geometry
from petscib.schemes import SCHEMES, Controls, create

DT, RHO, MU, SIGMA0, BENDING, RATE = 0.05, 1.3, 0.7, 50.0, 0.02, 0.8
IMPLICIT = [name for name in SCHEMES if name != "ep"]
PROJECTION = ("ep", "mbe", "mcn")  # the others solve for velocity and pressure together
TIGHT = {f"{solver}_ksp_rtol": 1e-13 for solver in ("momentum", "poisson", "coupled")}


def small_problem(stretch, kink=False, area=False, kernel="yang"):
    """Ellipse in extensional flow on 12 x 10 cells; the fluid is disturbed without divergence."""
    problem, state = dense.problem(
        stag_grid_x=12, stag_grid_y=10, domain="-1.5,1.5,-1,1", flow="extensional",
        shear_rate=RATE, axes="0.5,0.33", angle=12, markers=14, rho=RHO, mu=MU, sigma0=SIGMA0,
        bending=BENDING, rest_length=0.9, stretch=stretch, delta=kernel, kink_correction=kink,
        conserve_area=area)
    grid = problem.grid
    stream = np.pad(0.03 * np.random.default_rng(1).standard_normal((grid.n - 1, grid.m - 1)), 1)
    disturbance = np.concatenate(((np.diff(stream, axis=0) / grid.dy).ravel(),
                                  (-np.diff(stream, axis=1) / grid.dx).ravel()))
    dense.set_velocity(grid, state.velocity, dense.velocity(grid, state.velocity) + disturbance)
    return problem, state


class PaperStep:
    """One step of a scheme by the equations of Hu & Lai, with dense matrices.

    `velocity`, `pressure`, `markers` and `stretch` are replaced by those at the new time.
    """

    def __init__(self, problem, state):
        self.grid, self.kernel = problem.grid, problem.kernel
        self.ds = problem.membranes.constants.curves.ds[0]
        self.evolve = problem.evolve
        self.velocity = dense.velocity(self.grid, state.velocity)
        comm = self.grid.comm.tompi4py()
        self.markers, self.stretch = comm.bcast((state.markers, state.stretch))
        self.rest = problem.membranes.constants.rest_stretch
        self.inner = dense.inner_faces(self.grid)
        self.gradient, self.divergence = dense.gradient(self.grid), dense.divergence(self.grid)

    def laplacian(self, velocity):
        return dense.laplacian_of_flow(
            self.grid, lambda x, y: extensional(x, y, RATE, self.grid.domain), velocity)

    @staticmethod
    def edges(markers):
        """Difference X_k - X_{k-1}, by loops as in section 2 of the paper."""
        return np.array([markers[k] - markers[k - 1] for k in range(len(markers))])

    def membrane_matrices(self):
        """J (2M x N), F (N x 2M), S (N x M), T (M x N) and A_h (2M x 2M) at the present X."""
        count, ds = len(self.markers), self.ds
        tangent = [edge / np.hypot(*edge) for edge in self.edges(self.markers)]
        interpolate = dense.interpolation(self.grid, self.kernel, self.markers)
        spread = ds / (self.grid.dx * self.grid.dy) * interpolate.T
        of_tension = np.zeros((2 * count, count))  # D_s (sigma tau), entry k at k - 1/2
        of_velocity = np.zeros((count, 2 * count))  # (U_k - U_{k-1}) / ds . tau_{k-1/2}
        for k in range(count):
            ahead = (k + 1) % count
            for i in range(2):
                of_tension[2 * k + i, ahead] += tangent[ahead][i] / ds
                of_tension[2 * k + i, k] -= tangent[k][i] / ds
                of_velocity[k, 2 * k + i] += tangent[k][i] / ds
                of_velocity[k, 2 * ((k - 1) % count) + i] -= tangent[k][i] / ds
        return (interpolate, spread, spread @ of_tension, of_velocity @ interpolate,
                dense.fourth_difference(count, ds))

    def solve(self, matrix, rhs):
        """Solve for the inner faces; wall faces keep their velocity."""
        inner, result = self.inner, self.velocity.copy()
        result[inner] = np.linalg.solve(
            matrix[np.ix_(inner, inner)],
            rhs[inner] - matrix[np.ix_(inner, ~inner)] @ self.velocity[~inner])
        return result

    def project(self, intermediate, viscosity):
        """Equations 3.20 to 3.22 (3.26 to 3.28); the last term of 3.22 is left out."""
        source = self.divergence @ intermediate / DT
        phi = np.linalg.pinv(self.divergence @ self.gradient) @ (source - source.mean())
        velocity = intermediate - DT * self.gradient @ phi
        self.pressure = RHO * phi - viscosity * self.divergence @ intermediate
        return velocity

    def carry_on(self, velocity, displacement, stretch):
        self.velocity = velocity
        self.markers = self.markers + displacement.reshape(-1, 2)
        self.stretch = stretch
        if not self.evolve:
            self.stretch = np.hypot(*self.edges(self.markers).T) / self.ds

    def ep(self):
        interpolate, spread, tension, _, fourth = self.membrane_matrices()
        force = tension @ (SIGMA0 * (self.stretch - self.rest))
        force -= BENDING * spread @ fourth @ self.markers.ravel()
        laplacian = dense.laplacian(self.grid)
        star = self.solve(RHO / DT * np.eye(len(laplacian)) - MU * laplacian,
                          RHO / DT * self.velocity + force + MU * self.from_walls())
        velocity = self.project(star, MU)
        self.carry_on(velocity, DT * interpolate @ velocity, self.stretch)

    def from_walls(self):
        """The walls' part of the Laplacian: that of zero inside."""
        return self.laplacian(np.where(self.inner, 0.0, self.velocity))

    def mbe(self):
        interpolate, spread, tension, rate, fourth = self.membrane_matrices()
        # 3.19, with the bending force A.4
        matrix = RHO / DT * np.eye(len(self.velocity)) - MU * dense.laplacian(self.grid)
        matrix -= SIGMA0 * DT * tension @ rate
        matrix += BENDING * DT * spread @ fourth @ interpolate
        rhs = RHO / DT * self.velocity + MU * self.from_walls()
        rhs += tension @ (SIGMA0 * (self.stretch - self.rest))
        rhs -= BENDING * spread @ fourth @ self.markers.ravel()
        star = self.solve(matrix, rhs)
        velocity = self.project(star, MU)
        self.carry_on(velocity, DT * interpolate @ velocity,  # 3.23, 3.24
                      self.stretch + DT * rate @ star)

    def mcn(self):
        interpolate, spread, tension, rate, fourth = self.membrane_matrices()
        old = self.velocity
        # 3.25; the bending force is that of the mean of X^n and X^n + dt J (u* + u^n) / 2
        matrix = RHO / DT * np.eye(len(old)) - MU / 2 * dense.laplacian(self.grid)
        matrix -= SIGMA0 * DT / 4 * tension @ rate
        matrix += BENDING * DT / 4 * spread @ fourth @ interpolate
        rhs = RHO / DT * old + MU / 2 * (self.laplacian(old) + self.from_walls())
        rhs += tension @ (SIGMA0 * (self.stretch - self.rest))
        rhs += SIGMA0 * DT / 4 * tension @ (rate @ old)
        rhs -= BENDING * spread @ fourth @ (self.markers.ravel() + DT / 4 * interpolate @ old)
        star = self.solve(matrix, rhs)
        velocity = self.project(star, MU / 2)
        self.carry_on(velocity, DT * interpolate @ (velocity + old) / 2,  # 3.29, 3.30
                      self.stretch + DT * rate @ (star + old) / 2)

    def be(self):
        self.coupled(1.0)

    def cn(self):
        self.coupled(0.5)

    def coupled(self, theta):
        """3.3 to 3.9 (theta 1) and 3.10 to 3.16 (1/2): velocity and pressure in one system."""
        interpolate, spread, tension, rate, fourth = self.membrane_matrices()
        old, inner = self.velocity, self.inner
        implicit = (MU * dense.laplacian(self.grid) + SIGMA0 * theta * DT * tension @ rate
                    - BENDING * theta * DT * spread @ fourth @ interpolate)
        matrix = RHO / DT * np.eye(len(old)) - theta * implicit
        rhs = RHO / DT * old + (1 - theta) * implicit @ old + MU * self.from_walls()
        rhs += tension @ (SIGMA0 * (self.stretch - self.rest))
        rhs -= BENDING * spread @ fourth @ self.markers.ravel()
        divergence = self.divergence[:, inner]
        saddle = np.block([
            [matrix[np.ix_(inner, inner)], self.gradient[inner]],
            [divergence, np.zeros((len(divergence), len(divergence)))]])
        walls = old[~inner]
        rhs = np.concatenate((rhs[inner] - matrix[np.ix_(inner, ~inner)] @ walls,
                              -self.divergence[:, ~inner] @ walls))
        answer = np.linalg.lstsq(saddle, rhs, rcond=1e-12)[0]  # the pressure of zero mean
        velocity = old.copy()
        velocity[inner] = answer[: inner.sum()]
        self.pressure = answer[inner.sum():]
        mean = theta * velocity + (1 - theta) * old
        self.carry_on(velocity, DT * interpolate @ mean, self.stretch + DT * rate @ mean)


class CorrectedStep(PaperStep):
    """One step of an implicit scheme with kink correction and area projector (or without either).

    Nothing is eliminated from the equations.  `constants` is None without kink correction.
    """

    def __init__(self, problem, state, constants, area):
        super().__init__(problem, state)
        self.constants, self.conserve_area = constants, area
        self.first_area = dense.area(self.markers)

    def stage(self, theta, guess, coupled):
        """w, p, Pi J, K F and T, for a tangent between X^n and `guess`; for X^n, at X^n."""
        grid, ds, step = self.grid, self.ds, theta * DT
        ahead, behind = self.edges(guess), self.edges(self.markers)
        lengths = np.hypot(*ahead.T) + np.hypot(*behind.T)
        rate = dense.surface_divergence((ahead + behind) / lengths[:, None], ds)
        middle = (guess + self.markers) / 2
        carry = dense.interpolation(grid, self.kernel, middle if theta < 1 else self.markers)
        if self.conserve_area:
            carry = dense.projector(middle, ds) @ carry
        slip = np.zeros((2 * len(guess), 2 * len(guess)))
        if self.constants:
            slip = dense.slip(grid, MU, middle, ds, self.constants)
        bending = BENDING * dense.fourth_difference(len(guess), ds)
        force = -rate.T @ (SIGMA0 * (self.stretch - self.rest)) - bending @ self.markers.ravel()
        stiffness = SIGMA0 * rate.T @ rate + bending
        w, pressure, force = dense.stage(
            grid, RHO / step, MU, RHO / step * self.velocity + MU * self.from_walls(),
            self.velocity[~self.inner], carry, slip / ds, step * ds * stiffness, ds * force,
            coupled)
        return w, pressure, carry, slip @ force / ds, rate

    def shifted(self, markers):
        """Markers at the area of the start, moved along their N by Newton's method."""
        if not self.conserve_area:
            return markers
        normal, shift = dense.area_gradient(markers, self.ds).reshape(-1, 2), 0.0
        for _ in range(4):
            moved = markers + shift * normal
            slope = dense.area_gradient(moved, self.ds) @ normal.ravel()
            shift += (self.first_area - dense.area(moved)) / slope
        return markers + shift * normal

    def advance(self, scheme):
        """Take a step of mbe, mcn, be, cn, gbe or gcn."""
        theta, old = 1.0 if scheme.endswith("be") else 0.5, self.velocity
        guess, change = self.markers, 1.0
        while change > 1e-13:  # in one pass for the linear schemes
            w, pressure, carry, slip, rate = self.stage(theta, guess, scheme[0] != "m")
            motion = carry @ w + slip
            new = self.markers + DT * motion.reshape(-1, 2)
            change = np.abs(new - guess).max() if scheme[0] == "g" else 0.0
            guess = new
        stretch = self.stretch + DT * rate @ motion
        velocity = old + (w - old) / theta
        if scheme[0] == "m":
            velocity = self.project(velocity, theta * MU)
            motion = carry @ (theta * velocity + (1 - theta) * old) + slip
        else:
            self.pressure = pressure
        new = self.shifted(self.markers + DT * motion.reshape(-1, 2))
        self.carry_on(velocity, (new - self.markers).ravel(), stretch)


def assert_same(found, expected, tolerance):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


def assert_steps(problem, state, scheme, expected, controls=None, **options):
    """Two steps end with the expected velocities, pressures, markers and stretchings."""
    with dense.petsc_options(**{**TIGHT, **options}):
        stepper = create(scheme, problem, controls or Controls())
        for number, (velocity, pressure, markers, stretch) in enumerate(expected, 1):
            state = stepper.step(state, DT).end
            assert state.step == number and state.time == pytest.approx(number * DT)
            found = problem.grid.comm.tompi4py().bcast((state.markers, state.stretch))
            assert_same(found[0], markers, 1e-10)
            assert_same(found[1], stretch, 1e-9)
            assert_same(dense.velocity(problem.grid, state.velocity), velocity, 1e-9)
            assert_same(dense.pressure(problem.grid, state.pressure), pressure, 1e-9)
        stepper.destroy()


def two_steps(stepper, scheme):
    answers = []
    for _ in range(2):
        scheme()
        answers.append((stepper.velocity, stepper.pressure, stepper.markers, stepper.stretch))
    return answers


@pytest.mark.parametrize("scheme, stretch", [
    ("ep", "recompute"), ("mbe", "recompute"), ("mbe", "evolve"), ("mcn", "recompute"),
    ("mcn", "evolve"), ("be", "recompute"), ("be", "evolve"), ("cn", "recompute"),
    ("cn", "evolve")])
def test_steps_are_those_of_the_paper(scheme, stretch):
    """Without kink correction and area projector, by the paper's formulas as they stand."""
    problem, state = small_problem(stretch)
    paper = PaperStep(problem, state)
    assert_steps(problem, state, scheme, two_steps(paper, getattr(paper, scheme)))


@cache
def corrected_steps(scheme, kernel, kink, area, stretch):
    problem, state = small_problem(stretch, kink, area, kernel)
    stepper = CorrectedStep(problem, state, dense.KINK[kernel] if kink else None, area)
    return two_steps(stepper, lambda: stepper.advance(scheme))


# The iterations of `petscib.solvers.system`, by the options that choose them.
ITERATIONS = {"multigrid": {}, "transforms": {}, "block": {"momentum_ksp_type": "fgmres"}}
WAYS = [(scheme, way) for scheme in IMPLICIT for way in ITERATIONS
        if way != "block" or scheme in PROJECTION]
PARTLY = [(*case, *switches) for case in WAYS for switches in (
    (True, False), (False, True), (False, False)) if switches[0] or case[1] != "block"]


def check_corrected(scheme, kernel, kink, area, way, stretch="recompute"):
    problem, state = small_problem(stretch, kink, area, kernel)
    controls = Controls(picard_rtol=1e-12, fft=way == "transforms")
    assert_steps(problem, state, scheme, corrected_steps(scheme, kernel, kink, area, stretch),
                 controls, **ITERATIONS[way])


@pytest.mark.parametrize("kernel", dense.KINK)
@pytest.mark.parametrize("scheme, way", WAYS)
def test_corrected_steps(scheme, way, kernel):
    check_corrected(scheme, kernel, True, True, way)


@pytest.mark.parametrize("scheme, way, kink, area", PARTLY)
def test_steps_with_one_correction_or_none(scheme, way, kink, area):
    check_corrected(scheme, "yang", kink, area, way)


@pytest.mark.parametrize("scheme", IMPLICIT)
def test_corrected_steps_with_evolved_stretching(scheme):
    check_corrected(scheme, "bspline43", True, True, "transforms", "evolve")


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_new_velocity_is_divergence_free_and_keeps_the_walls(scheme):
    problem, state = small_problem("recompute")
    with dense.petsc_options(**TIGHT):
        stepper = create(scheme, problem)
        step = stepper.step(state, DT)
        stepper.destroy()
    divergence = problem.grid.pressure_vector()
    problem.operators.divergence.mult(step.end.velocity, divergence)
    # The geometric schemes set their own tolerance, relative to the markers' displacement.
    tolerance = 1e-6 if scheme.startswith("g") else 1e-9
    assert np.abs(dense.pressure(problem.grid, divergence)).max() <= tolerance
    walls = ~dense.inner_faces(problem.grid)
    new, old = (dense.velocity(problem.grid, s.velocity)[walls] for s in (step.end, state))
    assert np.abs(new - old).max() <= 1e-14
    assert abs(dense.pressure(problem.grid, step.end.pressure).mean()) <= 1e-10


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_start_of_a_step_is_left_alone(scheme):
    problem, state = small_problem("evolve" if scheme != "ep" else "recompute")
    before = (dense.velocity(problem.grid, state.velocity),
              dense.pressure(problem.grid, state.pressure), state.markers.copy(),
              state.stretch.copy())
    with dense.petsc_options(**TIGHT):
        stepper = create(scheme, problem)
        step = stepper.step(state, DT)
        stepper.destroy()
    after = (dense.velocity(problem.grid, state.velocity),
             dense.pressure(problem.grid, state.pressure), state.markers, state.stretch)
    assert all(np.array_equal(a, b) for a, b in zip(before, after))
    assert step.start is state and not np.array_equal(step.end.markers, state.markers)


# ---------------------------------------------------------------- flows without a vesicle


def final_velocity(scheme, problem, state, dt, steps):
    with dense.petsc_options(**TIGHT):
        stepper = create(scheme, problem)
        for _ in range(steps):
            state = stepper.step(state, dt).end
        stepper.destroy()
    return dense.velocity(problem.grid, state.velocity)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("flow", ["shear", "extensional"])
def test_linear_flows_are_kept_exactly(scheme, flow):
    problem, state = dense.problem(flow=flow, shear_rate=2, vesicles=0, stag_grid_x=16,
                                   stag_grid_y=12)
    start = dense.velocity(problem.grid, state.velocity)
    end = final_velocity(scheme, problem, state, 0.1, 3)
    assert np.abs(end - start).max() <= 1e-11


def poiseuille_error(scheme, cells, steps):
    """Largest change of Poiseuille flow, of largest speed 1/2, in unit time."""
    problem, state = dense.problem(scene="driven", flow="poiseuille", stag_grid_x=cells)
    start = dense.velocity(problem.grid, state.velocity)
    end = final_velocity(scheme, problem, state, 1 / steps, steps)
    return np.abs(end - start).max()


@pytest.mark.parametrize("scheme", [name for name in SCHEMES if name in PROJECTION])
def test_poiseuille_flow_is_kept_to_first_order_in_time(scheme):
    """The projection lets the fluid slip along the walls by dt times the pressure gradient."""
    errors = [poiseuille_error(scheme, 16, steps) for steps in (32, 64)]
    assert errors[0] <= 1 / 32
    assert errors[0] / errors[1] >= 1.7


@pytest.mark.parametrize("scheme", [name for name in SCHEMES if name not in PROJECTION])
def test_poiseuille_flow_is_kept_to_second_order_in_space(scheme):
    errors = [poiseuille_error(scheme, cells, 20) for cells in (16, 32)]
    assert errors[0] <= 0.5 / 16**2
    assert errors[0] / errors[1] >= 3.4


# ---------------------------------------------------------------- order in time


def observed_orders(scheme, counts, end, controls=None, **values):
    """Mean orders in X and u from numbers of steps, each twice the last, to the same time."""
    answers = []
    for steps in counts:
        problem, state = dense.problem(**values)
        with dense.petsc_options(momentum_ksp_rtol=1e-11, poisson_ksp_rtol=1e-11,
                                 coupled_ksp_rtol=1e-11):
            stepper = create(scheme, problem, controls or Controls())
            for _ in range(steps):
                state = stepper.step(state, end / steps).end
            stepper.destroy()
        answers.append((state.markers, dense.velocity(problem.grid, state.velocity)))
    differences = [[np.linalg.norm(fine - coarse) for coarse, fine in zip(found, found[1:])]
                   for found in zip(*answers)]
    return [np.log2(found[0] / found[-1]) / (len(counts) - 2) for found in differences]


@pytest.mark.parametrize("scheme", ["mbe", "be", "gbe"])
def test_backward_euler_is_first_order_in_time(scheme):
    orders = observed_orders(scheme, (32, 64, 128), 0.4, stag_grid_x=16, axes="0.3,0.4", sigma0=5,
                             rest_length=0.8, rho=10)
    assert all(0.8 <= order <= 1.2 for order in orders)


def test_gcn_is_second_order_in_time():
    """A nearly inextensible vesicle in shear flow, from the incompatible start.

    What is left of the start's oscillation dies faster than the square of the time step, but not
    evenly; so the order of u is the mean of two.
    """
    order_x, order_u = observed_orders(
        "gcn", (20, 40, 80, 160), 0.5, Controls(startup=1, picard_rtol=1e-11, fft=True),
        stag_grid_x=24, axes="0.15,0.5", sigma0=1e5, flow="shear", shear_rate=2,
        delta="yang")
    assert order_x >= 1.8 and order_u >= 1.8


@pytest.mark.parametrize("scheme, largest", [("be", 2e-3), ("gbe", 1e-8), ("gcn", 1e-8)])
def test_perimeter_at_high_stiffness(scheme, largest):
    """Ellipse (0.1, 0.5), sigma0 = 1e9, dt = h: gbe and gcn keep the length they have."""
    problem, state = dense.problem(stag_grid_x=32, axes="0.1,0.5", sigma0=1e9, bending=0.01)
    stepper = create(scheme, problem, Controls(startup=scheme == "gcn"))
    start = geometry.perimeter(state.markers)
    for _ in range(8):
        state = stepper.step(state, 2 / 32).end
        assert abs(geometry.perimeter(state.markers) / start - 1) <= largest
    stepper.destroy()


# ---------------------------------------------------------------- the tangent iteration


def elongated(**values):
    return dense.problem(stag_grid_x=24, flow="shear", shear_rate=1.0, axes="0.25,0.4", sigma0=1e5,
                         bending=0.01, fft=True, **values)


@pytest.mark.parametrize("scheme", ["gbe", "gcn"])
def test_passes_make_the_stretching_that_of_the_markers(scheme):
    """Which takes more of them the more accurate it is to be; errors are below the tolerance."""
    passes, errors = [], []
    for tolerance in (1e-3, 1e-6, 1e-9):
        problem, state = elongated(stretch="evolve")
        stepper = create(scheme, problem, Controls(fft=True, picard_rtol=tolerance))
        step = stepper.step(state, 0.1)
        moved = np.hypot(*(step.end.markers - state.markers).T).max()
        stretch = problem.membranes.curves.stretching(step.end.markers)
        errors.append(np.abs(step.end.stretch - stretch).max()
                      * problem.membranes.curves.ds[0] / moved)
        passes.append(step.iterations["picard"])
        assert errors[-1] <= tolerance
        stepper.destroy()
    assert passes[0] < passes[1] < passes[2] <= 20 and errors[2] < 1e-3 * errors[0]


@pytest.mark.parametrize("scheme", ["gbe", "gcn"])
def test_too_few_passes_fail_the_step(scheme):
    problem, state = elongated()
    before = state.markers.copy()
    stepper = create(scheme, problem, Controls(fft=True, picard_max_it=2))
    with pytest.raises(SolveError, match=r"did not converge in 2 passes \(the markers still"):
        stepper.step(state, 0.1)
    np.testing.assert_array_equal(state.markers, before)
    stepper.destroy()
