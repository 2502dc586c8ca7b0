"""A model of the fluid's response to membrane forces, in marker space alone.

A force f on the markers moves them by (H + K) f, with H = J A^{-1} J^T / (dx dy) the
response of the fluid and K the kink correction.  The stresses m of the membranes solve

    (1 / (theta dt) + C (H + K) C^T) m = right-hand side,

and this module inverts that matrix with a model of H.  Along a straight membrane, for a wave number
k, H is

    1 / ds int dq / (2 pi) phi^2(k, q) / (mu (k^2 + q^2) + rho / (theta dt)),

half of it where the fluid's velocity has no divergence.  With phi^2 about exp(-s2 h^2 (k^2 + q^2)),
s2 the variance of the kernel, this is exp(-s2 h^2 k^2) R(k) / ds with

    R(k) = erfcx(sqrt(s2) h kappa) / (2 mu kappa),    kappa^2 = k^2 + rho / (mu theta dt).

R is fitted by a few poles, sum_j c_j / (p_j^2 + k^2), and the exponential is the square of the
kernel sampled along the curve, Phi.  What it passes on is smooth, so that *stations* along it
do that lie less densely than markers; Phi interpolates between both.  With one more unknown y_j a
station, component and pole,

    [ 1 / (theta dt) + C K C^T    C Phi ...             ] [m  ]
    [ Phi^T C^T ...               (D_ss - p_j^2) / c_j  ] [y_j],

D_ss the second difference: a sparse symmetric quasidefinite matrix along the curves, factored once
for each configuration of the membranes.  Nothing of it grows with the grid.
"""

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import block_diag, bmat, csr_matrix, diags, hstack, identity, kron, triu
from scipy.special import erfcx

from ..membranes.curves import Curves
from .cholesky import Cholesky
from .product import Product

POLES = 2  # a third saves no iterations (64^2 and 256^2, dt of h/4, h and 16 h)

# Distance in cells of the stations where the poles' unknowns are.  At 1 narrow kernels are sampled
# too coarsely (18 iterations instead of 12 with yang at 256^2, 45 instead of 22 with bspline43 at
# 64^2); at 1/2, as far apart as markers, a factorisation takes 1.7 times as long (128^2, 256^2).
STATIONS = 2 / 3

# Where the viscosity jumps: (s h k)^2 at which a wave feels as much of the smoothed layer as of
# what is around.  Forces along a circle's normal, contrasts 0.01 to 100, 64^2: 1.3 to 3.2.
LAYER = 1.8

# Largest change of C, relative to its largest entry, for which a factorisation is kept.  Passes of
# gbe and gcn took as many iterations at 3e-3 as with a new one (128^2, dt = h, sigma0 1e5 and 1e9).
KEPT = 1e-3


def fit_poles(wavenumbers, symbol, low, high):
    """Poles and weights with sum_j c_j / (p_j^2 + k^2) about `symbol`, relatively.

    Parameters
    ----------
    wavenumbers, symbol : ndarray
        Where it is fitted, and what.
    low, high : float
        The range of p.

    Returns
    -------
    poles, weights : ndarray
        p_j, and c_j > 0.
    """
    poles = np.geomspace(low, high, POLES)
    table = 1 / (poles**2 + wavenumbers[:, None] ** 2) / symbol[:, None]
    weights = nnls(table, np.ones(len(symbol)))[0]
    return poles[weights > 0], weights[weights > 0]


def _variance(kernel):
    """Variance of a kernel's weights, in squares of the grid spacing: the mean of its two."""
    def of(weight, radius):
        middle = (np.arange(64) + 0.5) / 64  # over all offsets to the grid, a sum is an integral
        lines = np.arange(-np.ceil(radius), np.ceil(radius) + 1)
        distance = lines[:, None] + middle - 0.5
        return np.mean(np.sum(weight(distance) * distance**2, axis=0))

    return (of(kernel.along, kernel.along_radius) + of(kernel.across, kernel.across_radius)) / 2


