"""Dense NumPy versions of what petscib assembles, written independently, and small problems.

Natural order: the x-faces row by row, then the y-faces; cells row by row.
"""
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from petscib import entries, options

# ---------------------------------------------------------------- from PETSc to NumPy


def velocity_numbers(grid):
    """PETSc numbers of all faces in natural order."""
    return np.concatenate((grid.u_index.ravel(), grid.v_index.ravel()))


def _whole(vector):
    return np.concatenate(vector.comm.tompi4py().allgather(vector.getArray(readonly=True)))


def velocity(grid, vector):
    """All faces in natural order, on every rank.  Collective."""
    return _whole(vector)[velocity_numbers(grid)]


def pressure(grid, vector):
    """All cells in natural order, on every rank.  Collective."""
    return _whole(vector)[grid.p_index.ravel()]


def matrix(mat):
    """A distributed matrix, rows and columns in PETSc's order, on every rank.  Collective."""
    starts, columns, values = mat.getValuesCSR()
    local = np.zeros((len(starts) - 1, mat.getSize()[1]))
    np.add.at(local, (np.repeat(np.arange(len(starts) - 1), np.diff(starts)), columns), values)
    return np.concatenate(mat.comm.tompi4py().allgather(local))


def set_velocity(grid, vector, values):
    """Set a vector from all faces in natural order."""
    split = grid.u_index.size
    u = values[:split].reshape(grid.u_index.shape)
    v = values[split:].reshape(grid.v_index.shape)
    grid.set_velocity(vector, u[grid.u_box], v[grid.v_box])


# ---------------------------------------------------------------- operators


def second_difference(count, h, ends):
    """Second difference of `count` values with zeros on the walls around.

    `ends`: "wall at point", one spacing from the first and the last value; "wall between", half
    of one; or "periodic".
    """
    table = np.diag(np.full(count, -2.0)) + np.eye(count, k=1) + np.eye(count, k=-1)
    if ends == "wall between":
        table[0, 0] = table[-1, -1] = -3.0
    if ends == "periodic":
        table[0, -1] += 1
        table[-1, 0] += 1
    return table / h**2


def _inner(lines, periodic):
    """Selects of the grid lines in one direction those that are not on walls."""
    return np.eye(lines) if periodic else np.diag(np.r_[0.0, np.ones(lines - 2), 0.0])


def _nodes(lines, h, periodic):
    if periodic:
        return second_difference(lines, h, "periodic")
    table = np.zeros((lines, lines))
    table[1:-1, 1:-1] = second_difference(lines - 2, h, "wall at point")
    return table


def _between(count, h, periodic):
    return second_difference(count, h, "periodic" if periodic else "wall between")


def _lines(grid):
    """Grid lines across x and across y."""
    return grid.u_index.shape[1], grid.v_index.shape[0]


def inner_faces(grid):
    """Which faces, in natural order, are not on the walls."""
    (lines_x, lines_y), (px, py) = _lines(grid), grid.periodic
    u = np.kron(np.ones(grid.n), np.diag(_inner(lines_x, px)))
    v = np.kron(np.diag(_inner(lines_y, py)), np.ones(grid.m))
    return np.concatenate((u, v)) > 0


def laplacian(grid):
    """Laplacian of the velocity with walls at rest; wall faces empty."""
    m, n, dx, dy = grid.m, grid.n, grid.dx, grid.dy
    (lines_x, lines_y), (px, py) = _lines(grid), grid.periodic
    u = np.kron(np.eye(n), _nodes(lines_x, dx, px))
    u += np.kron(_between(n, dy, py), _inner(lines_x, px))
    v = np.kron(_nodes(lines_y, dy, py), np.eye(m))
    v += np.kron(_inner(lines_y, py), _between(m, dx, px))
    zero = np.zeros((len(u), len(v)))
    return np.block([[u, zero], [zero.T, v]])


