"""How markers move besides being carried: slip along the curve, and areas that are kept."""
import dense
import numpy as np
import pytest
from scipy.linalg import block_diag

from petscib.coupling.kernels import KERNELS
from petscib.coupling.kink import constants
from petscib.fluid.grid import Grid
from petscib.membranes import geometry, shapes
from petscib.membranes.curves import Curves
from petscib.membranes.mobility import AreaProjector, Slip, restore_areas

MU, SPACINGS = 0.7, (0.13, 0.2)


@pytest.fixture
def parts():
    """A closed curve each way around."""
    disturbance = 0.01 * np.random.default_rng(2).standard_normal((18, 2))
    return [shapes.ellipse((0.3, 0.5), (-0.5, 0.1), 20.0, 18) + disturbance,
            shapes.ellipse((0.3, 0.25), (0.6, -0.1), 0.0, 11)[::-1]]


@pytest.fixture
def curves():
    return Curves((18, 11), SPACINGS)


def as_matrix(action, count):
    """What acts on (M, 2) arrays, as a matrix."""
    return np.array([action(row.reshape(-1, 2)).ravel() for row in np.eye(2 * count)]).T


# ---------------------------------------------------------------- slip


@pytest.mark.parametrize("kernel", dense.KINK)
@pytest.mark.parametrize("cells", [(24, 16), (20, 25)])
def test_slip_is_its_formula(parts, curves, kernel, cells):
    grid = Grid(cells, (-1.5, 1.5, -1.0, 1.0))
    slip = Slip(curves, np.concatenate(parts), grid, KERNELS[kernel], MU)
    expected = block_diag(*(
        dense.slip(grid, MU, part, ds, dense.KINK[kernel]) / ds
        for part, ds in zip(parts, SPACINGS)))
    np.testing.assert_allclose(as_matrix(slip.velocity, 29), expected, rtol=0,
                               atol=1e-10 * abs(expected).max())


@pytest.mark.parametrize("kernel", KERNELS)
def test_slip_is_symmetric_positive_and_tangential(parts, curves, kernel):
    grid = Grid((20, 25), (-1.5, 1.5, -1.0, 1.0))
    markers = np.concatenate(parts)
    slip = Slip(curves, markers, grid, KERNELS[kernel], MU)
    table = as_matrix(slip.velocity, 29)
    np.testing.assert_allclose(table, table.T, rtol=0, atol=1e-15 * abs(table).max())
    values = np.linalg.eigvalsh(table)
    assert values[:29] == pytest.approx(0, abs=1e-14 * values[-1]) and (values[29:] > 0).all()
    assert (slip.mobility > 0).all()
    # None for normal forces, and the projector changes nothing of it.
    chord = curves.chords(markers)
    across = np.stack((-chord[:, 1], chord[:, 0]), axis=1)
    assert abs(slip.velocity(across)).max() <= 1e-14 * abs(table).max()
    project = as_matrix(AreaProjector(curves, markers).project, 29)
    np.testing.assert_allclose(project @ table @ project, table, rtol=0,
                               atol=1e-14 * abs(table).max())


def test_slip_at_open_ends_is_that_of_their_one_edge():
    """All markers of a straight line slip alike."""
    grid, kernel = Grid((20, 25), (-1.5, 1.5, -1.0, 1.0)), KERNELS["yang"]
    markers = np.outer(np.arange(8) * 0.1, (0.6, 0.8)) - (0.3, 0.4)
    slip = Slip(Curves([8], [0.1], [False]), markers, grid, kernel, MU)
    straight, diagonal = constants(kernel)
    spacing = np.hypot(0.8 * grid.dx, 0.6 * grid.dy)
    m = 0.8 * grid.dx / spacing, 0.6 * grid.dy / spacing
    factor = straight + 4 * (diagonal - straight) * m[0] ** 2 * m[1] ** 2
    np.testing.assert_allclose(slip.mobility, factor * spacing / (2 * MU * 0.1), rtol=1e-12)
    np.testing.assert_allclose(slip.tangent, np.tile((0.6, 0.8), (8, 1)), rtol=1e-12)


# ---------------------------------------------------------------- areas


