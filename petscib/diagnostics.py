"""What is measured of a state: one row of numbers."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from . import energy, rheology, turning
from .energy import Ledger
from .errors import InputError, shortened
from .membranes import geometry
from .membranes.laws import LAWS

SOLVERS = ("momentum", "poisson", "coupled", "picard")
SHAPES = ("area", "perimeter", "area_error", "perimeter_error")
FORCES = tuple(name for law in LAWS.values() for name in getattr(law, "measures", ()))
PLACES = ("inclination", "turns", "half_turn", "treading_frequency", "centroid_x", "centroid_y")


def columns(vesicles, laws=()):
    """Names of the columns for a number of vesicles: with several, those of each get a number.

    Laws of the user's have theirs too.
    """
    return (
        "step", "time", "dt", "local_error",
        *numbered(SHAPES, vesicles),
        "kinetic", *(f"{name}_energy" for name in LAWS), "energy",
        *(f"ledger_{name}" for name in Ledger.names()), "ledger_residual",
        *(f"{prefix}{name}{end}" for name in laws
          for prefix, end in (("", "_energy"), ("ledger_", ""))),
        "max_divergence", "max_speed", "cfl", "effective_viscosity", "min_gap",
        *numbered(PLACES, vesicles), *numbered(FORCES, vesicles),
        *(f"{name}_iterations" for name in SOLVERS),
        "wall_seconds",
    )


def numbered(names, vesicles):
    """Names of columns for each of some vesicles: area, or area_0, area_1 and so on."""
    if vesicles < 2:
        return list(names)
    return [f"{name}_{number}" for number in range(vesicles) for name in names]


class Diagnostics:
    """Measures states.  Collective.

    Parameters
    ----------
    problem : Problem
    reference : dict of str to list, optional
        `area` and `perimeter` that the errors refer to; taken from the first state otherwise.
    measures : dict of str to callable, optional
        Further columns: each gives, without arguments, a number, which counts on rank 0.

    Raises
    ------
    InputError
        A measure has the name of a column.
    """

    def __init__(self, problem, reference=None, measures=None):
        self.problem = problem
        self.reference = reference
        self.measures = measures or {}
        self.vesicles = 0 if problem.membranes is None else problem.membranes.count
        own = [law.name for law in problem.membranes.laws] if self.vesicles else []
        usual = columns(self.vesicles, [name for name in own if name not in LAWS])
        for name in self.measures:
            if not str(name).isidentifier() or name in usual:
                raise InputError(f"measures: {name}: not a new column's name; allowed: a word that "
                                 "no column has")
        self.columns = (*usual[:-1], *self.measures, usual[-1])
        self._cells = problem.grid.pressure_vector()

    def row(self, state, step=None, ledger=None, largest_energy=0.0):
        """Measure a state.

        Parameters
        ----------
        state : State
        step : Step, optional
            The step that led to it.
        ledger : Ledger, optional
        largest_energy : float
            Of earlier states: with this one's, the scale of the ledger's defect.

        Returns
        -------
        dict
            By column; None where a column does not apply.  Equal on all ranks.
        """
        row = dict.fromkeys(self.columns)
        row.update(step=state.step, time=state.time)
        energies = energy.measure(self.problem, state)
        row.update(kinetic=energies.kinetic, energy=energies.total)
        row.update((f"{name}_energy", value) for name, value in energies.laws.items())
        row.update(self._fluid(state, step))
        row["effective_viscosity"] = rheology.effective_viscosity(self.problem, state.velocity)
        if self.problem.membranes is not None:
            row.update(self._vesicles(state, step))
        if step is not None:
            row["dt"] = step.dt
            for name, count in step.iterations.items():
                row[f"{name}_iterations"] = count
        if ledger is not None:
            row.update((f"ledger_{name}", value) for name, value in ledger.terms().items())
            row["ledger_residual"] = ledger.residual(max(largest_energy, energies.total))
        for name, measure in self.measures.items():
            value = self.problem.grid.comm.tompi4py().bcast(measure())
            try:
                row[name] = value if value is None else float(value)
            except (TypeError, ValueError):
                raise InputError(f"measures: {name}: {shortened(repr(value))} is no number; "
                                 "allowed: a function that returns a number, or None") from None
        return row

    def _fluid(self, state, step):
        grid = self.problem.grid
        u, v = grid.velocity_blocks(state.velocity)
        local = np.array([np.abs(u).max(initial=0), np.abs(v).max(initial=0)])
        largest = np.empty(2)
        grid.comm.tompi4py().Allreduce(local, largest, op=MPI.MAX)
        self.problem.operators.divergence.mult(state.velocity, self._cells)
        measured = {
            "max_speed": largest.max(),
            "max_divergence": self._cells.norm(PETSc.NormType.INFINITY),
        }
        if step is not None:
            measured["cfl"] = step.dt * max(largest / (grid.dx, grid.dy))
        return measured

    def _vesicles(self, state, step):
        measured = gap = None
        if len(state.markers):
            measured = self._shapes(state, step)
            gap = self.problem.gaps.measure(state.markers).distance
        measured, gap = self.problem.grid.comm.tompi4py().bcast((measured, gap))
        if self.reference is None:
            self.reference = {name: measured[name].tolist() for name in ("area", "perimeter")}
        for name, values in self.reference.items():
            measured[f"{name}_error"] = abs(measured[name] - values) / values
        row = {"min_gap": gap if np.isfinite(gap) else None}
        for name, values in measured.items():
            for column, value in zip(numbered([name], self.vesicles), values):
                row[column] = None if np.isnan(value) else value
        for number in np.flatnonzero(np.isnan(measured["area"])):  # that enclose no area
            suffix = f"_{number}" if self.vesicles > 1 else ""
            for name in ("area", "area_error", "inclination", "turns", "treading_frequency"):
                row[name + suffix] = None
        return row

    def _shapes(self, state, step):
        """What is measured of each vesicle, arrays by name."""
        curves, markers = self.problem.membranes.curves, state.markers
        center = geometry.centroid(markers, curves)
        measured = {
            "area": geometry.area(markers, curves),
            "perimeter": geometry.perimeter(markers, curves),
            "inclination": geometry.inclination(markers, curves),
            "centroid_x": center[:, 0],
            "centroid_y": center[:, 1],
        }
        if turning.TURNING in state.history:
            measured["turns"], measured["half_turn"] = turning.measure(state)
        if step is not None:
            # It treads as seen from its middle, which drifts where it is not held.
            drift = (center - geometry.centroid(step.start.markers, curves)) / step.dt
            if curves.count == 1:  # walls hold the middle
                drift = np.where(self.problem.grid.periodic, drift, 0.0)
            motion = step.marker_velocity - curves.spread(drift)
            measured["treading_frequency"] = geometry.treading_frequency(markers, motion, curves)
            if step.stress is not None:
                measured.update(self.problem.membranes.measures(step.stress))
        return measured
