"""The problem and the state that a run starts from: as the options say, or from a checkpoint."""

import numpy as np

from .coupling.kernels import KERNELS
from .errors import InputError
from .fluid.grid import Grid
from .fluid.operators import Operators
from .fluid.sides import Sides
from .membrane import geometry, shapes
from .membrane.forces import Membrane
from .output import checkpoint
from .problem import Problem, State
from .settings import check_curve


def build_problem(settings, comm, header=None):
    """Problem and first state.  Collective.

    Parameters
    ----------
    settings : Settings
    comm : PETSc.Comm
    header : checkpoint.Header, optional
        Of the file to continue from.

    Raises
    ------
    InputError
        On all ranks: the marker file or the checkpoint is unfit.
    """
    periodic = "x" in settings.periodic, "y" in settings.periodic
    grid = Grid((settings.stag_grid_x, settings.stag_grid_y), settings.domain, comm, periodic)
    sides = Sides(grid, settings.flow, settings.shear_rate)
    membrane, markers, stretch = None, np.zeros((0, 2)), np.zeros(0)
    if settings.vesicles:
        if header is not None:
            markers, stretch, rest = checkpoint.load_membrane(header, grid.comm.tompi4py())
            ds = header.ds
        else:
            markers, ds = _markers(settings, grid)
            stretch = rest = geometry.stretching(markers, ds)
            if settings.rest_length is not None:
                rest = np.full_like(stretch, settings.rest_length)
        membrane = Membrane(ds, settings.sigma0, settings.bending, rest)
    problem = Problem(
        grid,
        Operators(grid, sides),
        settings.rho,
        settings.mu,
        membrane,
        KERNELS[settings.delta],
        settings.stretch == "evolve" and settings.sigma0 > 0,  # else nothing asks for it
        settings.body_force,
    )
    if header is not None:
        return problem, checkpoint.load_state(header, grid, markers, stretch)
    velocity, pressure = grid.velocity_vector(), grid.pressure_vector()
    sides.fill(velocity)
    return problem, State(0, 0.0, velocity, pressure, markers, stretch)


def _markers(settings, grid):
    """Initial markers on rank 0, none elsewhere, and the parameter step.  Collective."""
    comm = grid.comm.tompi4py()
    markers, length, trouble = np.zeros((0, 2)), 0.0, ""
    if comm.rank == 0:
        try:
            markers, length = _curve(settings, 0.5 * min(grid.dx, grid.dy))
        except InputError as error:
            trouble = str(error)
    count, length, trouble = comm.bcast((len(markers), length, trouble))
    if trouble:
        raise InputError(trouble)
    return markers, length / count


def _curve(settings, spacing):
    """Markers of the curve asked for, about `spacing` apart unless counted, and its length."""
    if settings.marker_file is None:
        length = shapes.ellipse_perimeter(settings.axes)
        count = settings.markers or round(length / spacing)
        return shapes.ellipse(settings.axes, settings.center, settings.angle, count), length
    try:
        points = shapes.read_points(settings.marker_file)
        spline = shapes.Spline(points)
    except (OSError, ValueError, ImportError) as error:
        raise _unfit(settings, error) from None
    check_curve(settings, points.min(axis=0), points.max(axis=0), spline.length, ("marker_file",))
    markers = spline.markers(settings.markers or round(spline.length / spacing))
    # The smooth curve goes a little beyond its points.
    low, high = markers.min(axis=0), markers.max(axis=0)
    check_curve(settings, low, high, spline.length, ("marker_file",))
    if shapes.find_crossing(markers):
        raise _unfit(settings, "the smooth curve through the points crosses itself")
    return markers, spline.length


def _unfit(settings, why):
    return InputError(
        f"-marker_file {settings.marker_file}: {why}; allowed: a text file, x and y of one point "
        "a line, along a closed curve that does not cross itself"
    )
