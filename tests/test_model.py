"""Sparse matrices in marker space: products, factorisations, the model of the fluid's answer."""
import dense
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix, random

from petscib import entries
from petscib.coupling.interpolation import Interpolation
from petscib.coupling.kernels import KERNELS
from petscib.fluid.grid import Grid
from petscib.membranes import shapes
from petscib.membranes.curves import Curves
from petscib.membranes.laws import Bending, Tension
from petscib.membranes.membranes import Membranes
from petscib.membranes.mobility import AreaProjector, Slip
from petscib.solvers import model, overlap
from petscib.solvers.cholesky import Cholesky
from petscib.solvers.elimination import StressMatrix
from petscib.solvers.markers import MarkerOperators
from petscib.solvers.model import MarkerModel, fit_pole
from petscib.solvers.overlap import Overlap
from petscib.solvers.product import Product

INTERVAL, RHO, MU = 0.02, 1.3, 0.7
COUNTS, SPACINGS, CLOSED = (20, 14, 12), (0.1, 0.07, 0.06), (True, True, False)


@pytest.fixture(autouse=True)
def no_defaults_left():
    yield
    entries.present().withdraw()


# ---------------------------------------------------------------- products


def sparse(rows, columns, seed):
    matrix = random(rows, columns, 0.3, "csr", random_state=seed)
    matrix.sort_indices()
    return matrix


def test_products_are_those_of_the_dense_matrices():
    first, second = sparse(7, 5, 1), sparse(5, 9, 2)
    product = Product(first, second)
    for seed in (3, 4):
        generator = np.random.default_rng(seed)
        first.data, second.data = (generator.standard_normal(part.nnz) for part in (first, second))
        found = product.csr(product.values(first.data, second.data))
        np.testing.assert_allclose(found.toarray(), first.toarray() @ second.toarray(), atol=1e-14)


def test_entries_of_products_stay_where_they_are():
    """Also those that are zero, or cancel."""
    first = csr_matrix(np.array([[1.0, 1.0], [0.0, 2.0]]))
    second = csr_matrix(np.array([[1.0, 3.0], [1.0, 0.0]]))
    product = Product(first, second)
    for a, b in ((np.ones(3), np.ones(3)), (np.array([1.0, -1.0, 0.0]), np.ones(3))):
        found = product.csr(product.values(a, b))
        assert found.nnz == 3 and found.indices.tolist() == [0, 1, 0]
        assert found.indptr.tolist() == [0, 2, 3]
    assert found.toarray().tolist() == [[0.0, 1.0], [0.0, 0.0]]


# ---------------------------------------------------------------- factorisations


def quasidefinite(seed=5, size=30):
    """A sparse symmetric matrix, positive on half of the unknowns, negative on the rest."""
    half = size // 2
    coupling = random(half, size - half, 0.2, random_state=seed).toarray()
    table = np.block([[np.diag(np.arange(1.0, half + 1)), coupling],
                      [coupling.T, -np.diag(np.arange(2.0, size - half + 2))]])
    table[0, 1] = table[1, 0] = 0.5
    return table


def upper(table):
    matrix = csr_matrix(np.triu(table))
    matrix.sort_indices()
    return matrix


@pytest.mark.parametrize("package", [None, "petsc", "mumps"])
def test_factorisation_is_an_inverse(package):
    options = {"test_pc_factor_mat_solver_type": package} if package else {}
    with dense.petsc_options(**options):
        direct = Cholesky("test_")
        rhs = np.random.default_rng(6).standard_normal(30)
        # The second has the entries of the first, the third others and another size.
        for table in (quasidefinite(), 3 * quasidefinite(), quasidefinite(7, 24)):
            direct.factor(upper(table))
            answer = direct.solve(rhs[: len(table)])
            np.testing.assert_allclose(table @ answer, rhs[: len(table)], rtol=0, atol=1e-12)
            assert direct.trouble == ""
        direct.destroy()


@pytest.mark.parametrize("package", [None, "petsc", "mumps"])
def test_entries_that_are_zero_for_once_are_factored_too(package):
    options = {"test_pc_factor_mat_solver_type": package} if package else {}
    matrix, rhs = upper(quasidefinite()), np.ones(30)
    rows = np.repeat(np.arange(30), np.diff(matrix.indptr))
    beside = np.flatnonzero(rows != matrix.indices)
    with dense.petsc_options(**options):
        direct = Cholesky("test_")
        for empty in (beside[::2], beside[1::2], beside[:0]):
            values = matrix.data.copy()
            values[empty] = 0.0
            one = csr_matrix((values, matrix.indices, matrix.indptr))
            direct.factor(one)
            table = one.toarray() + np.triu(one.toarray(), 1).T
            np.testing.assert_allclose(table @ direct.solve(rhs), rhs, rtol=0, atol=1e-12)
        direct.destroy()


