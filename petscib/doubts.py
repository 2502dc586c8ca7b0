"""Why the results of a run are not to be trusted, said at its end."""

import numpy as np

from .alerts import TIME_STEP
from .combinations import WIDEST_SPACING
from .fluid import flows
from .membranes import geometry
from .output.rows import entry, largest
from .schemes.registry import SCHEMES

JUDGED = "area_error", "perimeter_error", "ledger_residual", "cfl"  # columns, by their largest
# At a CFL number of 1 schemes of first order are 3 to 6 percent off (with shear_rate dt = 0.03 in
# `accuracy`).
LARGEST_CFL = 1.0
DRIFT = 0.01  # of area, of perimeter, and of the radius from where it started
# Cells between markers.  With 0.1 solves take 21 iterations in place of 5, for the same answers (as
# for WIDEST_SPACING, -markers 582 and 290).
NARROWEST_SPACING = 0.2


class Doubts:
    """Why the results of a run are not to be trusted, each with the option that helps.

    Parameters
    ----------
    settings : Settings
    problem : Problem

    Attributes
    ----------
    found : list of str
        Filled at the end; equal on all ranks.
    """

    def __init__(self, settings, problem):
        self.settings, self.problem = settings, problem
        self.found = []
        self._largest, self._first, self._last = dict.fromkeys(JUDGED, 0.0), None, None

    def note(self, row):
        """Take note of a row of diagnostics."""
        for name in JUDGED:
            self._largest[name] = largest((entry(row, name), self._largest[name]))
        self._first, self._last = self._first or row, row

    def end(self, state, said=()):
        """Judge the run at its end.  Collective.

        Parameters
        ----------
        state : State
        said : sequence of str
            What the run has warned of already; on rank 0.
        """
        found = [*self._drift(), *self._numbers(said), *self._spacing(state)]
        if said:
            found.insert(0, f"{' and '.join(said)}, as said above")
        self.found = self.problem.grid.comm.tompi4py().bcast(found)

    def _is_first_order(self):
        return SCHEMES[self.settings.scheme].order == 1

    def _tolerances(self):
        """What solves more exactly."""
        coupled = SCHEMES[self.settings.scheme].coupled
        names = [f"-{'coupled' if coupled else 'momentum'}_ksp_rtol"]
        if (self._last or {}).get("picard_iterations") is not None:
            names.insert(0, "-picard_rtol")
        return f"a smaller {' or '.join(names)}"

    def _drift(self):
        """Of area, perimeter and place."""
        settings, found = self.settings, []
        first_order = self._is_first_order()
        better = "-scheme gcn or a smaller -ts_dt" if first_order else "a smaller -ts_dt"
        if not self._largest["area_error"] <= DRIFT:  # perhaps not a number
            keeps = better if settings.conserve_area else "-conserve_area"
            found.append(f"area off by {self._largest['area_error']:.1%}: {keeps}")
        inextensible = all(vesicle.rest_length is None and vesicle.sigma0 > 0
                           for vesicle in settings.each_vesicle())
        if inextensible and not self._largest["perimeter_error"] <= DRIFT:
            values = {vesicle.sigma0 for vesicle in settings.each_vesicle()}
            stiffer = f"a -sigma0 above {max(values):g}" if len(values) == 1 else "a larger -sigma0"
            found.append(f"perimeter off by {self._largest['perimeter_error']:.1%}: {better}, or "
                         f"{stiffer}")
        drift = self._centroid_drift()
        if drift > DRIFT:
            found.append(
                f"the vesicle has drifted by {drift:.1%} of its radius from the middle of the "
                "flow, so that inclination and frequency mean little: an even number of -markers "
                f"and of cells, {self._tolerances()}")
        return found

    def _centroid_drift(self):
        """How far a vesicle has gone from a place where the flow rests, over its radius."""
        settings, first, last = self.settings, self._first or {}, self._last or {}
        pushed = self.problem.loaded or self.problem.body_force is not None or settings.tether > 0
        alone = settings.vesicles == 1 and settings.flow != "rest"
        if pushed or not alone or not first.get("area"):
            return 0.0
        start, end = (np.array([row["centroid_x"], row["centroid_y"]]) for row in (first, last))
        radius = np.sqrt(first["area"] / np.pi)
        speed = flows.velocity(settings.flow, *start, settings.shear_rate, settings.domain)
        if np.hypot(*speed) > DRIFT * radius * flows.rate(
                settings.flow, *start, settings.shear_rate, settings.domain):
            return 0.0
        return np.hypot(*(end - start)) / radius

    def _numbers(self, said):
        """Of time step and ledger."""
        settings, found = self.settings, []
        cfl, residual = (self._largest[name] for name in ("cfl", "ledger_residual"))
        carried = settings.vesicles and settings.tether == 0
        if carried and self._is_first_order() and cfl > LARGEST_CFL and (
                TIME_STEP not in said and settings.ts_rtol is None):
            found.append(f"CFL number up to {cfl:.2g} with a scheme of first order: -ts_dt "
                         f"{settings.ts_dt * LARGEST_CFL / cfl:.2g}, or -scheme gcn")
        if not residual <= settings.ledger_tol:
            found.append(f"energy ledger off by {residual:.1e}: {self._tolerances()}")
        return found

    def _spacing(self, state):
        """Of the markers, on the rank that has them."""
        if not len(state.markers):
            return []
        grid, curves = self.problem.grid, self.problem.curves
        spacing = geometry.length(curves.edge_vectors(state.markers)) / min(grid.dx, grid.dy)
        if spacing.max() > WIDEST_SPACING:
            return [f"markers are {spacing.max():.2g} cells apart, and fluid passes between them: "
                    "more -markers"]
        if spacing.min() < NARROWEST_SPACING:
            return [f"markers are {spacing.min():.2g} cells apart: fewer -markers, or a finer grid"]
        return []
