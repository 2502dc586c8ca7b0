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

R is fitted roughly by one pole, c / (p^2 + k^2), and the exponential is the square of the kernel
sampled along the curve, Phi.  What it passes on is smooth, so that *stations* along it do that lie
less densely than markers; Phi interpolates between both.  This treats each wave by itself, while
waves that the grid cannot tell from each other answer as one: markers that lie half a cell apart
carry waves shorter than two cells.  For them A^{-1} is about a number,
alpha = 1 / (rho / (theta dt) + LOCAL mu / h^2), and H about

    L = alpha J J^T / (dx dy),

which couples markers that share faces of the grid.  With an unknown y a station and component,

    [ 1 / (theta dt) + C (L + K) C^T    C Phi            ] [m]
    [ Phi^T C^T                         (D_ss - p^2) / c ] [y],

D_ss the second difference: a sparse symmetric quasidefinite matrix along the curves, factored once
for each configuration of the membranes.  Nothing of it grows with the grid.
"""

import numpy as np
from scipy.sparse import bmat, csr_matrix, diags, identity, kron, triu
from scipy.special import erfcx

from ..membranes.curves import Curves
from .cholesky import Cholesky
from .overlap import Overlap
from .product import Product, numbered, transposed

# h^2 / mu times the viscous friction of the waves that L answers for.  With 6, 4 and 3 steps take
# as many iterations but for one to three (yang and bspline43, 64^2 and 128^2, mbe and be, dt of h
# and 4 h, sigma0 = 1e9, bending 0.01).  A second pole beside it saves up to three with yang, and
# adds up to ten to 17 with bspline43.
LOCAL = 4

# Distance in cells of the stations where the pole's unknowns are.  At 1 and at 1.25 there are as
# many iterations, at 1.5 up to two more (same runs).
STATIONS = 1.25

# Spacing of markers in cells below which L is left out for them, each of which shares faces with
# many. By L, iterations fall from 150 to 25, 200 to 30 and 220 to 32 at spacings of 0.48, 0.22 and
# 0.11 on 96^2 with dt = 16 h, and a step takes 0.85, 1.2 and 3 times as long; on 32^2 with dt = h
# they fall from 14 to 10 at 0.14 and 0.08, for 5 and 23 times the time (-scene stiff -scheme mbe
# -fft -sigma0 1e9 -bending 0.01 -delta bspline43 -markers N).
CROWDED = 0.2

# Samples of the kernel between two stations.
SAMPLES = 6

# Where the viscosity jumps: (s h k)^2 at which a wave feels as much of the smoothed layer as of
# what is around.  Forces along a circle's normal, contrasts 0.01 to 100, 64^2: 1.3 to 3.2.
LAYER = 1.8

# Largest change of C, relative to its largest entry, for which a factorisation is kept.  Passes of
# gbe and gcn took as many iterations at 3e-3 as with a new one (128^2, dt = h, sigma0 1e5 and 1e9).
KEPT = 1e-3


def fit_pole(wavenumbers, symbol, pole):
    """The c for which c / (p^2 + k^2) is about `symbol`, relatively.

    Parameters
    ----------
    wavenumbers, symbol : ndarray
        Where it is fitted, and what.
    pole : float
        p.
    """
    ratio = 1 / ((pole**2 + wavenumbers**2) * symbol)
    return ratio.sum() / (ratio @ ratio)


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
    # Linear in between stations, which lie too far apart for the kernel at them to be enough.
    shift = np.arange(1 - SAMPLES, SAMPLES) / SAMPLES
    reach = int(np.ceil(kernel.reach * h / stations.ds.min(initial=np.inf))) + 1
    column = np.round(place).astype(int)[:, None] + np.arange(-reach, reach + 1)
    distance = (place[:, None] - column)[:, :, None] + shift
    distance *= spacing[:, None, None] / h
    weights = (kernel.along(distance) + kernel.across(distance)) @ (1 - np.abs(shift))
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
        # The pole is fitted to the mean viscosity; each curve's block is scaled by its own.
        self.mu = np.mean(mu)
        self._softer = 0.0 if short is None else np.mean(mu / short) - 1
        if curves.count:
            self._short = curves.spread(
                np.broadcast_to(mu if short is None else short, curves.count))
        self.direct = Cholesky(prefix)
        self._overlap = Overlap(grid.cell_area)
        self._sharing = None
        self._interval = None
        self.forget()
        self._h = h = np.sqrt(grid.dx * grid.dy)
        if (curves.ds < CROWDED * h).any():
            self._sharing = diags(np.repeat((curves.ds >= CROWDED * h).astype(float), 2))
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

    def _fit(self, interval):
        """Fit the pole, and make the blocks that it alone changes."""
        decay = self.rho / (self.mu * interval)
        kappa = np.sqrt(self._wavenumbers**2 + decay)
        symbol = self.share * erfcx(self._smoothing * kappa) / (2 * self.mu * kappa)
        short = (self._smoothing * self._wavenumbers) ** 2
        symbol *= 1 + self._softer * short / (short + LAYER)
        pole = kappa[0]  # of the longest wave
        weight = fit_pole(self._wavenumbers, symbol, pole)
        block = self._second - pole**2 * identity(self._second.shape[0])
        self._block = triu(self._scale @ block / weight, format="csr")
        # Square root of alpha, at each marker.
        self._answer = 1 / np.sqrt(self.rho / interval + LOCAL * self._short / self._h**2)
        self._interval = interval

    def forget(self):
        """Choose places for the matrix's entries anew at the next update."""
        self._overlap.forget()
        self._order = None

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
        elif self._rates is not None and (
                abs(rates - self._rates).max(initial=0) <= KEPT * abs(rates).max(initial=0)):
            return
        self._rates = rates
        interpolation = operators.interpolation.on_root()
        if self._sharing is not None:
            interpolation = (self._sharing @ interpolation).tocsr()
            interpolation.eliminate_zeros()
        if self._overlap.update(interpolation) or self._order is None:
            self._lay_out(operators.rates)
        carried = self._carried.values(
            rates, self._overlap.values(self._answer, operators.slip))
        stress = self._stress.values(carried, rates[self._transposed])
        stress[self._diagonal] += 1 / interval
        link = self._link.values(rates, self._phi.data)
        np.take(np.concatenate([stress, link, self._block.data]), self._order,
                out=self._upper.data)
        self.direct.factor(self._upper)

    def _lay_out(self, rates):
        """Find which products there are, and where their values go in the upper triangle."""
        across, self._transposed = transposed(rates)
        self._carried = Product(rates, self._overlap.places)
        self._stress = Product(numbered(self._carried), across, upper=True)
        self._diagonal = np.flatnonzero(self._stress.rows == self._stress.indices)
        self._link = Product(rates, self._phi)
        parts, first = [], 0
        for part in (self._stress, self._link, self._block):
            parts.append(numbered(part, first))
            first += len(part.indices)
        stress, link, block = parts
        upper = bmat([[stress, link], [None, block]]).tocsr()
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