def test_factorisation_that_fails_says_so_in_place_of_an_answer():
    with dense.petsc_options(test_pc_factor_mat_solver_type="petsc", test_pc_type="cholesky",
                             test_pc_factor_shift_type="none",
                             test_pc_factor_mat_ordering_type="natural"):
        direct, entries = Cholesky("test_"), (np.array([0, 1, 1]), np.array([0, 2, 3]))
        direct.factor(csr_matrix((np.array([0.0, 1.0, 1.0]), *entries)))
        assert np.isnan(direct.solve(np.ones(2))).all()
        assert "DIVERGED" in direct.trouble
        direct.factor(csr_matrix((np.array([1.0, 0.5, 1.0]), *entries)))
        np.testing.assert_allclose(direct.solve(np.array([2.0, 1.0])), [2.0, 0.0], atol=1e-14)
        assert direct.trouble == ""
        direct.destroy()


def test_nothing_is_factored_where_there_is_nothing():
    direct = Cholesky("test_")
    direct.factor(csr_matrix((0, 0)))
    assert direct.solve(np.empty(0)).shape == (0,) and direct._matrix is None
    direct.destroy()


# ---------------------------------------------------------------- the stresses' own matrix


class Case:
    """Two closed curves and an open one with tension and bending, in one configuration."""

    def __init__(self, kernel="yang", sigma0=50.0, cells=(40, 32)):
        self.grid, self.kernel = Grid(cells, (-1.5, 1.5, -1.0, 1.0)), KERNELS[kernel]
        along = np.linspace(0.0, 1.0, COUNTS[2])[:, None]
        self.parts = [shapes.ellipse((0.3, 0.4), (-0.5, 0.1), 10.0, COUNTS[0]),
                      shapes.ellipse((0.15, 0.2), (0.6, -0.3), 70.0, COUNTS[1]),
                      (0.1, 0.5) + along * (0.7, 0.1)]
        self.curves = Curves(COUNTS, SPACINGS, CLOSED)
        rest = np.ones(len(self.curves.edges))
        laws = [Tension(self.curves, sigma0, rest), Bending(self.curves, 0.02)]
        self.membranes = Membranes(3, self.curves, laws, rest)

    def markers(self, turn):
        markers = np.concatenate(self.parts)
        return markers @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def operators(self, turn=0.0):
        markers, turned = self.markers(0.0), self.markers(turn)
        return MarkerOperators(
            Interpolation(self.grid, self.kernel, turned), self.membranes.rates(markers, turned),
            Slip(self.curves, turned, self.grid, self.kernel, MU),
            AreaProjector(self.curves, turned))

    def new_model(self, share=0.5, prefix="test_model_"):
        return MarkerModel(self.curves, self.grid, self.kernel, RHO, MU, share, prefix)


def slip_matrix(slip):
    """K for forces on the markers, by its columns."""
    count = 2 * len(slip.mobility)
    return np.array([slip.velocity(row.reshape(-1, 2)).ravel() for row in np.eye(count)]).T


def test_stress_matrix():
    case, matrix = Case(), StressMatrix()
    shapes_seen = set()
    for interval, turn in ((0.02, 0.0), (0.5, 0.3)):
        operators = case.operators(turn)
        found = matrix.upper(interval, operators)
        rates = operators.rates.toarray()
        expected = np.eye(len(rates)) / interval + rates @ slip_matrix(operators.slip) @ rates.T
        np.testing.assert_allclose(found.toarray(), np.triu(expected), rtol=0,
                                   atol=1e-13 * abs(expected).max())
        shapes_seen.add((found.nnz, tuple(found.indices), tuple(found.indptr)))
    assert len(shapes_seen) == 1


# ---------------------------------------------------------------- the model


def symbol_by_quadrature(kernel, h, k, interval, share):
    """What along a straight membrane is left of the fluid's answer but for exp(-s2 h^2 k^2)."""
    def spread(weight, radius):
        return quad(lambda r: r**2 * weight(np.array([r]))[0], -radius, radius,
                    points=np.arange(-radius, radius + 0.5, 0.5), limit=200)[0]

    variance = (spread(kernel.along, kernel.along_radius)
                + spread(kernel.across, kernel.across_radius)) / 2
    return share * np.array([quad(
        lambda q, one=one: np.exp(-variance * (h * q) ** 2) / (2 * np.pi)
        / (MU * (one**2 + q**2) + RHO / interval), -np.inf, np.inf)[0] for one in k])


