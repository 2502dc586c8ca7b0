"""Time steps against the paper's equations written out densely, steady flows, and the order."""
import dense
import numpy as np
import pytest

from petscib.fluid.flows import extensional
from petscib.membranes import geometry
from petscib.schemes import SCHEMES, Controls, create

DT, RHO, MU, SIGMA0, BENDING, RATE = 0.05, 1.3, 0.7, 50.0, 0.02, 0.8
PROJECTION = ("ep", "mbe", "mcn")  # the others solve for velocity and pressure together
TIGHT = {f"{solver}_ksp_rtol": 1e-13 for solver in ("momentum", "poisson", "coupled")}


def small_problem(stretch, corrected=False):
    """Ellipse in extensional flow on 12 x 10 cells; the fluid is disturbed without divergence."""
    problem, state = dense.problem(
        stag_grid_x=12, stag_grid_y=10, domain="-1.5,1.5,-1,1", flow="extensional",
        shear_rate=RATE, axes="0.5,0.33", angle=12, markers=14, rho=RHO, mu=MU, sigma0=SIGMA0,
        bending=BENDING, rest_length=0.9, stretch=stretch, kink_correction=corrected,
        conserve_area=corrected)
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
        self.grid, self.kernel, self.ds = problem.grid, problem.kernel, problem.membranes.curves.ds[0]
        self.evolve = problem.evolve
        self.velocity = dense.velocity(self.grid, state.velocity)
        comm = self.grid.comm.tompi4py()
        self.markers, self.stretch = comm.bcast((state.markers, state.stretch))
        self.rest = comm.bcast(problem.membranes.rest_stretch)
        self.inner = dense.inner_faces(self.grid)
        self.gradient, self.divergence = dense.gradient(self.grid), dense.divergence(self.grid)

    def laplacian(self, velocity):
        return dense.laplacian_of_flow(
            self.grid, lambda x, y: extensional(x, y, RATE, self.grid.domain), velocity)

    def edges(self):
        """Difference X_k - X_{k-1}, by loops as in section 2 of the paper."""
        return np.array([self.markers[k] - self.markers[k - 1] for k in range(len(self.markers))])

    def membrane_matrices(self):
        """J (2M x N), F (N x 2M), S (N x M), T (M x N) and A_h (2M x 2M) at the present X."""
        count, ds = len(self.markers), self.ds
        tangent = [edge / np.hypot(*edge) for edge in self.edges()]
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
            self.stretch = np.hypot(*self.edges().T) / self.ds

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


def assert_same(found, expected, tolerance):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize("scheme, stretch", [
    ("ep", "recompute"), ("mbe", "recompute"), ("mbe", "evolve"), ("mcn", "recompute"),
    ("mcn", "evolve"), ("be", "recompute"), ("be", "evolve"), ("cn", "recompute"),
    ("cn", "evolve")])
def test_steps_are_those_of_the_paper(scheme, stretch):
    problem, state = small_problem(stretch)
    paper = PaperStep(problem, state)
    with dense.petsc_options(**TIGHT):
        stepper = create(scheme, problem)
        for number in (1, 2):
            step = stepper.step(state, DT)
            state = step.end
            getattr(paper, scheme)()
            assert state.step == number and state.time == pytest.approx(number * DT)
            markers, stretching = problem.grid.comm.tompi4py().bcast(
                (state.markers, state.stretch))
            assert_same(dense.velocity(problem.grid, state.velocity), paper.velocity, 1e-9)
            assert_same(dense.pressure(problem.grid, state.pressure), paper.pressure, 1e-9)
            assert_same(markers, paper.markers, 1e-10)
            assert_same(stretching, paper.stretch, 1e-10)
        stepper.destroy()


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
        stag_grid_x=24, axes="0.15,0.5", sigma0=1e5, flow="shear", shear_rate=2)
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
