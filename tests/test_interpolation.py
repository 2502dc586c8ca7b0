"""Interpolation and spreading against a dense J, and the identities that they must keep."""
import dense
import numpy as np
import pytest
from mpi4py import MPI

from petscib.coupling.interpolation import Interpolation
from petscib.coupling.kernels import KERNELS
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.membranes import shapes
from petscib.membranes.curves import Curves
from petscib.membranes.laws import Tension
from petscib.membranes.membranes import Membranes
from petscib.solvers.force import Near
from petscib.solvers.momentum import Momentum
from petscib.solvers.transforms.diagonal import HelmholtzTransform

DOMAIN = (-1.0, 2.0, 0.5, 2.5)
ROUND_OFF = 1e-13  # relative

pytestmark = pytest.mark.parallel([1, 2, 3])
every_kernel = pytest.mark.parametrize("name", KERNELS)


class Case:
    """Markers on an ellipse over a small grid, random velocity and random force."""

    def __init__(self, name="yang", periodic=(False, False), shift=(0.0, 0.0)):
        self.grid, self.kernel = Grid((17, 14), DOMAIN, periodic=periodic), KERNELS[name]
        self.markers = shapes.ellipse((0.35, 0.5), (0.43, 1.52), 20.0, 11) + shift
        random = np.random.default_rng(5)
        self.force = random.standard_normal(self.markers.shape)
        self.values = random.standard_normal(len(dense.velocity_numbers(self.grid)))
        self.velocity = self.grid.velocity_vector()
        dense.set_velocity(self.grid, self.velocity, self.values)
        self.interpolation = Interpolation(self.grid, self.kernel, self.here(self.markers))

    def here(self, array):
        """What this rank holds of marker data: all on rank 0, nothing elsewhere."""
        return array if MPI.COMM_WORLD.rank == 0 else array[:0]

    def interpolate(self, velocity):
        """Interpolated velocity on all ranks."""
        values = self.interpolation.interpolate(velocity)
        assert len(values) == len(self.here(self.markers))
        return MPI.COMM_WORLD.bcast(values)

    def spread(self, force):
        """Spread force as a new vector."""
        result = self.grid.velocity_vector()
        self.interpolation.spread_add(self.here(force), result)
        return result


@every_kernel
def test_equals_the_dense_matrix(name):
    case = Case(name)
    table = dense.interpolation(case.grid, case.kernel, case.markers)
    expected = (table @ case.values).reshape(-1, 2)
    assert np.allclose(case.interpolate(case.velocity), expected, rtol=0, atol=ROUND_OFF)
    spread = dense.velocity(case.grid, case.spread(case.force))
    expected = 1 / (case.grid.dx * case.grid.dy) * table.T @ case.force.ravel()
    assert np.allclose(spread, expected, rtol=0, atol=ROUND_OFF * np.abs(expected).max())


@every_kernel
@pytest.mark.parametrize("periodic, shift", [
    ((True, False), (1.4, 0.0)), ((True, False), (-7.5, 0.0)), ((False, True), (0.0, 0.8)),
    ((True, True), (-1.3, 5.0))])
def test_markers_cross_periodic_sides(name, periodic, shift):
    """They may also be several boxes away."""
    case = Case(name, periodic, shift)
    table = dense.interpolation(case.grid, case.kernel, case.markers)
    expected = (table @ case.values).reshape(-1, 2)
    assert np.allclose(case.interpolate(case.velocity), expected, rtol=0, atol=ROUND_OFF)
    spread = dense.velocity(case.grid, case.spread(case.force))
    expected = 1 / (case.grid.dx * case.grid.dy) * table.T @ case.force.ravel()
    assert np.allclose(spread, expected, rtol=0, atol=ROUND_OFF * np.abs(expected).max())


@pytest.mark.parametrize("periodic", [(False, False), (True, False)])
def test_by_way_of_the_faces_near_the_markers_it_is_the_same(periodic):
    """Also where the markers are across a periodic side."""
    case = Case(periodic=periodic, shift=(0.9 * periodic[0], 0.0))
    expected = case.interpolate(case.velocity)
    operators = Operators(case.grid, Sides(case.grid))
    fluid = Momentum(operators, 1.0, 1.0, HelmholtzTransform(case.grid))
    fluid.update(0.1)
    near = Near(fluid, case.interpolation.stencil)
    case.interpolation.use(near, near.interpolation(case.interpolation.stencil))
    found = case.interpolate(case.velocity)
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUND_OFF)
    near.destroy()
    fluid.destroy()


