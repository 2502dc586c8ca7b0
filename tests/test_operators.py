"""Difference operators and wall data: against dense matrices, exact fields, and refinement."""
import dense
import numpy as np
import pytest

from petscib.fluid import flows
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides

DOMAIN = (-1.0, 2.0, 0.5, 1.5)
RATE = 1.7
EPS = np.finfo(float).eps


def smooth(x, y, shear_rate, domain):
    """Divergence-free, with normal and tangential flow on all walls: curl of a stream function."""
    return 2 * np.sin(x + 0.4) * np.cos(2 * y), -np.cos(x + 0.4) * np.sin(2 * y)


def smooth_laplacian(x, y):
    return tuple(-5 * part for part in smooth(x, y, None, None))


FLOWS = ("shear", "extensional", "poiseuille", "smooth")


@pytest.fixture(autouse=True)
def with_smooth_flow(monkeypatch):
    monkeypatch.setitem(flows.FLOWS, "smooth", smooth)


SIDES = {"walls": (False, False), "x": (True, False), "y": (False, True), "xy": (True, True)}


def make(cells, flow="rest", domain=DOMAIN, sides="walls"):
    grid = Grid(cells, domain, periodic=SIDES[sides])
    return grid, Operators(grid, Sides(grid, flow, RATE))


def filled(grid, operators):
    vector = grid.velocity_vector()
    operators.sides.fill(vector)
    return vector


def on_faces(grid, field):
    """Natural-order values of a field (function of x and y, giving u and v)."""
    u, v = field(*grid.u_points())[0], field(*grid.v_points())[1]
    return np.concatenate((u.ravel(), v.ravel()))


def order(errors):
    """Observed order between grids each twice as fine as the last."""
    return np.log2(np.array(errors[:-1]) / errors[1:])


# ---------------------------------------------------------------- as matrices


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("cells", [(7, 5), (10, 13)])
@pytest.mark.parametrize("sides", SIDES)
def test_matrices(cells, sides):
    grid, operators = make(cells, sides=sides)
    faces, centres = dense.velocity_numbers(grid), grid.p_index.ravel()
    laplacian = dense.matrix(operators.laplacian)[np.ix_(faces, faces)]
    gradient = dense.matrix(operators.gradient)[np.ix_(faces, centres)]
    divergence = dense.matrix(operators.divergence)[np.ix_(centres, faces)]
    poisson = dense.matrix(operators.pressure_laplacian)[np.ix_(centres, centres)]

    scale = np.abs(laplacian).max()
    assert np.allclose(laplacian, dense.laplacian(grid), rtol=0, atol=4 * EPS * scale)
    assert np.allclose(divergence, dense.divergence(grid), rtol=4 * EPS, atol=0)

    inner = dense.inner_faces(grid)
    assert inner.all() == (sides == "xy")
    assert np.array_equal(laplacian, laplacian.T)
    assert not laplacian[~inner].any() and not gradient[~inner].any()
    largest = np.linalg.eigvalsh(laplacian[np.ix_(inner, inner)])[-3:]
    if sides == "xy":  # the mean of each component is the only velocity without friction
        assert np.abs(largest[1:]).max() <= 100 * EPS * scale and largest[0] < -1
    else:
        assert largest.max() < -1
    assert np.array_equal(gradient[inner], -divergence.T[inner])
    assert np.allclose(divergence @ gradient, -poisson, rtol=0, atol=4 * EPS * scale)
    assert np.abs(poisson.sum(axis=1)).max() <= 8 * EPS * scale
    assert np.linalg.matrix_rank(poisson) == len(centres) - 1


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("sides", ["walls", "x", "y"])
def test_wall_terms_do_not_depend_on_the_ranks(sides):
    """Laplacian and divergence of a flow that fills its walls, by ghost values in plain NumPy."""
    grid, operators = make((7, 5), "smooth", sides=sides)
    vector, result, cells = filled(grid, operators), grid.velocity_vector(), grid.pressure_vector()
    operators.laplacian.mult(vector, result)
    result.axpy(1.0, operators.wall_source)
    values = dense.velocity(grid, vector)
    expected = dense.laplacian_of_flow(grid, lambda x, y: smooth(x, y, RATE, DOMAIN), values)
    assert np.allclose(dense.velocity(grid, result), expected, rtol=0,
                       atol=100 * EPS * np.abs(expected).max())

    walls = ~dense.inner_faces(grid)
    assert np.allclose(dense.pressure(grid, operators.wall_flux),
                       dense.divergence(grid) @ (walls * values), rtol=0, atol=1e-12)
    operators.divergence.mult(vector, cells)
    assert np.allclose(dense.pressure(grid, cells), dense.divergence(grid) @ values,
                       rtol=0, atol=1e-12)
    assert operators.wall_faces == pytest.approx(np.sum(values[walls]**2))