def laplacian_of_flow(grid, flow, values):
    """Laplacian at the inner faces of `values` (natural order) between walls moving with a flow.

    Over a wall half a cell away, the value is twice the wall's less that inside.  `flow` takes x
    and y and gives u and v.
    """
    a, b, c, d = (np.array([[wall]]) for wall in grid.domain)
    u, v = values[: grid.u_index.size], values[grid.u_index.size :]
    parts = []
    for part, points, number in ((u.reshape(grid.u_index.shape), grid.u_points(), 0),
                                 (v.reshape(grid.v_index.shape), grid.v_points(), 1)):
        x, y = points
        total = np.zeros(part.shape)
        for axis, h, low, high in ((0, grid.dy, flow(x, c), flow(x, d)),
                                   (1, grid.dx, flow(a, y), flow(b, y))):
            first, last = np.take(part, [0], axis), np.take(part, [-1], axis)
            if grid.periodic[1 - axis]:
                ends = last, first
            elif axis == 1 - number:  # across the component's own walls, whose faces are given
                ends = first, last  # any value
            else:
                ends = 2 * low[number] - first, 2 * high[number] - last
            whole = np.concatenate((ends[0], part, ends[1]), axis)
            total += np.diff(whole, 2, axis=axis) / h**2
        parts.append(total.ravel())
    return np.concatenate(parts) * inner_faces(grid)


def divergence(grid):
    """Divergence from all faces to cells."""
    def forward(count, h, periodic):
        table = np.eye(count, count + 1, k=1) - np.eye(count, count + 1)
        if periodic:
            table[:, 0] += table[:, -1]
            table = table[:, :-1]
        return table / h

    px, py = grid.periodic
    return np.hstack((np.kron(np.eye(grid.n), forward(grid.m, grid.dx, px)),
                      np.kron(forward(grid.n, grid.dy, py), np.eye(grid.m))))


def gradient(grid):
    """Gradient from cells to faces, zero on the walls."""
    return -divergence(grid).T * inner_faces(grid)[:, None]


def interpolation(grid, kernel, markers):
    """The matrix J, by evaluating the kernel at every face."""
    rows = []
    for x, y in markers:
        for component, (x_faces, y_faces) in enumerate((grid.u_points(), grid.v_points())):
            r_x, r_y = (x_faces - x) / grid.dx, (y_faces - y) / grid.dy
            if grid.periodic[0]:
                r_x = r_x - grid.m * np.round(r_x / grid.m)
            if grid.periodic[1]:
                r_y = r_y - grid.n * np.round(r_y / grid.n)
            weights = (kernel.along(r_x) * kernel.across(r_y) if component == 0
                       else kernel.across(r_x) * kernel.along(r_y))
            row = [np.zeros(grid.u_index.size), np.zeros(grid.v_index.size)]
            row[component] = weights.ravel()
            rows.append(np.concatenate(row))
    return np.array(rows)


# ---------------------------------------------------------------- along the membrane


def to_half_points(count, ds):
    """Difference from markers to half points, (q_k - q_{k-1}) / ds."""
    return (np.eye(count) - np.roll(np.eye(count), -1, axis=1)) / ds


def fourth_difference(count, ds):
    """The matrix A_h for both components, interleaved."""
    row = np.zeros(count)
    row[[0, 1, 2, -1, -2]] = 6, -4, 1, -4, 1
    table = np.array([np.roll(row, k) for k in range(count)]) / ds**4
    return np.kron(table, np.eye(2))


def surface_divergence(tangent, ds):
    """The matrix T_m (M x 2M) from marker velocities to rates of stretching."""
    table = to_half_points(len(tangent), ds)
    return (table[:, :, None] * tangent[:, None, :]).reshape(len(tangent), -1)


# C at 0 and at 45 degrees to the grid: the table of the kink correction, with all digits.
KINK = {"yang": (0.82738223049387, 0.85329142893208), "bspline43": (7 / 15, 0.56657941932623)}


