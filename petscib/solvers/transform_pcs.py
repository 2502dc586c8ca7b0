"""The fast direct solvers (see `transforms`) as preconditioners that PETSc makes by name:

``-poisson_pc_type python -poisson_pc_python_type petscib.solvers.transform_pcs.PoissonTransform``.
"""

from petsc4py import PETSc

from ..errors import InputError
from . import krylov
from .transforms import helmholtz, poisson, stokes


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
    """PETSc python PC: `HelmholtzTransform` of a `FluidMatrix`, which carries what it needs."""

    exact = True
    _solver = None

    def setUp(self, pc):
        """Take over the matrix's coefficients.  Collective."""
        matrix = pc.getOperators()[1]
        coefficients = attribute(matrix, "coefficients")
        if self._solver is None:
            self._solver = helmholtz.HelmholtzTransform(attribute(matrix, "grid"))
        self._solver.set_coefficients(*coefficients)

    def apply(self, pc, x, y):
        """y = A0^{-1} x."""
        self._solver.solve(x, y)

    def respond(self, force, velocity):
        """Set `velocity` to what `force` causes.  Collective."""
        self._solver.solve(force, velocity)

    def window(self, faces):
        """The answer to forces on some faces, restricted to them."""
        return self._solver.window(faces)

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by sine transforms\n")

    def destroy(self, pc):
        """Free what PETSc keeps; PETSc calls this.  Collective."""
        if self._solver is not None:
            self._solver.destroy()


class PoissonTransform:
    """PETSc python PC: `PoissonTransform` of a pressure Laplacian that carries its grid."""

    exact = True
    _solver = None

    def setUp(self, pc):
        """Make the transforms, once.  Collective."""
        if self._solver is None:
            self._solver = poisson.PoissonTransform(attribute(pc.getOperators()[1], "grid"))

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


class StokesTransform:
    """PETSc python PC: `StokesTransform` of a `CoupledSolver`'s matrix, which carries the pair."""

    exact = True
    _solver = None

    def setUp(self, pc):
        """Take over the matrix's coefficients.  Collective."""
        if self._solver is None:
            self._pair = pair = attribute(pc.getOperators()[1], "pair")
            self._given, *self._source = pair.layout.joint()
            self._answer, *self._found = pair.layout.joint()
            self._solver = stokes.StokesTransform(pair.grid, pair.fluid.operators)
        self._solver.set_coefficients(*self._pair.fluid.matrix.getAttr("coefficients"))

    def apply(self, pc, x, y):
        """y = K0^{-1} x."""
        (_, source), (_, pressure) = self._source, self._found
        x.copy(self._given)
        source.scale(1 / self._pair.scale)
        self._solver.solve(*self._source, *self._found)
        pressure.scale(1 / self._pair.scale)
        self._answer.copy(y)

    def __getattr__(self, name):
        if name in ("respond", "window", "pressure", "lift"):
            return getattr(self._solver, name)
        raise AttributeError(name)

    def view(self, pc, viewer):
        """Say what it is."""
        viewer.printfASCII("  exact, by sine transforms of the stream function\n")

    def destroy(self, pc):
        """Free what PETSc keeps; PETSc calls this.  Collective."""
        if self._solver is not None:
            self._solver.destroy()
            for vector in (*self._source, *self._found, self._given, self._answer):
                vector.destroy()