def common_faces(case, turn):
    """J J^T / (dx dy) as a dense matrix."""
    table = dense.interpolation(case.grid, case.kernel, case.markers(turn))
    return table @ table.T / case.grid.cell_area


@pytest.mark.parametrize("name, crowded", [("yang", 0.2), ("bspline43", 0.2), ("yang", 0.47)])
def test_model_is_its_formula(monkeypatch, name, crowded):
    """Pole, sampled kernel, second differences and the markers' common faces as dense matrices.

    The grid is so coarse that two of the curves have fewer stations than markers.  In the last case
    the third curve's markers count as too close together to share faces.
    """
    monkeypatch.setattr(model, "CROWDED", crowded)
    case = Case(name, cells=(20, 16))
    share, h = 0.5, np.sqrt(case.grid.dx * case.grid.dy)
    tool, operators = case.new_model(share), case.operators(0.2)
    tool.update(INTERVAL, operators)

    k = np.geomspace(2 * np.pi / 2.0, 3 / h, 60)
    symbol = symbol_by_quadrature(case.kernel, h, k, INTERVAL, share)
    low = np.hypot(np.pi, np.sqrt(RHO / (MU * INTERVAL)))
    weight = fit_pole(k, symbol, low)
    answers = []
    for count, ds, closed in zip(COUNTS, SPACINGS, CLOSED):
        length = count * ds if closed else (count - 1) * ds
        stations = min(count, int(np.ceil(length / (model.STATIONS * h))) + (not closed))
        spacing = length / (stations if closed else stations - 1)
        apart = np.arange(count)[:, None] * ds - np.arange(stations) * spacing
        images = [apart + n * length for n in (-2, -1, 0, 1, 2)] if closed else [apart]
        # Linear between stations: each stands for a hat of its samples.
        sampled = 0.0
        for number in range(1 - model.SAMPLES, model.SAMPLES):
            r = (np.array(images) + spacing * number / model.SAMPLES) / h
            here = (case.kernel.along(r) + case.kernel.across(r)).sum(axis=0)
            sampled = sampled + (1 - abs(number) / model.SAMPLES) * here
        sampled /= sampled.sum(axis=1, keepdims=True)
        difference = dense.to_half_points(stations, spacing)
        second = -difference.T @ difference
        if not closed:
            second = -difference[1:].T @ difference[1:]
        inverse = weight * np.linalg.inv(low**2 * np.eye(stations) - second)
        answers.append(np.kron(sampled @ inverse @ sampled.T / spacing, np.eye(2)))
    rates = operators.rates.toarray()
    sharing = np.repeat(np.repeat(SPACINGS, COUNTS) >= crowded * h, 2)
    assert sharing.all() == (crowded == 0.2) and sharing.any()
    local = common_faces(case, 0.2) / (RHO / INTERVAL + 4 * MU / h**2) * np.outer(sharing, sharing)
    mobility = block_diag(*answers) + local + slip_matrix(operators.slip)
    expected = np.eye(len(rates)) / INTERVAL + rates @ mobility @ rates.T
    rhs = np.random.default_rng(8).standard_normal(len(rates))
    found = tool.solve(rhs)
    # The fit looks at the symbol relatively, and quadrature gives it to some eight digits.
    np.testing.assert_allclose(expected @ found, rhs, rtol=0, atol=1e-6 * abs(rhs).max())
    tool.destroy()


@pytest.mark.parametrize("interval, factor", [(0.003, 2.0), (0.03, 3.5), (0.5, 4.5)])
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_the_pole_fits_the_symbol(interval, factor, share):
    """Roughly, of every wavenumber from the longest to what the kernel hardly passes."""
    h = 2 / 128
    k = np.geomspace(2 * np.pi / 2.0, 2 / h, 40)
    symbol = symbol_by_quadrature(KERNELS["yang"], h, k, interval, share)
    pole = np.hypot(np.pi, np.sqrt(RHO / (MU * interval)))
    ratio = fit_pole(k, symbol, pole) / (pole**2 + k**2) / symbol
    assert 1 / factor <= ratio.min() and ratio.max() <= factor


