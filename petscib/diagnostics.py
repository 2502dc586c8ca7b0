"""What is measured of a state: one row of numbers."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from . import energy
from .energy import Ledger
from .membranes import geometry

SOLVERS = ("momentum", "poisson", "coupled", "picard")
COLUMNS = (
    "step",
    "time",
    "dt",
    "local_error",
    "area",
    "perimeter",
    "area_error",
    "perimeter_error",
    "kinetic",
    "tension_energy",
    "bending_energy",
    "energy",
    *(f"ledger_{name}" for name in Ledger.names()),
    "ledger_residual",
    "max_divergence",
    "max_speed",
    "cfl",
    "inclination",
    "treading_frequency",
    "centroid_x",
    "centroid_y",
    *(f"{name}_iterations" for name in SOLVERS),
    "wall_seconds",
)


class Diagnostics:
    """Measures states.  Collective.

    Parameters
    ----------
    problem : Problem
    reference : dict, optional
        `area` and `perimeter` that the errors refer to; taken from the first state otherwise.
    """

    def __init__(self, problem, reference=None):
        self.problem = problem
        self.reference = reference
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
        row = dict.fromkeys(COLUMNS)
        row.update(step=state.step, time=state.time)
        energies = energy.measure(self.problem, state)
        row.update(
            kinetic=energies.kinetic,
            tension_energy=energies.tension,
            bending_energy=energies.bending,
            energy=energies.total,
        )
        row.update(self._fluid(state, step))
        if self.problem.membranes is not None:
            row.update(self._vesicle(state, step))
        if step is not None:
            row["dt"] = step.dt
            for name, count in step.iterations.items():
                row[f"{name}_iterations"] = count
        if ledger is not None:
            row.update((f"ledger_{name}", getattr(ledger, name)) for name in Ledger.names())
            row["ledger_residual"] = ledger.residual(max(largest_energy, energies.total))
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

    def _vesicle(self, state, step):
        measured = None
        if len(state.markers):
            markers = state.markers
            center = geometry.centroid(markers)
            measured = {
                "area": geometry.area(markers),
                "perimeter": geometry.perimeter(markers),
                "inclination": geometry.inclination(markers),
                "centroid_x": center[0],
                "centroid_y": center[1],
            }
            if step is not None:
                # It treads as seen from its middle, which may drift where no wall holds it.
                drift = (center - geometry.centroid(step.start.markers)) / step.dt
                motion = step.marker_velocity - np.where(self.problem.grid.periodic, drift, 0.0)
                measured["treading_frequency"] = geometry.treading_frequency(markers, motion)
        measured = self.problem.grid.comm.tompi4py().bcast(measured)
        if self.reference is None:
            self.reference = {name: measured[name] for name in ("area", "perimeter")}
        for name, value in self.reference.items():
            measured[f"{name}_error"] = abs(measured[name] - value) / value
        return measured
