"""The parts of the fluid's problem for the stream function: walls' forces, and net flows."""
import dense
import numpy as np
import pytest
from mpi4py import MPI

from petscib.fluid.grid import Grid
from petscib.solvers.transforms.bases import WALL_AT_POINT
from petscib.solvers.transforms.stream import FourWalls, TwoWalls, _wall_weights, net_flows

A, B = 130.0, 0.7
N, M, DY, DX = 9, 12, 0.2, 0.25


def test_weights_are_the_velocities_beside_the_walls():
    """Sum and difference of psi next to the first and the last wall, times sqrt(2 b) / h^2."""
    basis = WALL_AT_POINT
    psi = np.random.default_rng(1).standard_normal(N - 1)
    k, j = np.arange(1, N), np.arange(1, N)
    sines = np.sqrt(2 / N) * np.sin(np.pi * np.outer(k, j) / N)
    total, difference = _wall_weights(basis, N, DY, B) @ (sines @ psi)
    scale = np.sqrt(2 * B) / DY**2
    assert total == pytest.approx(scale * (psi[0] + psi[-1]) / np.sqrt(2))
    assert difference == pytest.approx(scale * (psi[0] - psi[-1]) / np.sqrt(2))


def parts():
    """Q, and R for the horizontal and for the vertical walls, of a box with four walls."""
    square = np.add.outer(WALL_AT_POINT.eigenvalues(N, DY), WALL_AT_POINT.eigenvalues(M, DX))
    return (1 / ((A + B * square) * square), _wall_weights(WALL_AT_POINT, N, DY, B),
            _wall_weights(WALL_AT_POINT, M, DX, B))


@pytest.mark.parallel([1, 3])
def test_forces_of_four_walls_are_those_of_the_dense_system():
    q, horizontal, vertical = parts()
    walls = FourWalls(lambda rows, columns: q[rows, columns], horizontal, vertical,
                      MPI.COMM_WORLD)
    rows = [np.kron(weights, np.eye(M - 1)) for weights in horizontal]
    rows += [np.kron(np.eye(N - 1), weights) for weights in vertical]
    R = np.vstack(rows)
    rhs = np.random.default_rng(2).standard_normal(len(R))
    expected = np.linalg.solve(np.eye(len(R)) + R @ (q.ravel()[:, None] * R.T), rhs)
    walls.solve(rhs)
    np.testing.assert_allclose(rhs, expected, rtol=1e-10)


def test_forces_of_two_walls_do_not_mix():
    q, horizontal, _ = parts()
    rhs = np.random.default_rng(2).standard_normal(2 * (M - 1))
    R = np.vstack([np.kron(weights, np.eye(M - 1)) for weights in horizontal])
    expected = np.linalg.solve(np.eye(len(R)) + R @ (q.ravel()[:, None] * R.T), rhs)
    TwoWalls((horizontal**2 @ q).ravel()).solve(rhs)
    np.testing.assert_allclose(rhs, expected, rtol=1e-10)


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (False, True), (True, True)])
def test_net_flows_answer_uniform_forces(periodic):
    grid = Grid((M, N), (0.0, M * DX, 0.0, N * DY), periodic=periodic)
    lines = (N, DY, M), (M, DX, N)
    for number, flow in enumerate(net_flows(grid, A, B)):
        if not periodic[number]:
            assert flow is None
            continue
        count, h, others = lines[number]
        ends = "periodic" if periodic[1 - number] else "wall between"
        table = A * np.eye(count) - B * dense.second_difference(count, h, ends)
        answer = np.linalg.solve(table, np.ones(count))
        np.testing.assert_allclose(flow, answer / np.sqrt(others * answer.sum()), rtol=1e-10)
        assert others * flow @ table @ flow == pytest.approx(1.0)


def test_nothing_holds_a_uniform_flow_without_friction():
    grid = Grid((M, N), (0.0, M * DX, 0.0, N * DY), periodic=(True, True))
    assert all(not flow.any() for flow in net_flows(grid, 0.0, B))