def test_the_pole_fits_itself():
    k = np.geomspace(1.0, 100.0, 30)
    assert fit_pole(k, 3.0 / (2.0**2 + k**2), 2.0) == pytest.approx(3.0, rel=1e-12)


# ---------------------------------------------------------------- common faces


def places_at(case, turn, tool):
    """Whether the places are others there, and the matrix for a = 1."""
    operators = case.operators(turn)
    new = tool.update(operators.interpolation.on_root())
    values = tool.values(np.ones(sum(COUNTS)), operators.slip)
    found = csr_matrix((values, tool.places.indices, tool.places.indptr), tool.places.shape)
    return new, found.toarray() - slip_matrix(operators.slip)


@pytest.mark.parametrize("name", ["yang", "bspline43"])
def test_what_markers_share(name):
    """Also those of different curves, and where the box is periodic."""
    case = Case(name)
    case.grid = Grid((24, 20), (-1.5, 1.5, -1.0, 1.0), periodic=(True, False))
    case.parts = [part + (0.9, 0.0) for part in case.parts]  # two of them across the right edge
    new, found = places_at(case, 0.0, Overlap(case.grid.cell_area))
    expected = common_faces(case, 0.0)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * expected.max())
    assert new and expected[: 2 * COUNTS[0], -2 * COUNTS[2] :].any()


def test_next_to_nothing_is_left_out_in_a_safe_way():
    """Places are kept as long as they do, and what has none is made up for on the diagonal."""
    case = Case("bspline43")
    tool = Overlap(case.grid.cell_area)
    assert places_at(case, 0.0, tool)[0]
    kept, left_out = 0, False
    for turn in np.linspace(0.0, 0.2, 41):
        new, found = places_at(case, turn, tool)
        expected = common_faces(case, turn)
        kept += not new
        missing = expected - found
        beside = missing - np.diag(np.diag(missing))
        assert abs(beside).max() <= overlap.LEFT_OUT * expected.diagonal().max()
        np.testing.assert_allclose(-np.diag(missing), abs(beside).sum(axis=1),
                                   rtol=0, atol=1e-12 * expected.max())
        left_out |= beside.any()
    assert 10 < kept < 41 and left_out
    tool.forget()
    assert places_at(case, 0.0, tool)[0]


def test_the_model_follows_time_step_and_configuration_but_for_small_turns():
    case = Case()
    tool = case.new_model()
    rhs = np.random.default_rng(9).standard_normal(case.membranes.stress_count)

    def fresh(interval, turn):
        other = case.new_model(prefix="other_model_")
        other.update(interval, case.operators(turn))
        answer = other.solve(rhs)
        other.destroy()
        return answer

    for interval, turn in ((0.02, 0.0), (0.02, 0.3), (0.1, 0.3), (0.02, -0.4)):
        expected = fresh(interval, turn)
        tool.update(interval, case.operators(turn))  # may leave out what the fresh one does not
        np.testing.assert_allclose(
            tool.solve(rhs), expected, rtol=0, atol=overlap.LEFT_OUT * abs(expected).max())
        tool.begin()
        tool.forget()
        tool.update(interval, case.operators(turn))
        np.testing.assert_allclose(tool.solve(rhs), expected, rtol=1e-9, atol=1e-12)
    kept = tool.solve(rhs)
    tool.update(0.02, case.operators(-0.4 + 0.5 * model.KEPT))
    assert np.array_equal(tool.solve(rhs), kept)
    tool.begin()
    tool.update(0.02, case.operators(-0.4 + 0.5 * model.KEPT))
    assert not np.array_equal(tool.solve(rhs), kept)
    tool.destroy()


def test_a_model_without_markers():
    """As on all ranks but the first."""
    lines = Curves([], [])
    membranes = Membranes(2, lines, [Tension(lines, 1.0, np.empty(0)), Bending(lines, 1.0)],
                          np.empty(0))
    grid, nothing = Grid((8, 8), (0.0, 1.0, 0.0, 1.0)), np.zeros((0, 2))
    tool = MarkerModel(lines, grid, KERNELS["yang"], RHO, MU, 1.0, "test_model_")
    operators = MarkerOperators(None, membranes.rates(nothing, nothing),
                                Slip(lines, nothing, grid, KERNELS["yang"], MU))
    tool.update(INTERVAL, operators)
    assert tool.solve(np.empty(0)).shape == (0,)
    assert operators.force(np.empty(0)).shape == (0, 2) and operators.rate(nothing).shape == (0,)
    tool.destroy()
