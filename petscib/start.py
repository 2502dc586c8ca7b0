"""The problem and the state that a run starts from: as the options say, or from a checkpoint."""

import numpy as np

from .coupling.kernels import KERNELS
from .errors import InputError
from .fluid.advection import Advection
from .fluid.grid import Grid
from .fluid.operators import Operators
from .fluid.sides import Sides
from .membranes import mobility, shapes
from .membranes.curves import Curves
from .membranes.laws import Bending, Tension
from .membranes.membranes import Membranes
from .output import checkpoint
from .problem import Problem, State
from .settings import check_curve


def build_problem(settings, comm, header=None, remarks=None):
    """Problem and first state.  Collective.

    Parameters
    ----------
    settings : Settings
    comm : PETSc.Comm
    header : checkpoint.Header, optional
        Of the file to continue from.
    remarks : list of str, optional
        Gets what the user should know; equal on all ranks.

    Raises
    ------
    InputError
        On all ranks: the marker file or the checkpoint is unfit.
    """
    periodic = "x" in settings.periodic, "y" in settings.periodic
    grid = Grid((settings.stag_grid_x, settings.stag_grid_y), settings.domain, comm, periodic)
    sides = Sides(grid, settings.flow, settings.shear_rate)
    membranes, markers, stretch, areas = None, np.zeros((0, 2)), np.zeros(0), None
    if settings.vesicles:
        if header is not None:
            markers, stretch, rest = checkpoint.load_membrane(header, grid.comm.tompi4py())
            curves = _curves(markers, header.ds)
        else:
            markers, ds = _markers(settings, grid, [] if remarks is None else remarks)
            curves = _curves(markers, ds)
            stretch = rest = curves.stretching(markers)
            if settings.rest_length is not None:
                rest = np.full_like(stretch, settings.rest_length)
        membranes = Membranes(1, curves, _laws(settings, curves, rest), rest)
        if settings.conserve_area:
            areas = mobility.areas(curves, markers)
            if header is not None:  # those of the run's start
                areas = np.sign(areas) * header.progress.reference["area"]
    operators, advection = Operators(grid, sides), None
    if settings.advection != "none":
        advection = Advection(operators, settings.rho, settings.advection == "implicit")
    problem = Problem(
        grid,
        operators,
        settings.rho,
        settings.mu,
        membranes,
        KERNELS[settings.delta],
        settings.stretch == "evolve" and settings.sigma0 > 0,  # else nothing asks for it
        settings.kink_correction,
        areas,
        settings.body_force,
        advection,
    )
    if header is not None:
        return problem, checkpoint.load_state(header, grid, markers, stretch)
    velocity, pressure = grid.velocity_vector(), grid.pressure_vector()
    sides.fill(velocity)
    return problem, State(0, 0.0, velocity, pressure, markers, stretch)


def _curves(markers, ds):
    """How the markers of one closed membrane are joined, on the rank that has them."""
    return Curves([len(markers)], [ds]) if len(markers) else Curves([], [])


def _laws(settings, curves, rest):
    laws = []
    if settings.sigma0:
        laws.append(Tension(curves, settings.sigma0, rest))
    if settings.bending:
        laws.append(Bending(curves, settings.bending))
    return laws


def _markers(settings, grid, remarks):
    """Initial markers on rank 0, none elsewhere, and the parameter step.  Collective."""
    comm = grid.comm.tompi4py()
    markers, length, remark, trouble = np.zeros((0, 2)), 0.0, "", ""
    if comm.rank == 0:
        try:
            markers, length, remark = _curve(settings, 0.5 * min(grid.dx, grid.dy))
        except InputError as error:
            trouble = str(error)
    count, length, remark, trouble = comm.bcast((len(markers), length, remark, trouble))
    if trouble:
        raise InputError(trouble)
    if remark:
        remarks.append(remark)
    return markers, length / count


def _curve(settings, spacing):
    """Markers of the curve asked for, about `spacing` apart unless counted; length and remark."""
    if settings.marker_file is not None:
        return _curve_from_file(settings, spacing)
    length = shapes.ellipse_perimeter(settings.axes)
    count = settings.markers or round(length / spacing)
    return shapes.ellipse(settings.axes, settings.center, settings.angle, count), length, ""


def _curve_from_file(settings, spacing):
    # What these need of scipy takes some 0.3 s to load: not for an ellipse.
    from .membranes import curve_files
    from .membranes.crossings import find_crossing
    from .membranes.splines import Spline

    def unfit(why):
        return InputError(
            f"-marker_file {settings.marker_file}: {why}; allowed: {curve_files.ALLOWED}"
        )

    try:
        points, remark = curve_files.read_points(settings.marker_file)
        spline = Spline(points)
    except (OSError, ValueError) as error:
        raise unfit(error) from None
    check_curve(settings, points.min(axis=0), points.max(axis=0), spline.length, ("marker_file",))
    markers = spline.markers(settings.markers or round(spline.length / spacing))
    # The smooth curve goes a little beyond its points.
    low, high = markers.min(axis=0), markers.max(axis=0)
    check_curve(settings, low, high, spline.length, ("marker_file",))
    if find_crossing(markers):
        raise unfit("the smooth curve through the points crosses itself")
    return markers, spline.length, remark and f"-marker_file {settings.marker_file}: {remark}"
