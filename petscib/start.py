"""The problem and the state that a run starts from: as the options say, or from a checkpoint."""

import numpy as np

from . import outlines
from .agreement import on_root
from .coupling.kernels import KERNELS
from .errors import InputError
from .fluid.advection import Advection
from .fluid.grid import Grid
from .fluid.operators import Operators
from .fluid.sides import Sides
from .membranes import geometry
from .membranes.laws import check_law
from .membranes.membranes import Constants, Membranes
from .output import checkpoint
from .problem import Problem, State
from .solvers import poisson

# The solver of the indicator of the membranes' insides, once a step.  With tolerances of 1e-4,
# 1e-6, 1e-8 and 1e-10 markers are off by 5e-7, 5e-9, 3e-11 and 4e-13 after 6 steps, for 6, 9, 12
# and 15 iterations (-scene tumbling -stag_grid_x 48 -scheme mbe -ts_dt 0.05, other tolerances
# 1e-13).
INDICATOR = {"prefix": "poisson_indicator_", "defaults": {**poisson.DEFAULTS, "ksp_rtol": 1e-10}}


def build_problem(settings, comm, header=None, remarks=None, own_laws=()):
    """Problem and first state.  Collective.

    Parameters
    ----------
    settings : Settings
    comm : PETSc.Comm
    header : checkpoint.Header, optional
        Of the file to continue from.
    remarks : list of str, optional
        Gets what the user should know; equal on all ranks.
    own_laws : sequence of callables
        Each makes a law of the user's from the curves and the markers that the run begins with, of
        which there are none but on rank 0.

    Raises
    ------
    InputError
        On all ranks: the marker file or the checkpoint is unfit.
    """
    periodic = "x" in settings.periodic, "y" in settings.periodic
    grid = Grid((settings.stag_grid_x, settings.stag_grid_y), settings.domain, comm, periodic)
    sides = Sides(grid, settings.flow, settings.shear_rate)
    operators, advection = Operators(grid, sides), None
    membranes, markers, stretch = _membranes(
        settings, grid, header, [] if remarks is None else remarks, own_laws)
    if settings.advection != "none":
        advection = Advection(operators, settings.rho, settings.advection == "implicit")
    problem = Problem(
        grid,
        operators,
        settings.rho,
        settings.mu,
        membranes,
        KERNELS[settings.delta],
        # Without tension nothing asks for it.
        settings.stretch == "evolve" and membranes is not None and bool(membranes.law("tension")),
        settings.kink_correction,
        _areas_to_keep(settings, membranes, markers, header),
        settings.body_force,
        advection,
        _viscosity(settings, operators, membranes),
    )
    if header is not None:
        return problem, checkpoint.load_state(header, grid, markers, stretch)
    velocity, pressure = grid.velocity_vector(), grid.pressure_vector()
    sides.fill(velocity)
    if callable(settings.flow) or settings.flow == "taylor-green":
        _make_solenoidal(operators, velocity, settings.fft)
    return problem, State(0, 0.0, velocity, pressure, markers, stretch)


def _membranes(settings, grid, header, remarks, own_laws):
    """Membranes (None without any), markers and stretching at the start.  Collective."""
    comm = grid.comm.tompi4py()
    if not settings.vesicles:
        if own_laws:
            raise InputError("laws: there is no vesicle for them (vesicles is 0); allowed: "
                             "vesicles=1, or no laws")
        return None, np.zeros((0, 2)), np.zeros(0)
    if header is not None:
        curves, markers, stretch, rest, targets = checkpoint.load_membranes(header, comm)
    else:
        curves, markers = _first(settings, grid, remarks)
        stretch, targets = curves.stretching(markers), markers
        rest = outlines.rest_of(settings, curves, stretch)
    laws, loads = outlines.laws_of(settings, grid, curves, rest, targets)
    laws += _own(own_laws, curves, markers, laws, comm)
    held = any(vesicle.tether for vesicle in settings.each_vesicle())
    constants = comm.bcast(Constants(curves, rest, targets if held else None))
    return Membranes(settings.vesicles, curves, laws, rest, loads, constants), markers, stretch


def _areas_to_keep(settings, membranes, markers, header):
    """Signed areas at the start of the run, on rank 0; None where they are not kept."""
    if membranes is None or not settings.conserve_area:
        return None
    areas = geometry.signed_area(markers, membranes.curves)
    if header is not None:
        start = header.progress.reference["area"][: len(areas)]
        areas = np.sign(areas) * np.array(start)
    return areas


def _viscosity(settings, operators, membranes):
    """The viscosity where it varies; None where it does not.  Collective."""
    if not settings.has_contrast:
        return None
    from .fluid.viscosity import Viscosity

    contrasts = np.array([vesicle.viscosity_contrast for vesicle in settings.each_vesicle()])
    return Viscosity(
        operators, KERNELS[settings.delta], membranes.curves, settings.mu,
        settings.mu * contrasts, poisson.poisson_solver(operators, settings.fft, **INDICATOR))


def _own(makers, curves, markers, others, comm):
    """Laws of the user's, each of which must be one.  Collective."""
    laws = []
    for make in makers:
        if not callable(make):
            raise InputError(f"laws: {make!r} cannot be called; allowed: a function of the curves "
                             "and the markers that makes a law, or its class")
        law = make(curves, markers)
        on_root(comm, lambda law=law: check_law(law, [*others, *laws], markers))
        laws.append(law)
    return laws


def _make_solenoidal(operators, velocity, fft):
    """Take the divergence from a flow, of which one given at points may have some.  Collective."""
    solver = poisson.poisson_solver(operators, fft)
    source, potential = (operators.grid.pressure_vector() for _ in range(2))
    operators.divergence.mult(velocity, source)
    solver.solve(source, potential)
    correction = velocity.duplicate()
    operators.gradient.mult(potential, correction)
    velocity.axpy(-1.0, correction)
    for part in (solver, source, potential, correction):
        part.destroy()


def _first(settings, grid, remarks):
    """Curves and markers at the start, on rank 0, none elsewhere.  Collective."""
    made = []

    def make():
        made.extend(outlines.first(settings, grid))
        return [one.remark for one in made if one.remark]

    remarks += on_root(grid.comm.tompi4py(), make)
    return outlines.curves_of(made), np.concatenate(
        [np.zeros((0, 2)), *(one.markers for one in made)])
