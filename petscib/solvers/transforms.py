"""Fast direct solvers of the momentum and Poisson matrices, by transforms (see `spectral`).

They are preconditioners that PETSc makes by name: ``-poisson_pc_type python
-poisson_pc_python_type petscib.solvers.transforms.PoissonTransform``.
"""

from petsc4py import PETSc

from ..errors import InputError
from . import krylov
from .spectral import NO_FLUX, Field, SpectralSolver, given_places, velocity_fields
from .window import Window


def use(prefix, preconditioner, alone):
    """Put a fast direct solver under a solver, unless the user has chosen another.

    Parameters
    ----------
    prefix : str
        Options prefix of the solver.
    preconditioner : type
    alone : bool
        Whether it inverts the whole system, so that no iteration is needed; else conjugate
        gradients find the membrane's force (see `force`).
    """
    if not PETSc.Options(prefix).hasName("pc_type"):
        defaults = {"ksp_type": "preonly"}
        if not alone:
            # Less accurate solves would be little cheaper, and show in the energy law; and many
            # iterations are cheap too, where a membrane that nearly touches itself needs them.
            defaults = {"ksp_type": "cg", "ksp_rtol": 1e-7, "ksp_max_it": 1000}
        name = f"{preconditioner.__module__}.{preconditioner.__name__}"
        krylov.set_defaults(prefix, {**defaults, "pc_type": "python", "pc_python_type": name})


def attribute(matrix, name):
    """Python attribute of a PETSc matrix that the transforms cannot do without."""
    value = matrix.getAttr(name)
    if value is None:
        raise InputError(
            f"a matrix under one of the fast solvers has no {name}: FluidTransform is only for "
            "rho/dt - mu Laplacian, PoissonTransform for the pressure's Laplacian, StokesTransform "
            "for the coupled system"
        )
    return value


class FluidTransform:
    """PETSc python PC: the inverse of rho / (theta dt) - mu Laplacian on the velocity layout.

    Its matrix must be that of a `FluidMatrix`, which carries the grid and the coefficients.
    """

    exact = True

    def __init__(self):
        self._solver = self._coefficients = None

    def setUp(self, pc):
        """Take over the matrix's coefficients.  Collective."""
        matrix = pc.getOperators()[1]
        coefficients = attribute(matrix, "coefficients")
        if self._solver is None:
            self._grid = grid = attribute(matrix, "grid")
            fields = velocity_fields(grid)
            vector = grid.velocity_vector()
            self._solver = SpectralSolver(grid, fields, vector)
            self._walls = given_places(fields, vector)
            vector.destroy()
        if coefficients != self._coefficients:
            self._coefficients = coefficients
            self._solver.set_operator(*coefficients)

    def apply(self, pc, x, y):
        """y = A0^{-1} x."""
        self.respond(x, y)

    def respond(self, force, velocity):
        """Set `velocity` to what `force` causes.  Collective."""
        self._solver.solve(force, velocity)
        # Faces on walls are coupled to no others.
        velocity.getArray()[self._walls] = (
            force.getArray(readonly=True)[self._walls] / self._coefficients[0])

    def window(self, faces):
        """The answer to forces on some faces, restricted to them (see `Window`)."""
        return Window(self._grid, *self._coefficients, faces)

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by sine transforms\n")

    def destroy(self, pc):
        """Free what PETSc keeps; PETSc calls this.  Collective."""
        if self._solver is not None:
            self._solver.destroy()


class PoissonTransform:
    """PETSc python PC: pseudo-inverse of minus the Laplacian without flux through the walls.

    Its matrix must be the pressure Laplacian of a `PoissonSolver`, which carries the grid.
    Answers have zero mean.
    """

    exact = True

    def __init__(self):
        self._solver = None

    def setUp(self, pc):
        """Make the transforms, once.  Collective."""
        if self._solver is None:
            grid = attribute(pc.getOperators()[1], "grid")
            vector = grid.pressure_vector()
            field = Field(grid.p_index, (NO_FLUX, NO_FLUX))
            self._solver = SpectralSolver(grid, [field], vector)
            self._solver.set_operator(0.0, 1.0)
            vector.destroy()

    def apply(self, pc, x, y):
        """Set y to the pseudo-inverse times x."""
        self._solver.solve(x, y)

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by cosine transforms\n")

    def destroy(self, pc):
        """Free what PETSc keeps; PETSc calls this.  Collective."""
        if self._solver is not None:
            self._solver.destroy()
