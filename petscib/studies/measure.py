"""One petscib run with a clock on its steps, and after each step a fast solve for comparison.

``mpiexec -n N python -m petscib.studies.measure [petscib's options] [-warm_up STEPS]`` leaves the
usual results and ``measurement.json``.  Here a fast solve is the inverse of A0 = rho/dt - mu
Laplacian by transforms, for u and v, forth and back: the least that an implicit step can cost.
"""

import argparse
import json
import os
import sys
from statistics import median
from time import perf_counter

FAST_SOLVES = 3  # after each step; their median counts


def main(arguments=None):
    """Run and measure.  Collective.  Returns the exit status."""
    parser = argparse.ArgumentParser(allow_abbrev=False, add_help=False)
    parser.add_argument("-warm_up", type=int, default=2)
    ours, others = parser.parse_known_args(arguments)

    from .. import options, petsc

    petsc.start(others)
    from petsc4py import PETSc

    from ..driver import Driver
    from ..errors import Error

    root = PETSc.COMM_WORLD.rank == 0
    try:
        simulation = Driver(options.read(PETSc.Options().getAll()))
        clock = Clock(simulation, ours.warm_up)
        try:
            for _ in simulation.steps():
                clock.tick()
            record = clock.record()
        finally:
            simulation.destroy()
    except Error as error:
        if root:
            print(f"petscib: {error}", file=sys.stderr)
        return error.exit_status
    if root:
        with open(os.path.join(simulation.settings.output, "measurement.json"), "w") as file:
            json.dump(record, file, indent=2)
    return 0


class Clock:
    """Seconds of each step after the first few, in all and by phase.  Collective.

    Parameters
    ----------
    simulation : Driver
    warm_up : int
        Steps that are not measured: the first ones set up solvers.
    """

    def __init__(self, simulation, warm_up):
        self.simulation = simulation
        self.comm = simulation.comm
        self.left = warm_up
        self.steps, self.phases, self.solves = [], [], []
        self.fast_solve = self.peak_memory = None

    def tick(self):
        """Note the end of a step."""
        from .. import events
        from ..output.results import peak_memory

        self.comm.Barrier()
        if self.left <= 0:
            self.steps.append(perf_counter() - self._began)
            phases = {name: spent - self._before.get(name, 0.0)
                      for name, spent in events.seconds.items()}
            phases["no phase"] = self.steps[-1] - sum(phases.values())
            self.phases.append(phases)
        self.left -= 1
        if self.left == 0:  # before anything is made that the run itself does not need
            self.peak_memory = peak_memory(self.comm)
            self.fast_solve = FastSolve(self.simulation)
        if self.left < 0:
            self.solves.append(median(self.fast_solve.seconds() for _ in range(FAST_SOLVES)))
        self._before = dict(events.seconds)
        self.comm.Barrier()
        self._began = perf_counter()

    def record(self):
        """What was measured, with medians over the steps."""
        ratios = [step / solve for step, solve in zip(self.steps, self.solves)]
        return {
            "step_seconds": median(self.steps),
            "fastest_step_seconds": min(self.steps),
            "fast_solve_seconds": median(self.solves),
            "step_over_fast_solve": median(ratios),
            "phase_seconds": {
                name: median(phases.get(name, 0.0) for phases in self.phases)
                for name in self.phases[-1]
            },
            "peak_memory_bytes": self.peak_memory,
            "steps": self.steps,
            "fast_solves": self.solves,
        }


class FastSolve:
    """A0^{-1} times the velocity of a simulation's state, by transforms.  Collective."""

    def __init__(self, simulation):
        from ..solvers.transforms.diagonal import HelmholtzTransform

        problem = simulation.problem
        self.comm = simulation.comm
        self.transform = HelmholtzTransform(problem.grid)
        self.transform.set_coefficients(problem.rho / simulation.settings.ts_dt, problem.mu)
        self.rhs = simulation.state.velocity.copy()
        self.answer = self.rhs.duplicate()
        self.seconds()  # the first one makes tables

    def seconds(self):
        """Wall seconds of one solve."""
        self.comm.Barrier()
        began = perf_counter()
        self.transform.solve(self.rhs, self.answer)
        self.comm.Barrier()
        return perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