def test_projector_is_its_formula(parts, curves):
    projector = AreaProjector(curves, np.concatenate(parts))
    expected = block_diag(*(dense.projector(part, ds) for part, ds in zip(parts, SPACINGS)))
    table = as_matrix(projector.project, 29)
    np.testing.assert_allclose(table, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(table @ table, table, rtol=0, atol=1e-14)
    assert np.linalg.matrix_rank(np.eye(58) - table) == 2


def test_normals_are_the_gradients_of_the_areas(parts, curves):
    markers, step = np.concatenate(parts), 1e-6
    normal = AreaProjector(curves, markers).normal
    for place in np.ndindex(*markers.shape):
        moved = [markers.copy(), markers.copy()]
        moved[0][place] += step
        moved[1][place] -= step
        ahead, behind = (geometry.signed_area(m, curves).sum() for m in moved)
        assert normal[place] == pytest.approx((ahead - behind) / (2 * step), abs=1e-8)


def test_areas_are_quadratic_so_that_the_mean_normal_keeps_them(parts, curves):
    """The change of an area between two configurations is N of their mean times the motion."""
    before = np.concatenate(parts)
    after = before + 0.1 * np.random.default_rng(3).standard_normal(before.shape)
    normal = AreaProjector(curves, (before + after) / 2).normal
    change = curves.sums(np.einsum("ki,ki->k", normal, after - before))
    expected = geometry.signed_area(after, curves) - geometry.signed_area(before, curves)
    np.testing.assert_allclose(change, expected, rtol=1e-12)


def test_component_is_what_the_projector_takes(parts, curves):
    projector = AreaProjector(curves, np.concatenate(parts))
    values = np.random.default_rng(4).standard_normal((29, 2))
    taken = curves.spread(projector.component(values))[:, None] * projector.normal
    np.testing.assert_allclose(values - taken, projector.project(values), rtol=0, atol=1e-15)
    np.testing.assert_allclose(projector.component(3.0 * projector.normal), 3.0, rtol=1e-13)


def test_areas_are_restored_along_the_normals(parts, curves):
    markers = np.concatenate(parts)
    target = geometry.signed_area(markers, curves)
    assert target[0] * target[1] < 0
    wider = markers * 1.02
    restored = restore_areas(curves, wider, target)
    np.testing.assert_allclose(geometry.signed_area(restored, curves), target, rtol=1e-14)
    # All of the shift but what is of second order is along the normals there.
    shift, projector = restored - wider, AreaProjector(curves, wider)
    assert abs(projector.project(shift)).max() <= 1e-3 * abs(shift).max()
    np.testing.assert_allclose(restore_areas(curves, restored, target), restored, rtol=1e-13)


def test_curves_that_enclose_nothing_are_left_alone(parts):
    """An open one, and one around a periodic box."""
    curves = Curves((18, 11), SPACINGS, (True, False), None)
    around = Curves((18, 11), SPACINGS, None, ((0.0, 0.0), (2.0, 0.0)))
    markers = np.concatenate(parts)
    values = np.random.default_rng(5).standard_normal((29, 2))
    for lines in (curves, around):
        projector = AreaProjector(lines, markers)
        assert np.array_equal(projector.project(values)[18:], values[18:])
        assert not np.array_equal(projector.project(values)[:18], values[:18])
        target = geometry.signed_area(markers, lines)
        assert np.isnan(target[1])
        restored = restore_areas(lines, 1.01 * markers, target)
        assert np.array_equal(restored[18:], 1.01 * markers[18:])
        assert geometry.signed_area(restored, lines)[0] == pytest.approx(target[0], rel=1e-14)


def test_a_rank_without_markers():
    curves, nothing = Curves([], []), np.zeros((0, 2))
    grid = Grid((20, 25), (-1.5, 1.5, -1.0, 1.0))
    assert Slip(curves, nothing, grid, KERNELS["yang"], MU).velocity(nothing).shape == (0, 2)
    projector = AreaProjector(curves, nothing)
    assert projector.project(nothing).shape == (0, 2) and projector.component(nothing).size == 0
    assert restore_areas(curves, nothing, np.zeros(0)).shape == (0, 2)