def _stations(curves, h):
    """Evenly spaced points along the curves, as curves of their own; no more than markers."""
    counts = np.diff(curves.starts)
    ds, closed = curves.ds[curves.starts[:-1]], curves.closed[curves.starts[:-1]]
    lengths = ds * (counts - ~closed)
    numbers = np.minimum(np.ceil(lengths / (STATIONS * h)).astype(int) + ~closed, counts)
    return Curves(numbers, lengths / np.maximum(numbers - ~closed, 1), closed)


def _sampled(kernel, h, curves, stations):
    """Sparse matrix that interpolates from stations to markers with a kernel."""
    number, spacing, first = (
        curves.spread(values) for values in (
            np.diff(stations.starts), stations.ds[stations.starts[:-1]], stations.starts[:-1]))
    local = np.arange(len(curves.ds)) - curves.spread(curves.starts[:-1])
    place = local * curves.ds / spacing
    reach = int(np.ceil(kernel.reach * h / stations.ds.min(initial=np.inf)))
    column = np.round(place).astype(int)[:, None] + np.arange(-reach, reach + 1)
    distance = (place[:, None] - column) * spacing[:, None] / h
    weights = kernel.along(distance) + kernel.across(distance)
    wraps = curves.closed[:, None]
    weights[~wraps & ((column < 0) | (column >= number[:, None]))] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    row, piece = np.nonzero(weights)
    column = first[row] + column[row, piece] % number[row]
    matrix = csr_matrix((weights[row, piece], (row, column)), (len(place), len(stations.ds)))
    matrix.sum_duplicates()
    return matrix


def _second_difference(lines):
    """D_ss of values at the points of some curves, without flux through open ends."""
    edge = np.arange(len(lines.edges))[:, None]
    values = np.tile((-1.0, 1.0), (len(edge), 1)) / lines.edge_ds[:, None]
    first = csr_matrix((values.ravel(), (np.repeat(edge, 2), lines.edges.ravel())),
                       (len(edge), len(lines.ds)))
    return -first.T @ first