# ---------------------------------------------------------------- exact fields


@pytest.mark.parametrize("flow", ["shear", "extensional"])
def test_laplacian_of_linear_flow_is_zero_up_to_the_walls(flow):
    grid, operators = make((14, 9), flow)
    result = grid.velocity_vector()
    operators.laplacian.multAdd(filled(grid, operators), operators.wall_source, result)
    assert result.norm() <= 1e-11


def test_laplacian_of_poiseuille_flow_is_constant_off_the_walls():
    grid, operators = make((14, 9), "poiseuille")
    result = grid.velocity_vector()
    operators.laplacian.multAdd(filled(grid, operators), operators.wall_source, result)
    u, v = grid.velocity_blocks(result)
    assert np.allclose(u[1:-1, 1:-1], -2 * RATE / (DOMAIN[3] - DOMAIN[2]), rtol=1e-11)
    assert not v.any()


@pytest.mark.parametrize("flow", ["shear", "extensional", "poiseuille"])
def test_flows_are_divergence_free(flow):
    grid, operators = make((14, 9), flow)
    cells = grid.pressure_vector()
    operators.divergence.mult(filled(grid, operators), cells)
    assert cells.norm() <= 1e-12


def test_gradient_of_linear_pressure_is_constant():
    grid, operators = make((14, 9))
    cells, result = grid.pressure_vector(), grid.velocity_vector()
    x, y = grid.p_points()
    grid.set_pressure(cells, 3 * x - 2 * y + 1)
    operators.gradient.mult(cells, result)
    u, v = grid.velocity_blocks(result)
    assert np.allclose(u[:, 1:-1], 3) and np.allclose(v[1:-1], -2)
    assert not u[:, [0, -1]].any() and not v[[0, -1]].any()


def test_walls_at_rest_have_no_terms():
    grid, operators = make((14, 9))
    assert operators.wall_source is None and operators.wall_flux is None
    assert operators.wall_norm == operators.wall_faces == 0.0


# ---------------------------------------------------------------- the norm of the gradient


def gradient_norm(operators, vector):
    """Squared norm of the velocity gradient as the energy ledger takes it."""
    work = vector.duplicate()
    operators.laplacian.mult(vector, work)
    total = -vector.dot(work) + operators.wall_norm
    if operators.wall_source is not None:
        total -= 2 * vector.dot(operators.wall_source)
    return total * operators.grid.cell_area


def test_gradient_norm_of_shear_flow():
    """It counts the unknown faces: half a column at either side wall is the walls' own."""
    grid, operators = make((14, 9), "shear")
    area = (DOMAIN[1] - DOMAIN[0] - grid.dx) * (DOMAIN[3] - DOMAIN[2])
    assert gradient_norm(operators, filled(grid, operators)) == pytest.approx(
        RATE**2 * area, rel=1e-12)


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("sides", ["walls", "x", "y"])
def test_gradient_norm_is_a_sum_over_links(flow, sides):
    """For any velocity, with the walls' velocity half a cell or a cell away at the ends."""
    grid, operators = make((14, 9), flow, sides=sides)
    vector = filled(grid, operators)
    values = dense.velocity(grid, vector)
    inner = dense.inner_faces(grid)
    values[inner] += np.random.default_rng(2).standard_normal(inner.sum())
    dense.set_velocity(grid, vector, values)
    u, v = grid.velocity_blocks(vector)
    tangential = operators.sides.tangential
    # Links along each direction: between neighbours, once around where it is periodic.
    around = [(lambda part: {"append": part[:, :1]}) if grid.periodic[0] else (lambda part: {}),
              (lambda part: {"append": part[:1]}) if grid.periodic[1] else (lambda part: {})]
    not_on_walls = [slice(None) if periodic else slice(1, -1) for periodic in grid.periodic]
    total = ((np.diff(u, axis=1, **around[0](u))**2).sum()
             + (np.diff(v, axis=1, **around[0](v))[not_on_walls[1]]**2).sum()) / grid.dx**2
    total += ((np.diff(v, axis=0, **around[1](v))**2).sum()
              + (np.diff(u, axis=0, **around[1](u))[:, not_on_walls[0]]**2).sum()) / grid.dy**2
    for side, row in (("bottom", 0), ("top", -1)):
        if side in tangential:
            total += 2 * ((u[row] - tangential[side])[not_on_walls[0]]**2).sum() / grid.dy**2
    for side, column in (("left", 0), ("right", -1)):
        if side in tangential:
            total += 2 * ((v[:, column] - tangential[side])[not_on_walls[1]]**2).sum() / grid.dx**2
    assert gradient_norm(operators, vector) == pytest.approx(total * grid.cell_area, rel=1e-12)