def slip(grid, mu, markers, ds, constants):
    """The kink correction K (2M x 2M) of a closed curve, for forces per ds.

    At each marker C(m) h_n / (2 mu |X_s|) t t^T, with t along the chord.
    """
    straight, diagonal = constants
    count = len(markers)
    table = np.zeros((2 * count, 2 * count))
    for k in range(count):
        chord = markers[(k + 1) % count] - markers[k - 1]
        t = chord / np.hypot(*chord)
        stretching = np.hypot(*chord) / (2 * ds)
        across = -t[1] * grid.dx, t[0] * grid.dy
        h = np.hypot(*across)
        m = np.array(across) / h
        thickness = straight + 4 * (diagonal - straight) * m[0] ** 2 * m[1] ** 2
        table[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = (
            thickness * h / (2 * mu * stretching) * np.outer(t, t))
    return table


def area(markers):
    """Signed area of a closed polygon."""
    return sum(markers[k - 1, 0] * markers[k, 1] - markers[k, 0] * markers[k - 1, 1]
               for k in range(len(markers))) / 2


def area_gradient(markers, ds):
    """N (2M): (ds / 2) times D_s X_k + D_s X_{k+1}, turned."""
    slopes = to_half_points(len(markers), ds) @ markers
    both = slopes + np.roll(slopes, -1, axis=0)
    return ds / 2 * np.stack((both[:, 1], -both[:, 0]), axis=1).ravel()


def projector(markers, ds):
    """Pi (2M x 2M) of a closed curve."""
    normal = area_gradient(markers, ds)
    return np.eye(len(normal)) - np.outer(normal, normal) / (normal @ normal)


def stage(grid, friction, mu, load, walls, carry, slip, stiffness, force, coupled, viscous=0.0):
    """The stage of an implicit scheme, fluid and forces on the markers in one dense system.

        friction w - mu Laplacian w (+ grad p) = load + carry^T f / (dx dy),   (div w = 0,)
        f + stiffness U = force,   U = carry w + slip f

    Parameters
    ----------
    load, walls : ndarray
        Over all faces, and the velocities of those on walls.
    carry : ndarray, shape (2M, N)
        Pi J.
    slip, stiffness : ndarray, shape (2M, 2M)
        K, and theta dt W, for forces on the markers (not per ds).
    force : ndarray, shape (2M,)
        At the start.
    viscous : ndarray, shape (N, N)
        Added to the fluid's matrix.

    Returns
    -------
    w, p, f
        In natural order; p of zero mean, without entries unless coupled.
    """
    inner = inner_faces(grid)
    fluid = friction * np.eye(len(load)) - mu * laplacian(grid) + viscous
    spread, div = carry.T / (grid.dx * grid.dy), divergence(grid)
    scale = 1 + np.abs(stiffness).sum(axis=1)
    response = (np.eye(len(force)) + stiffness @ slip) / scale[:, None]
    carried = stiffness @ carry / scale[:, None]
    rows = [[fluid[np.ix_(inner, inner)], -spread[inner]], [carried[:, inner], response]]
    rhs = [load[inner], force / scale - carried[:, ~inner] @ walls]
    cells = len(div) if coupled else 0
    if coupled:
        ones, zeros = np.ones((cells, 1)), np.zeros  # with a multiplier for the mean of p
        velocities, forces = inner.sum(), len(force)
        rows = [[rows[0][0], gradient(grid)[inner], rows[0][1], zeros((velocities, 1))],
                [div[:, inner], zeros((cells, cells + forces)), ones],
                [rows[1][0], zeros((forces, cells)), response, zeros((forces, 1))],
                [zeros((1, velocities)), ones.T, zeros((1, forces + 1))]]
        rhs = [rhs[0], -div[:, ~inner] @ walls, rhs[1], [0.0]]
    answer = np.linalg.solve(np.vstack([np.hstack(row) for row in rows]), np.concatenate(rhs))
    velocity = np.empty(len(load))
    velocity[inner], velocity[~inner] = answer[: inner.sum()], walls
    rest = answer[inner.sum() :]
    return velocity, rest[:cells], rest[cells : cells + len(force)]


# ---------------------------------------------------------------- problems and options


@contextmanager
def petsc_options(**values):
    """Replace PETSc's options by `values` inside the block, and leave none of its traces."""
    database = PETSc.Options()
    entries.present().withdraw()  # of the last simulation, which are not to come back below
    before = database.getAll()
    for name in before:
        database.delValue(name)
    for name, value in values.items():
        database[name] = value
    try:
        yield
    finally:
        entries.present().withdraw()
        for name in database.getAll():
            database.delValue(name)
        for name, value in before.items():
            database[name] = value


def problem(**values):
    """Problem and initial state for options by name; flow at rest, 32 x 32.  Collective."""
    words = {"flow": "rest", "stag_grid_x": 32}
    words.update(values)
    if words["flow"] == "rest":
        words.pop("shear_rate", None)
    settings = options.read({name: str(value) for name, value in words.items()})
    from petscib.start import build_problem
    return build_problem(settings, PETSc.COMM_WORLD)