class MarkerModel:
    """The model of 1 / (theta dt) + C (H + K) C^T, factored.  Not collective; work of rank 0.

    Parameters
    ----------
    curves : Curves
    grid : Grid
    kernel : Kernel
    rho : float
    mu : float or ndarray, shape (V,)
        Viscosity at each curve.
    share : float
        Factor of the response: 1/2 in the coupled system, where only the solenoidal part of a
        force moves the fluid, and 1 in the momentum system.
    prefix : str
        Options prefix of the direct solver.
    short : float or ndarray, shape (V,), optional
        Viscosity that short waves feel, where it is not mu.
    """

    def __init__(self, curves, grid, kernel, rho, mu, share, prefix, short=None):
        self.curves, self.rho, self.share = curves, rho, share
        # The poles are fitted to the mean viscosity; each curve's block is scaled by its own.
        self.mu = np.mean(mu)
        self._softer = 0.0 if short is None else np.mean(mu / short) - 1
        self.direct = Cholesky(prefix)
        self._stress, self._link = StressMatrix(), None
        self._order = self._interval = None
        h = np.sqrt(grid.dx * grid.dy)
        self._smoothing = np.sqrt(_variance(kernel)) * h
        stations = _stations(curves, h)
        self._phi = kron(_sampled(kernel, h, curves, stations), identity(2), format="csr")
        self._second = kron(_second_difference(stations), identity(2), format="csr")
        scale = stations.ds
        if np.ndim(mu) and curves.count:
            scale = scale * stations.spread(mu / self.mu)
        self._scale = diags(np.repeat(scale, 2))
        longest = max(np.diff(curves.starts) * curves.ds[curves.starts[:-1]], default=1.0)
        self._wavenumbers = np.geomspace(2 * np.pi / longest, 3 / h, 60)
        self._range = 2 * np.pi / longest, 2 / h

    def _fit(self, interval):
        """Fit the poles, and make the blocks that they alone change."""
        decay = self.rho / (self.mu * interval)
        kappa = np.sqrt(self._wavenumbers**2 + decay)
        symbol = self.share * erfcx(self._smoothing * kappa) / (2 * self.mu * kappa)
        short = (self._smoothing * self._wavenumbers) ** 2
        symbol *= 1 + self._softer * short / (short + LAYER)
        low = np.hypot(self._range[0], np.sqrt(decay))
        poles, weights = fit_poles(
            self._wavenumbers, symbol, low, max(self._range[1], 2 * low))
        self._blocks = [
            self._scale @ (self._second - p**2 * identity(self._second.shape[0])) / c
            for p, c in zip(poles, weights)
        ]
        self._interval, self._order = interval, None

    def begin(self):
        """Keep nothing from the last time step, so that a restart is the uninterrupted run."""
        self._rates = None

    def update(self, interval, operators):
        """Factor for theta dt = `interval` and the membranes' configuration.

        Parameters
        ----------
        interval : float
        operators : MarkerOperators
        """
        if not len(self.curves.ds):
            return
        rates = operators.rates.data
        if interval != self._interval:
            self._fit(interval)
        elif self._rates is not None and abs(rates - self._rates).max() <= KEPT * abs(rates).max():
            return
        self._rates = rates
        stress = self._stress.values(interval, operators)
        if self._link is None:
            self._link = Product(operators.rates, self._phi)
        link = self._link.values(rates, self._phi.data)
        if self._order is None:
            self._lay_out(self._stress.product.csr(stress), self._link.csr(link))
        np.take(np.concatenate([stress, link, self._fixed]), self._order, out=self._upper.data)
        self.direct.factor(self._upper)

    def _lay_out(self, stress, link):
        """Make the upper triangle, and say which value goes where in it."""
        blocks = block_diag(self._blocks, format="csr")
        self._fixed = blocks.data
        parts, first = [], 1  # numbers from 1 on, as a sparse matrix may drop zeros
        for part in (stress, link, blocks):
            number = np.arange(first, first + len(part.data), dtype=float)
            parts.append(csr_matrix((number, part.indices, part.indptr), part.shape))
            first += len(part.data)
        stress, link, blocks = parts
        whole = bmat([[stress, hstack([link] * len(self._blocks))], [None, blocks]])
        upper = triu(whole).tocsr()
        upper.sort_indices()
        self._order, self._upper = upper.data.astype(int) - 1, upper
        self._rows = stress.shape[0]
        self._rhs = np.zeros(upper.shape[0])

    def solve(self, values):
        """The model's inverse times an array over the stresses."""
        if not len(values):
            return values
        self._rhs[: self._rows] = values
        return self.direct.solve(self._rhs)[: self._rows]

    def destroy(self):
        """Free the factor."""
        self.direct.destroy()


class StressMatrix:
    """1 / (theta dt) + C K C^T, always with the same entries.  Not collective; on rank 0.

    Attributes
    ----------
    product : Product
        Makes a matrix of its values; from the first of these on.
    """

    def __init__(self):
        self.product = None

    def _begin(self, rates, count):
        columns = np.repeat(np.arange(count), 2)
        root = csr_matrix(
            (np.ones(2 * count), columns, np.arange(2 * count + 1)), (2 * count, count))
        self._along = Product(rates, root)
        along = self._along.csr(np.arange(1.0, len(self._along.indices) + 1))
        transposed = along.T.tocsr()
        self._transposed = transposed.data.astype(int) - 1
        self.product = Product(along, transposed)
        self._diagonal = np.flatnonzero(self.product.rows == self.product.indices)

    def values(self, interval, operators):
        """Its values for theta dt = `interval` and a configuration.

        Parameters
        ----------
        interval : float
        operators : MarkerOperators
            With a `slip`.
        """
        rates, slip = operators.rates, operators.slip
        if self.product is None:
            self._begin(rates, len(slip.mobility))
        # K is the square of this: along each marker's tangent.
        root = (np.sqrt(slip.mobility)[:, None] * slip.tangent).ravel()
        along = self._along.values(rates.data, root)
        square = self.product.values(along, along[self._transposed])
        square[self._diagonal] += 1 / interval
        return square

    def matrix(self, interval, operators):
        """The sparse matrix."""
        values = self.values(interval, operators)  # which makes the product at first
        return self.product.csr(values)
