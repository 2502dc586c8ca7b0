"""Krylov solvers by option prefix, with defaults that the user's options override."""

import importlib
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from .. import entries
from ..errors import InputError, SolveError

_REASONS = {
    value: name
    for name, value in vars(PETSc.KSP.ConvergedReason).items()
    if isinstance(value, int) and name.startswith("DIVERGED")
}


class Operator:
    """A square PETSc matrix whose product an object computes.

    One matrix serves a whole run, because preconditioners keep a reference to it.

    Parameters
    ----------
    vector : PETSc.Vec
        Any vector of its layout.
    action
        Its method mult(x, y) sets y to the product with x; its `what` says what the unknowns are.
    """

    def __init__(self, vector, action):
        self.action = action
        sizes = (vector.getSizes(),) * 2
        self.matrix = PETSc.Mat().createPython(sizes, self, comm=vector.comm)
        self.matrix.setUp()

    def mult(self, matrix, x, y):
        """What PETSc calls."""
        self.action.mult(x, y)
        y.stateIncrease()  # set through its parts

    def view(self, matrix, viewer):
        """What PETSc calls for -ksp_view."""
        viewer.printfASCII(f"    unknowns: {self.action.what}\n")

    def changed(self):
        """Tell PETSc that the matrix is another now."""
        self.matrix.assemble()

    def destroy(self, matrix=None):
        """Free the matrix; PETSc calls this too.  Collective."""
        if matrix is None:
            self.matrix.destroy()


def join(blocks):
    """One vector that is made of all of these, or the only one of them."""
    return blocks[0] if len(blocks) == 1 else PETSc.Vec().createNest(blocks, comm=blocks[0].comm)


def blocks_of(vector):
    """The vectors that one is made of, or itself alone."""
    return vector.getNestSubVecs() if vector.getType() == "nest" else [vector]


def vector_on_root(count, comm):
    """New zero vector with `count` entries on the first rank and none on the others."""
    return PETSc.Vec().createMPI((count if comm.rank == 0 else 0, PETSc.DETERMINE), comm=comm)


def use_python(ksp, context):
    """Let an object precondition, unless the user has chosen something else."""
    pc = ksp.getPC()
    if pc.getType() == "python" and pc.getPythonContext() is None:
        pc.setPythonContext(context)


def set_defaults(prefix, defaults):
    """Enter options under `prefix` unless the user has given them.

    They stay in PETSc's database, because inner solvers read theirs late.
    """
    for name, value in defaults.items():
        entries.present().add_default(prefix + name, value)


def create(matrix, prefix, defaults):
    """New KSP on the matrix's communicator, set from the options under `prefix`.

    Iterative ones start from the solution vector's values.  Collective on the matrix.
    """
    set_defaults(prefix, defaults)
    ksp = PETSc.KSP().create(comm=matrix.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(matrix)
    try:
        ksp.setFromOptions()
    except Exception:
        ksp.destroy()  # at exit, PETSc can no longer free one with a python preconditioner
        _check_python_type(prefix)
        raise
    ksp.setInitialGuessNonzero(ksp.getType() != "preonly")
    if ksp.getType() == "cg" and not PETSc.Options(prefix).hasName("ksp_norm_type"):
        ksp.setNormType(PETSc.KSP.NormType.NATURAL)  # which costs nothing, as r^T B r is known
    return ksp


def _check_python_type(prefix):
    """Refuse a python preconditioner that is not there; one that fails is another matter."""
    name = PETSc.Options(prefix).getString("pc_python_type", "")
    module, _, attribute = name.rpartition(".")
    try:
        if name and not hasattr(importlib.import_module(module or name), attribute):
            raise InputError(f"-{prefix}pc_python_type {name}: {module} has no {attribute}")
    except ModuleNotFoundError as error:
        raise InputError(f"-{prefix}pc_python_type {name}: {error}") from None


def reason_name(ksp):
    """Name of the reason why a solve failed, such as DIVERGED_MAX_IT."""
    reason = ksp.getConvergedReason()
    return _REASONS.get(reason, f"reason {reason}")


def _advice(ksp):
    """What the user can try when it has not converged."""
    prefix = ksp.getOptionsPrefix()
    more = f"-{prefix}ksp_monitor shows more"
    if ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
        return f"a larger -{prefix}ksp_max_it may help, {more}"
    return more


@contextmanager
def tolerances(ksp, rtol=None, atol=None):
    """Solve with other tolerances inside the block, those that are not None."""
    usual = ksp.getTolerances()
    if atol is not None and not np.isfinite(atol):
        atol = 0.0  # which PETSc takes; that the numbers are no good, the solve will find
    ksp.setTolerances(rtol=rtol, atol=atol)
    try:
        yield
    finally:
        ksp.setTolerances(rtol=usual[0], atol=usual[1])


def solve(ksp, rhs, solution, what, advice=None, inner=None):
    """Solve, from the values in `solution` unless they are no use.  Collective.

    After a long step the last state can be so many orders too large a guess that PETSc takes it
    for divergence before the first iteration; then zero is the better one.

    Parameters
    ----------
    ksp : PETSc.KSP
    rhs, solution : PETSc.Vec
    what : str
        Which solve it is, for the message.
    advice : str, optional
        What the user can try, if not more iterations or a look at the residuals.
    inner : Cholesky, optional
        The first rank's part of the preconditioner, which may be to blame.

    Returns
    -------
    int
        Iterations.

    Raises
    ------
    SolveError
        On every rank, when the solve does not converge.
    """
    if rhs.getType() == "nest":
        rhs.stateIncrease()  # set through its parts: PETSc must not take its norm for known
    ksp.solve(rhs, solution)
    diverged = ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_DTOL
    if diverged and ksp.getInitialGuessNonzero():
        solution.set(0.0)
        ksp.solve(rhs, solution)
    if ksp.getConvergedReason() < 0:
        trouble = inner and ksp.comm.tompi4py().bcast(inner.trouble)
        if trouble:
            raise SolveError(
                f"{what} solve failed: -{inner.prefix} ended with {trouble}; try another "
                f"-{inner.prefix}pc_factor_mat_solver_type"
            )
        raise SolveError(
            f"{what} solve failed: {reason_name(ksp)} after {ksp.getIterationNumber()} "
            f"iterations; {advice or _advice(ksp)}"
        )
    return ksp.getIterationNumber()
