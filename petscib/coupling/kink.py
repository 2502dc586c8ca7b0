"""Thickness of the layer in which a smoothed membrane force bends the velocity.

A tangential force density f makes a kink in the velocity, mu [du/dn] = -f t. The kernel smooths
it twice, in spreading and in interpolation, so the markers read a velocity that is wrong by
C h_n f / (2 mu), of first order in the spacing h_n along the normal. The factor C belongs to the
kernel and the discrete Laplacian together. For a straight membrane with unit normal n and
tangent t, in grid spacings, it is t . C t with

    C_ij = (2 / pi) int_0^inf [t_i t_j / q^2 - phi_i phi_j (delta_ij - d_i d_j / lam) / lam] dq,

d_i = 2 sin(q n_i / 2), lam = |d|^2, phi_i the Fourier transform along n of the kernel of
component i. Where the grid lines up with the membrane, at 0 and 45 degrees, lam is periodic in q,
and the integral folded into one period is a finite sum: with R the autocorrelation of the kernel
seen along n, counted in the distance between grid lines (1 or 1 / sqrt(2)),

    C = distance * sum_j |j| R(j),  j all integers,

because sum_k 1 / (q + 2 pi k)^2 = 1 / (2 - 2 cos q), the sum over k of phi^2(q + 2 pi k) is that of
R(j) cos(j q), and (1 - cos j q) / (2 - 2 cos q) has the integral |j| pi over a period.
"""

from functools import cache, partial

import numpy as np

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)  # on pieces of half a cell: error 2e-10


def _integrate(function, edges):
    """Integral over the last axis of ascending edges of a function smooth between any two."""
    half = np.diff(edges)[..., None] / 2
    middle = (edges[..., 1:] + edges[..., :-1])[..., None] / 2
    return np.sum(half * _WEIGHTS * function(middle + half * _NODES), axis=(-2, -1))


def _edges(radius):
    """Every place where a kernel may pass from one formula to the next: whole and half cells."""
    return np.arange(-2 * radius, 2 * radius + 1) / 2


def _convolution(along, along_radius, across, across_radius, y):
    """Convolution of the two weights at y: the kernel as seen along a diagonal."""
    ours = np.broadcast_to(_edges(along_radius), (*y.shape, int(4 * along_radius) + 1))
    theirs = np.clip(y[..., None] - _edges(across_radius), -along_radius, along_radius)
    edges = np.sort(np.concatenate([ours, theirs], axis=-1), axis=-1)
    # The nodes are two more axes than those of y.
    return _integrate(lambda x: along(x) * across(y[..., None, None] - x), edges)


def _mean_distance(weight, radius):
    """Sum over whole numbers j of |j| times the autocorrelation of a weight at j."""
    # Nodes of all pieces of the weight, by piece; a shift by one cell is one by two pieces.
    edges = _edges(radius)
    values = weight((edges[:-1, None] + edges[1:, None]) / 2 + _NODES / 4)
    return sum(
        2 * j * np.sum(values[2 * j :] * values[: -2 * j] @ (_WEIGHTS / 4))
        for j in range(1, int(np.ceil(2 * radius)))
    )


@cache
def constants(kernel):
    """The factor C for membranes at 0 and at 45 degrees to the grid.

    Parameters
    ----------
    kernel : petscib.coupling.kernels.Kernel

    Returns
    -------
    C0, C45 : float
    """
    diagonal = partial(
        _convolution, kernel.along, kernel.along_radius, kernel.across, kernel.across_radius
    )
    return (
        float(_mean_distance(kernel.across, kernel.across_radius)),
        float(_mean_distance(diagonal, kernel.along_radius + kernel.across_radius) / np.sqrt(2)),
    )


def thickness(kernel, normal):
    """The factor C for membranes in any direction.

    The rule between 0 and 45 degrees is the definition of the correction. It is within 4e-4 of
    the integral for yang and 8.5e-3 for bspline32, the kernel of which it holds least.

    Parameters
    ----------
    kernel : petscib.coupling.kernels.Kernel
    normal : ndarray, shape (..., 2)
        Unit normals m in grid spacings: (n_x dx, n_y dy) / |(n_x dx, n_y dy)|.

    Returns
    -------
    ndarray, shape (...)
        C(m) = C0 + 4 (C45 - C0) m_x^2 m_y^2.
    """
    straight, diagonal = constants(kernel)
    return straight + 4 * (diagonal - straight) * (normal[..., 0] * normal[..., 1]) ** 2


@cache
def stress_work(weight, radius, inner, outer):
    """int mu delta^2 across a membrane, in grid spacings: how it bears stress on both sides.

    With 1 / mu = inner + (outer - inner) H, H the integral of delta.

    Parameters
    ----------
    weight : callable
        The one-dimensional function delta.
    radius : float
        Half width of its support.
    inner, outer : float
        1 / mu on both sides.
    """
    edges = _edges(radius)

    def integrand(x):
        passed = _integrate(weight, np.minimum(edges, x[..., None]))
        return weight(x) ** 2 / (inner + (outer - inner) * passed)

    # Where mu is large on one side, it changes fast.
    return float(_integrate(integrand, np.linspace(-radius, radius, int(32 * radius) + 1)))
