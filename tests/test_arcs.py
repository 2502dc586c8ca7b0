"""The membrane cut into arcs: every marker and row once, and the same answers on any ranks."""
import dense
import numpy as np
import pytest
import test_force
import test_stokes
from petsc4py import PETSc
from test_solvers import Case, assert_close, momentum_options

from petscib.solvers import arcs

OVERLAP = 4


@pytest.fixture
def short_arcs(monkeypatch):
    """Let small membranes be cut, and soft ones not count as stiff."""
    monkeypatch.setattr(arcs, "OVERLAP", OVERLAP)
    monkeypatch.setattr(arcs, "SHORTEST", 2 * OVERLAP)
    monkeypatch.setattr(arcs, "STIFFEST", np.inf)


@pytest.mark.parametrize("count, ranks", [(200, 1), (200, 2), (201, 3), (130, 8), (40, 4), (0, 2)])
def test_each_marker_is_in_one_share(count, ranks):
    shares = arcs.share_markers(count, ranks, whole=False)
    assert len(shares) == ranks
    own = np.concatenate([markers[mine] for markers, mine in shares])
    assert np.array_equal(np.sort(own), np.arange(count))
    used = [markers for markers, _ in shares if len(markers)]
    assert len(used) == max(1, min(ranks, count // arcs.SHORTEST)) if count else not used
    for markers in used:
        assert np.array_equal(np.diff(markers) % count, np.ones(len(markers) - 1))
        assert len(np.unique(markers)) == len(markers)
    whole = arcs.share_markers(count, ranks, whole=True)
    assert [len(markers) for markers, _ in whole] == [count] + [0] * (ranks - 1)


@pytest.mark.parametrize("sigma0, bending", [(1e5, 0.01), (1e5, 0.0), (0.0, 0.01)])
def test_each_row_is_of_one_arc_and_keeps_its_entries(short_arcs, sigma0, bending):
    problem, state = dense.problem(sigma0=sigma0, bending=bending)
    membrane = problem.membrane
    root = membrane.stiffness(membrane.tangent(state.markers)).root()
    table = dense.matrix(root)
    found = np.zeros(len(table), dtype=int)
    for markers, mine in arcs.share_markers(len(state.markers), 3, whole=False):
        rows, own, csr = arcs.take_rows(root, markers, mine)
        found[rows[own]] += 1
        columns = (2 * markers[:, None] + np.arange(2)).ravel()
        part = PETSc.Mat().createAIJ((len(rows), len(columns)), csr=csr, comm=PETSc.COMM_SELF)
        assert np.array_equal(dense.matrix(part), table[np.ix_(rows, columns)])
    assert np.array_equal(found, np.ones(len(table), dtype=int))


@pytest.mark.parallel([2, 3])
@pytest.mark.parametrize("sigma0", [1e5, 1e9])
def test_momentum_answer_is_that_of_the_dense_matrix(short_arcs, sigma0):
    case = Case(sigma0)
    with momentum_options(**test_force.TRANSFORM):
        solver = case.solver()
        solver.update(0.02, case.interpolation, case.stiffness)
        tubes = case.grid.comm.tompi4py().allgather(solver.force_solver.arcs.direct.block.size)
        assert min(tubes) > 0
        solver.solve(case.rhs, case.solution)
        solver.destroy()
    found = dense.velocity(case.grid, case.solution)
    assert_close(found, case.exact(), 1e-9 if sigma0 < 1e9 else 1e-7)


@pytest.mark.parallel([2, 3])
def test_passes_end_at_the_answer_of_the_last(short_arcs):
    test_stokes.check_passes(1e7, "extensional")


@pytest.mark.parallel([2, 3])
def test_a_stiff_membrane_stays_whole(short_arcs, monkeypatch):
    monkeypatch.setattr(arcs, "STIFFEST", 1e4)
    for sigma0, cut in ((1.0, True), (1e9, False)):
        case = Case(sigma0)
        with momentum_options(**test_force.TRANSFORM):
            solver = case.solver()
            solver.update(0.02, case.interpolation, case.stiffness)
            size = solver.force_solver.arcs.direct.block.size
            assert (size > 0) == (cut or case.grid.comm.rank == 0)
            solver.destroy()


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("scheme", ["mbe", "be", "cn", "gbe"])
def test_steps_close_the_energy_law_and_have_no_divergence(short_arcs, scheme, tmp_path):
    import runs

    simulation = runs.prepare(tmp_path, scheme=scheme, sigma0="1e9", stag_grid_x="32", fft="",
                              flow="shear", shear_rate="1", ledger="error", ledger_tol="1e-6",
                              ts_max_steps="4", ts_max_time="10")
    simulation.run()
    operators, velocity = simulation.problem.operators, simulation.state.velocity
    divergence = simulation.problem.grid.pressure_vector()
    operators.divergence.mult(velocity, divergence)
    size = [vector.norm(PETSc.NormType.INFINITY) for vector in (divergence, velocity)]
    assert size[0] * simulation.problem.grid.dx <= 1e-5 * size[1]
    simulation.destroy()
