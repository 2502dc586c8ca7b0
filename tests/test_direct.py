"""The direct solvers offered are there, by the names that this PETSc, or another, has for them."""
import numpy as np
import pytest
from petsc4py import PETSc
from runs import comm

from petscib.errors import InputError
from petscib.solvers import direct


def solve(package, kind, on):
    """Largest error of a solve with a second difference of 40 points."""
    matrix = PETSc.Mat().createAIJ((40, 40), nnz=3, comm=on)
    first, last = matrix.getOwnershipRange()
    for row in range(first, last):
        columns = [column for column in (row - 1, row, row + 1) if 0 <= column < 40]
        matrix.setValues(row, columns, [2.0 if column == row else -1.0 for column in columns])
    matrix.assemble()
    pc = PETSc.PC().create(on)
    pc.setOperators(matrix)
    pc.setType(kind)
    pc.setFactorSolverType(package)
    x, b = matrix.createVecs()
    x.setArray(np.arange(first, last, dtype=float))
    exact = x.getArray().copy()
    matrix.mult(x, b)
    pc.apply(b, x)
    return abs(x.getArray() - exact).max(initial=0.0)


@pytest.mark.parametrize("kind", ["cholesky", "lu"])
def test_serial(kind):
    assert solve(direct.serial(kind), kind, PETSc.COMM_SELF) < 1e-11


@pytest.mark.parallel(2)
@pytest.mark.parametrize("kind", ["cholesky", "lu"])
def test_parallel(kind):
    try:
        package = direct.parallel()
    except InputError as error:
        pytest.skip(str(error))
    assert comm.allreduce(solve(package, kind, PETSc.COMM_WORLD)) < 1e-11


@pytest.mark.parametrize("packages, cholesky, lu, parallel", [
    ({"suitesparse", "mumps", "superlu_dist"}, "cholmod", "umfpack", "mumps"),
    ({"cholmod", "umfpack", "superlu_dist"}, "cholmod", "umfpack", "superlu_dist"),
    ({"cholmod", "mumps"}, "cholmod", "petsc", "mumps"),
    ({"mumps"}, "petsc", "petsc", "mumps"),
])
def test_names(monkeypatch, packages, cholesky, lu, parallel):
    monkeypatch.setattr(direct, "_has", packages.__contains__)
    assert (direct.serial("cholesky"), direct.serial("lu")) == (cholesky, lu)
    assert direct.parallel() == parallel


def test_none_for_several_ranks(monkeypatch):
    monkeypatch.setattr(direct, "_has", lambda package: False)
    assert direct.serial("cholesky") == direct.serial("lu") == "petsc"
    with pytest.raises(InputError, match="neither MUMPS nor SuperLU_DIST"):
        direct.parallel()
