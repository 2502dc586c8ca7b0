"""Stokes flow around an elliptical vesicle in a sheared box, at once, by boundary integrals.

The membrane does not stretch and has no bending rigidity; the fluid inside has another viscosity.
With f the membrane's force per length, u its velocity and q a density on the walls, around are

    (1 + X) / 2 u = S f + (1 - X) D u + W q,    wall velocity = S f + (1 - X) D u + (1 / 2 + W) q,

X the contrast, S the single layer (viscosity 1 outside), D and W double layers (Pozrikidis 1992).
Points are even in the ellipse's parameter, the logarithm integrated by its Fourier series; walls
have panels of Gauss points that halve towards the corners.
"""
import numpy as np


def single_layer(targets, sources, weights):
    """S between different curves: matrix of (2 targets, 2 sources)."""
    apart = sources[None] - targets[:, None]
    square = (apart**2).sum(-1)
    kernel = apart[..., :, None] * apart[..., None, :] / square[..., None, None]
    kernel = kernel - 0.5 * np.log(square)[..., None, None] * np.eye(2)
    return _flat(kernel * weights[None, :, None, None] / (4 * np.pi))


def double_layer(targets, sources, normals, weights, diagonal=None):
    """D or W; with `diagonal` (N, 2, 2), the kernel's limits, from a curve to itself."""
    apart = sources[None] - targets[:, None]
    square = (apart**2).sum(-1)
    if diagonal is not None:
        np.fill_diagonal(square, 1.0)
    along = (apart * normals[None]).sum(-1) / square**2
    kernel = -4 * apart[..., :, None] * apart[..., None, :] * along[..., None, None]
    if diagonal is not None:
        places = np.arange(len(targets))
        kernel[places, places] = diagonal
    return _flat(kernel * weights[None, :, None, None] / (4 * np.pi))


def _flat(kernel):
    rows, columns = kernel.shape[:2]
    return kernel.transpose(0, 2, 1, 3).reshape(2 * rows, 2 * columns)


def walls(panels, points):
    """Places, inward normals and weights on the walls of the box -1..1; one wall after another."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    ends = -1 + 2.0 ** -np.arange(panels)[::-1]
    edges = np.concatenate(([-1.0], ends, -ends[-2::-1], [1.0]))
    half, middle = np.diff(edges)[:, None] / 2, (edges[1:] + edges[:-1])[:, None] / 2
    line, weights = (middle + half * nodes).ravel(), (half * weights).ravel()
    parts = []
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            place, normal = np.empty((len(line), 2)), np.zeros((len(line), 2))
            place[:, axis], place[:, 1 - axis], normal[:, axis] = side, line, -side
            parts.append((place, normal, weights))
    return [np.concatenate(part) for part in zip(*parts)]


def turning_speed(axes, contrast, points=65, panels=10):
    """d theta / dt of a level ellipse in the middle of the box whose walls have u = (y, 0).

    Parameters
    ----------
    axes : (float, float)
        Half lengths along x, the longer, and along y.
    contrast : float
    points, panels : int
        On the membrane, odd; towards each corner.
    """
    a, b = axes
    angle = 2 * np.pi * np.arange(points) / points
    x = np.stack((a * np.cos(angle), b * np.sin(angle)), axis=1)
    rate = np.stack((-a * np.sin(angle), b * np.cos(angle)), axis=1)
    speed = np.hypot(*rate.T)
    t = rate / speed[:, None]
    n = np.stack((t[:, 1], -t[:, 0]), axis=1)
    weights, curvature = 2 * np.pi / points * speed, a * b / speed**3

    wave = np.fft.fftfreq(points, 1 / points)
    spectrum = np.fft.fft(np.eye(points), axis=0)
    along = np.fft.ifft(1j * wave[:, None] * spectrum, axis=0).real / speed[:, None]
    # The integral of log(4 sin^2) / 2 against the waves.
    integral = np.where(wave == 0, 0.0, -np.pi / np.where(wave == 0, 1.0, abs(wave)))
    logarithm = np.fft.ifft(integral[:, None] * spectrum, axis=0).real

    apart = x[None] - x[:, None]
    square = (apart**2).sum(-1)
    round_ = 4 * np.sin((angle[None] - angle[:, None]) / 2) ** 2
    np.fill_diagonal(square, 1.0)
    np.fill_diagonal(round_, 1.0)
    smooth = 0.5 * np.log(square / round_)
    np.fill_diagonal(smooth, np.log(speed))
    direct = apart[..., :, None] * apart[..., None, :] / square[..., None, None]
    places = np.arange(points)
    direct[places, places] = t[:, :, None] * t[:, None, :]
    own = direct * weights[None, :, None, None] - np.eye(2) * (
        logarithm * speed + smooth * weights)[..., None, None]
    single = _flat(own / (4 * np.pi))
    double = double_layer(
        x, x, n, weights, -2 * curvature[:, None, None] * t[:, :, None] * t[:, None, :])

    tension = np.einsum("ij,jk->ikj", along, t).reshape(2 * points, points)  # force of a tension
    stretching = np.einsum("ij,ik->ijk", along, t).reshape(points, 2 * points)
    wall, normal, panel = walls(panels, 10)
    count, m = 2 * points, len(wall) // 4
    density = double_layer(wall, wall, normal, panel, np.zeros((4 * m, 2, 2)))
    for k in range(4):
        mine = slice(2 * k * m, 2 * (k + 1) * m)
        density[mine, mine] = 0.0  # along a flat wall
    density += 0.5 * np.eye(8 * m)
    density += np.outer(normal.ravel(), (normal * panel[:, None]).ravel())  # no flux on the whole
    other = 1 - contrast
    matrix = np.block([
        [(1 + contrast) / 2 * np.eye(count) - other * double, -single @ tension,
         -double_layer(x, wall, normal, panel)],
        [stretching, np.zeros((points, points + 8 * m))],
        [other * double_layer(wall, x, n, weights), single_layer(wall, x, weights) @ tension,
         density]])
    moved = np.stack((wall[:, 1], np.zeros(4 * m)), axis=1).ravel()
    found = np.linalg.solve(matrix, np.concatenate((np.zeros(count + points), moved)))
    outward = (found[:count].reshape(-1, 2) * n).sum(1) * weights
    return (x[:, 0] * x[:, 1] * outward).sum() / (np.pi * a * b / 4 * (a * a - b * b))