# ---------------------------------------------------------------- refinement


def test_laplacian_is_second_order_off_the_walls():
    errors = []
    for cells in ((12, 10), (24, 20), (48, 40)):
        grid, operators = make(cells, "smooth")
        result = grid.velocity_vector()
        operators.laplacian.multAdd(filled(grid, operators), operators.wall_source, result)
        error = dense.velocity(grid, result) - on_faces(grid, smooth_laplacian)
        split = grid.u_index.size
        u = error[:split].reshape(grid.u_index.shape)[1:-1, 1:-1]
        v = error[split:].reshape(grid.v_index.shape)[1:-1, 1:-1]
        errors.append(max(np.abs(u).max(), np.abs(v).max()))
    assert order(errors).min() >= 1.9


def test_gradient_and_divergence_are_second_order():
    errors = {"gradient": [], "divergence": []}
    for cells in ((12, 10), (24, 20), (48, 40)):
        grid, operators = make(cells, "smooth")
        scalar, vector = grid.pressure_vector(), grid.velocity_vector()
        x, y = grid.p_points()
        grid.set_pressure(scalar, np.sin(2 * x) * np.cos(3 * y))
        operators.gradient.mult(scalar, vector)
        error = dense.velocity(grid, vector) - on_faces(grid, pressure_gradient)
        errors["gradient"].append(np.abs(error[dense.inner_faces(grid)]).max())
        operators.divergence.mult(filled(grid, operators), scalar)
        errors["divergence"].append(np.abs(dense.pressure(grid, scalar)).max())
    assert order(errors["gradient"]).min() >= 1.9
    assert order(errors["divergence"]).min() >= 1.9


def solve_flow(cells, flow, laplacian, stokes):
    """Largest error of u - Laplacian u (+ grad p) = f where the flow is the exact solution."""
    sparse = pytest.importorskip("scipy.sparse")
    linalg = pytest.importorskip("scipy.sparse.linalg")

    def from_petsc(mat):
        starts, columns, values = mat.getValuesCSR()
        return sparse.csr_matrix((values, columns, starts), shape=mat.getSize())

    grid, operators = make(cells, flow)
    faces = dense.velocity_numbers(grid)
    background = filled(grid, operators)
    exact = dense.velocity(grid, background)
    force = exact - on_faces(grid, laplacian)
    if stokes:
        force += on_faces(grid, pressure_gradient)
    force += dense.velocity(grid, operators.wall_source)
    rhs = np.empty(len(faces))
    rhs[faces] = np.where(dense.inner_faces(grid), force, exact)  # wall faces keep their values
    matrix = sparse.eye(len(faces)) - from_petsc(operators.laplacian)
    if stokes:
        # The walls' data let in a little by themselves (second order); it goes to all cells.
        inflow = grid.pressure_vector()
        operators.divergence.mult(background, inflow)
        count = grid.m * grid.n
        rhs = np.concatenate((rhs, np.full(count, inflow.sum() / count)))
        pin = sparse.csr_matrix(([1.0], ([0], [0])), shape=(count, count))
        matrix = sparse.bmat([[matrix, from_petsc(operators.gradient)],
                              [from_petsc(operators.divergence), pin]])
    solution = linalg.spsolve(matrix.tocsc(), rhs)
    return np.abs(solution[faces] - exact).max()


def pressure_gradient(x, y):
    """Of sin 2x cos 3y."""
    return 2 * np.cos(2 * x) * np.cos(3 * y), -3 * np.sin(2 * x) * np.sin(3 * y)


def zero(x, y):
    return np.zeros_like(x + y), np.zeros_like(x + y)


def poiseuille_laplacian(x, y):
    return zero(x, y)[0] - 2 * RATE / (DOMAIN[3] - DOMAIN[2]), zero(x, y)[1]


@pytest.mark.parametrize("stokes", [False, True], ids=["helmholtz", "stokes"])
@pytest.mark.parametrize("flow, laplacian", [
    ("poiseuille", poiseuille_laplacian), ("smooth", smooth_laplacian), ("shear", zero),
    ("extensional", zero)])
def test_solutions_are_second_order_in_the_largest_error(flow, laplacian, stokes):
    if laplacian is zero and not stokes:
        assert solve_flow((14, 9), flow, zero, stokes) <= 1e-11  # exact
        return
    errors = [solve_flow(cells, flow, laplacian, stokes)
              for cells in ((36, 30), (72, 60), (144, 120))]
    assert order(errors).min() >= 1.9, errors
