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

Where the viscosity is another inside, also the layer matters in which it changes, with the weights
of the normals at faces, and in which stress is read: the factors C', b and W at the end.
"""

from functools import cache, partial

import numpy as np

from .kernels import STRESS_SHIFT

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)  # on pieces of half a cell: error 2e-10


def _integrate(function, edges):
    """Integral over the last axis of ascending edges of a function smooth between any two."""
    half = np.diff(edges)[..., None] / 2
    middle = (edges[..., 1:] + edges[..., :-1])[..., None] / 2
    return np.sum(half * _WEIGHTS * function(middle + half * _NODES), axis=(-2, -1))


def _edges(radius):
    """Every place where a kernel may pass from one formula to the next: whole and half cells."""
    return np.arange(-2 * radius, 2 * radius + 1) / 2


def _convolution(one, other, y):
    """Convolution at y of two weights, each a function and the half width of its support."""
    (first, radius), (second, reach) = one, other
    ours = np.broadcast_to(_edges(radius), (*y.shape, int(4 * radius) + 1))
    theirs = np.clip(y[..., None] - _edges(reach), -radius, radius)
    edges = np.sort(np.concatenate([ours, theirs], axis=-1), axis=-1)
    # The nodes are two more axes than those of y.
    return _integrate(lambda x: first(x) * second(y[..., None, None] - x), edges)


def _sampled(weight):
    """A weight at the nodes of each half cell of its support, and where the half cells begin."""
    function, radius = weight
    places = _edges(radius)[:-1]
    return function(places[:, None] + (1 + _NODES) / 4), places


def _mean_distance(one, other, shift=0.0):
    """Sum over whole numbers j of |x| times the correlation of two weights at x = j + shift.

    A shift by half cells, so that their nodes meet.
    """
    (ours, places), (theirs, others) = _sampled(one), _sampled(other)
    x = places[:, None] - others
    shared = (ours * _WEIGHTS / 4) @ theirs.T
    return float(np.sum(np.abs(x) * shared, where=(x - shift) % 1 == 0))


def _across(kernel):
    return kernel.across, kernel.across_radius


def _along(kernel):
    return kernel.along, kernel.along_radius


def _diagonal(kernel):
    """The kernel seen along a diagonal, where grid lines are 1 / sqrt(2) apart."""
    radius = kernel.along_radius + kernel.across_radius
    return partial(_convolution, _along(kernel), _across(kernel)), radius


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
    diagonal = _diagonal(kernel)
    return (_mean_distance(_across(kernel), _across(kernel)),
            _mean_distance(diagonal, diagonal) / np.sqrt(2))


@cache
def contrast_constants(kernel):
    """The factor C' for membranes at 0 and at 45 degrees to the grid.

    It is the mean distance of places where the velocity is read from those where the viscosity
    changes. Along the grid's lines the former are faces of the tangent, the latter, faces of the
    normal, lie half a spacing between them, and the weights are those along a component; along
    diagonals it is C.

    Parameters
    ----------
    kernel : petscib.coupling.kernels.Kernel

    Returns
    -------
    C'0, C'45 : float
    """
    return _mean_distance(_across(kernel), _along(kernel), 0.5), constants(kernel)[1]


def thickness(constants, normal):
    """The factor C, or another, for membranes in any direction.

    The rule between 0 and 45 degrees is the definition of the correction. For C it is within 4e-4
    of the integral for yang and 8.5e-3 for bspline32, the kernel of which it holds least.

    Parameters
    ----------
    constants : (float, float)
        At 0 and at 45 degrees.
    normal : ndarray, shape (..., 2)
        Unit normals m in grid spacings: (n_x dx, n_y dy) / |(n_x dx, n_y dy)|.

    Returns
    -------
    ndarray, shape (...)
        C(m) = C0 + 4 (C45 - C0) m_x^2 m_y^2.
    """
    straight, diagonal = constants
    return straight + 4 * (diagonal - straight) * (normal[..., 0] * normal[..., 1]) ** 2


def _tabulated(one, other):
    """The convolution of two weights as a weight that is quick to evaluate, to 1e-8."""
    from scipy.interpolate import CubicSpline  # a tenth of a second, for runs with contrast only

    radius = one[1] + other[1]
    x = np.linspace(-radius, radius, int(128 * radius) + 1)
    spline = CubicSpline(x, _convolution(one, other, x))
    return lambda y: spline(np.clip(y, -radius, radius)), radius


@cache
def _sights(kernel):
    """Across a membrane at 0 and at 45 degrees: where stress, velocity and normals are.

    Returns
    -------
    Two of these tuples.

    stress, velocity, normals : (callable, float)
        Weights and radii, over sums of grid coordinates.
    lines, shares : ndarray
        Distances to the grid lines passed at a place of the stress, and how much of their normals
        counts there.
    stretch : float
        By which such a sum is longer than the distance along the normal.
    """
    across, along = _across(kernel), _along(kernel)
    diagonal = _tabulated(along, across)
    # At corners 1 / mu is the mean of cells half a line before and behind.
    corners = np.arange(int(2 * kernel.along_radius) + 1)
    cells = np.arange(int(2 * diagonal[1]) + 1) + 0.5
    return (
        (across, across, along, corners, np.where(corners == 0, 0.5, 1.0), 1.0),
        (_tabulated(across, across), diagonal, diagonal, cells, np.ones(len(cells)), np.sqrt(2)))


@cache
def stress_ahead(kernel):
    """The factor b = P - 1/2, P the share of velocity read beyond where stress is read.

    Parameters
    ----------
    kernel : petscib.coupling.kernels.Kernel

    Returns
    -------
    (float, float)
        At 0 and at 45 degrees.
    """
    found = []
    for stress, velocity, *_, stretch in _sights(kernel):
        shift = STRESS_SHIFT * stretch
        x = np.arange(int(np.ceil(stress[1] + velocity[1] + shift))) + 0.5 - shift
        found.append(float(np.sum(_convolution(stress, velocity, x))) - 0.5)
    return tuple(found)


@cache
def stress_work(kernel, stiff, soft):
    """The factor W = int mu q^2 across a membrane, in grid spacings.

    q is the weight with which stress is read, STRESS_SHIFT on the stiff side, and 1 / mu = stiff +
    (soft - stiff) H, H the sum of the weights of the normals on the grid lines passed.

    Parameters
    ----------
    kernel : petscib.coupling.kernels.Kernel
    stiff, soft : float
        The lesser and the greater 1 / mu of both sides.

    Returns
    -------
    (float, float)
        At 0 and at 45 degrees.
    """
    return tuple(_work(sight, stiff, soft) for sight in _sights(kernel))


def _work(sight, stiff, soft):
    (weight, radius), _, (normal, _), lines, shares, stretch = sight
    shift = STRESS_SHIFT * stretch

    def integrand(x):
        passed = normal(x[..., None] - lines) @ shares
        return weight(x + shift) ** 2 / (stiff + (soft - stiff) * passed)

    # Where mu is large on one side, it changes fast.
    ends = np.linspace(-radius - shift, radius - shift, int(32 * radius) + 1)
    return float(stretch * _integrate(integrand, ends))
