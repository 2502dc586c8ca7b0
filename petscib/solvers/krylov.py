"""Krylov solvers by option prefix, with defaults that the user's options override."""

import importlib
from contextlib import contextmanager

from petsc4py import PETSc

from ..errors import InputError, SolveError

_REASONS = {
    value: name
    for name, value in vars(PETSc.KSP.ConvergedReason).items()
    if isinstance(value, int) and name.startswith("DIVERGED")
}
_entered = []  # full names of the defaults that are in PETSc's database


class Operator:
    """A square PETSc matrix that acts as whatever object it is told to.

    One matrix serves a whole run, because preconditioners keep a reference to it.

    Parameters
    ----------
    vector : PETSc.Vec
        Any vector of its layout.
    """

    def __init__(self, vector):
        self.action = None
        sizes = (vector.getSizes(),) * 2
        self.matrix = PETSc.Mat().createPython(sizes, _Action(self), comm=vector.comm)
        self.matrix.setUp()

    def act_as(self, action):
        """Let `action.mult(x, y)` be the product from now on."""
        self.action = action
        self.matrix.assemble()  # tells PETSc that it changed

    def destroy(self):
        """Free the matrix.  Collective."""
        self.matrix.destroy()


class _Action:
    """What PETSc calls."""

    def __init__(self, operator):
        self.operator = operator

    def mult(self, matrix, x, y):
        self.operator.action.mult(x, y)


def set_defaults(prefix, defaults):
    """Enter options under `prefix` unless the user has given them.

    They stay in PETSc's database, because inner solvers read theirs late.
    """
    options = PETSc.Options(prefix)
    for name, value in defaults.items():
        if not options.hasName(name):
            options[name] = value
            _entered.append(prefix + name)


def withdraw_defaults():
    """Take all defaults out of PETSc's database again, for the next run in this process."""
    while _entered:
        PETSc.Options().delValue(_entered.pop())


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


def has_exact_preconditioner(ksp):
    """Whether the preconditioner is one of ours that inverts its matrix."""
    pc = ksp.getPC()
    return pc.getType() == "python" and getattr(pc.getPythonContext(), "exact", False)


def reason_name(ksp):
    """Name of the reason why a solve failed, such as DIVERGED_MAX_IT."""
    reason = ksp.getConvergedReason()
    return _REASONS.get(reason, f"reason {reason}")


def advice(ksp):
    """What the user can try when it has not converged."""
    prefix = ksp.getOptionsPrefix()
    return f"a larger -{prefix}ksp_max_it may help, -{prefix}ksp_monitor shows more"


@contextmanager
def tolerances(ksp, rtol, atol):
    """Solve with other tolerances inside the block.  Not collective."""
    usual = ksp.getTolerances()
    ksp.setTolerances(rtol=rtol, atol=atol)
    try:
        yield
    finally:
        ksp.setTolerances(rtol=usual[0], atol=usual[1])


def solve(ksp, rhs, solution, what, advice):
    """Solve, from the values in `solution` unless they are no use.  Collective.

    After a long step the last state can be so many orders too large a guess that PETSc takes it
    for divergence before the first iteration; then zero is the better one.

    Parameters
    ----------
    ksp : PETSc.KSP
    rhs, solution : PETSc.Vec
    what : str
        Which solve it is, for the message.
    advice : str
        What the user can try.

    Returns
    -------
    int
        Iterations.

    Raises
    ------
    SolveError
        On every rank, when the solve does not converge.
    """
    ksp.solve(rhs, solution)
    diverged = ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_DTOL
    if diverged and ksp.getInitialGuessNonzero():
        solution.set(0.0)
        ksp.solve(rhs, solution)
    if ksp.getConvergedReason() < 0:
        raise SolveError(
            f"{what} solve failed: {reason_name(ksp)} after {ksp.getIterationNumber()} "
            f"iterations; {advice}"
        )
    return ksp.getIterationNumber()
