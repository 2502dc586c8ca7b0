"""A force law of one's own: springs across a membrane, and a measure of what they do.

A law says how stresses m follow from the markers, the energy being |m|^2 / 2, and how exactly they
change (docs/extending.md).  It then takes part in the implicit system, the energy law and the
tables like those that petscib has.
"""

import os
import sys

import numpy as np

import petscib
from petscib.output.style import BLUE, GREY, VERMILLION, picture


class Struts:
    """Springs from each marker to the one opposite, of length zero and of some stiffness."""

    name, linear = "struts", True

    def __init__(self, curves, markers, stiffness=2.0):
        half = len(markers) // 2
        pairs = np.stack((np.arange(half), np.arange(half) + half), axis=1)
        self._pairs = pairs
        self._root = np.repeat(np.sqrt(stiffness * curves.ds[:half]), 2)
        # A stress for each component of each spring: which components of the markers it has.
        self.columns = np.stack(
            [2 * pairs[:, end, None] + np.arange(2) for end in (0, 1)], axis=-1).reshape(-1, 2)

    def stress(self, markers, stretch, time=0.0):
        """Roots of twice the energies: m."""
        return self._root * (markers[self._pairs[:, 1]] - markers[self._pairs[:, 0]]).ravel()

    def weights(self, before, after):
        """The entries of C, with m(after) - m(before) = C (after - before)."""
        return self._root[:, None] * (-1.0, 1.0)


def width(simulation):
    """A column of the tables; what rank 0 returns counts."""
    markers = simulation.markers
    return np.ptp(markers[:, 0]) if len(markers) else None


simulation = petscib.Simulation(
    sys.argv[1:], flow="rest", axes=(0.3, 0.45), markers=96, sigma0=1e4, bending=0.01,
    scheme="gbe", laws=[Struts], measures={"width": width}, ledger="record", ts_dt=0.02,
    ts_max_time=1.0, fft=True)
simulation.run()
table = simulation.diagnostics

if simulation.comm.rank == 0:
    os.makedirs("out/examples", exist_ok=True)
    with picture("out/examples/own_force.png", 8.0, 3.4) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(table["time"], table["struts_energy"], color=VERMILLION, label="struts")
        left.plot(table["time"], table["energy"], color=GREY, label="all")
        left.set(xlabel="time $t$", ylabel="energy")
        left.legend()
        right.plot(table["time"], table["width"], color=BLUE)
        right.set(xlabel="time $t$", ylabel="width of the vesicle")
    worst = np.nanmax(table["ledger_residual"])
    print(f"the energy law holds to {worst:.1e}; see out/examples/own_force.png")