def test_spreading_adds():
    case = Case()
    result = case.velocity.copy()
    case.interpolation.spread_add(case.here(case.force), result)
    result.axpy(-1.0, case.spread(case.force))
    assert np.allclose(dense.velocity(case.grid, result), case.values, rtol=0, atol=1e-12)


@every_kernel
def test_spreading_is_adjoint_to_interpolation(name):
    case = Case(name)
    on_grid = case.spread(case.force).dot(case.velocity) * case.grid.cell_area
    on_membrane = np.sum(case.force * case.interpolate(case.velocity))
    size = np.linalg.norm(case.force) * np.linalg.norm(case.values)
    assert on_grid == pytest.approx(on_membrane, abs=ROUND_OFF * size)


@every_kernel
def test_membrane_forces_do_minus_the_work_that_their_stresses_take_up(name):
    """<F[-C^T m], u> = -m . C J u: the power of the forces."""
    case = Case(name)
    curves = Curves([len(case.markers)], [0.31])
    law = Tension(curves, 3.0, np.ones(len(case.markers)))
    rates = Membranes(1, curves, [law], law.rest).rates(case.markers, case.markers)
    stress = np.random.default_rng(6).standard_normal(len(case.markers))
    force = -(rates.T @ stress).reshape(-1, 2)
    on_grid = case.spread(force).dot(case.velocity) * case.grid.cell_area
    rate = rates @ case.interpolate(case.velocity).ravel()
    size = np.linalg.norm(force) * np.linalg.norm(case.values)
    assert on_grid == pytest.approx(-stress @ rate, abs=ROUND_OFF * size)


@every_kernel
def test_force_and_torque_are_conserved(name):
    case = Case(name)
    grid, spread = case.grid, dense.velocity(case.grid, case.spread(case.force))
    split = grid.u_index.size
    u = spread[:split].reshape(grid.u_index.shape) * grid.cell_area
    v = spread[split:].reshape(grid.v_index.shape) * grid.cell_area
    expected = case.force.sum(axis=0)
    assert np.allclose((u.sum(), v.sum()), expected, rtol=0, atol=1e-12)
    torque = (grid.v_points()[0] * v).sum() - (grid.u_points()[1] * u).sum()
    x, y = case.markers.T
    expected = (x * case.force[:, 1] - y * case.force[:, 0]).sum()
    assert torque == pytest.approx(expected, abs=1e-12)


@every_kernel
def test_linear_velocity_is_reproduced(name):
    case = Case(name)
    x, y = case.grid.u_points()
    u = 2.0 + 0.5 * x - 3.0 * y
    x, y = case.grid.v_points()
    v = -1.0 + 4.0 * x + 0.25 * y
    dense.set_velocity(case.grid, case.velocity, np.concatenate((u.ravel(), v.ravel())))
    x, y = case.markers.T
    expected = np.column_stack((2.0 + 0.5 * x - 3.0 * y, -1.0 + 4.0 * x + 0.25 * y))
    assert np.allclose(case.interpolate(case.velocity), expected, rtol=0, atol=1e-12)


@every_kernel
def test_markers_at_their_least_distance_from_the_walls(name):
    """The stencil stays on the grid, also where markers stand on grid lines."""
    case = Case(name)
    reach = case.kernel.reach * np.array([case.grid.dx, case.grid.dy])
    low, high = np.array(DOMAIN[::2]) + reach, np.array(DOMAIN[1::2]) - reach
    markers = np.array([low, high, [low[0], high[1]], [high[0], low[1]], (low + high) / 2])
    case.interpolation = Interpolation(case.grid, case.kernel, case.here(markers))
    case.markers = markers
    table = dense.interpolation(case.grid, case.kernel, markers)
    assert np.allclose(case.interpolate(case.velocity).ravel(), table @ case.values,
                       rtol=0, atol=1e-12)


def test_rows_are_on_rank_0_and_columns_follow_the_grid():
    case = Case()
    (rows, _), (columns, _) = case.interpolation.matrix.getSizes()
    assert rows == 2 * len(case.here(case.markers))
    assert columns == case.velocity.getLocalSize()
