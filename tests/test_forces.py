"""Membrane forces against the energies they come from, and the implicit part W as a matrix."""
import dense
import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from petscib.membranes import geometry, shapes
from petscib.membranes.forces import Membrane

COUNT = 12


@pytest.fixture(params=[0.0, 0.03], ids=["tension", "with bending"])
def membrane(request):
    rest = np.random.default_rng(1).uniform(0.7, 1.2, COUNT)
    return Membrane(0.21, 40.0, request.param, rest)


@pytest.fixture
def markers():
    disturbance = 0.02 * np.random.default_rng(2).standard_normal((COUNT, 2))
    return shapes.ellipse((0.3, 0.5), (0, 0), 10.0, COUNT) + disturbance


def energy(membrane, markers):
    stretch = geometry.stretching(markers, membrane.ds)
    return membrane.tension_energy(stretch) + membrane.bending_energy(markers)


def test_energies(membrane, markers):
    stretch = geometry.length(markers - np.roll(markers, 1, axis=0)) / membrane.ds
    expected = 0.5 * membrane.sigma0 * membrane.ds * sum(
        (s - r) ** 2 for s, r in zip(stretch, membrane.rest_stretch))
    assert membrane.tension_energy(stretch) == pytest.approx(expected, rel=1e-13)
    fourth = dense.fourth_difference(COUNT, membrane.ds)
    expected = 0.5 * membrane.bending * membrane.ds * markers.ravel() @ fourth @ markers.ravel()
    assert membrane.bending_energy(markers) == pytest.approx(expected, rel=1e-12, abs=0)


def test_force_is_minus_the_gradient_of_the_energy(membrane, markers):
    gradient = np.empty_like(markers)
    step = 1e-5
    for place in np.ndindex(*markers.shape):
        moved = [markers.copy(), markers.copy()]
        moved[0][place] += step
        moved[1][place] -= step
        gradient[place] = (energy(membrane, moved[0]) - energy(membrane, moved[1])) / (2 * step)
    force = membrane.force(markers, geometry.stretching(markers, membrane.ds),
                           geometry.unit_tangent(markers, membrane.ds))
    assert np.allclose(force * membrane.ds, -gradient, rtol=0, atol=1e-7 * np.abs(gradient).max())


def test_stiffness(membrane, markers):
    tangent = geometry.unit_tangent(markers, membrane.ds)
    rate = dense.surface_divergence(tangent, membrane.ds)
    expected = membrane.sigma0 * rate.T @ rate
    expected += membrane.bending * dense.fourth_difference(COUNT, membrane.ds)
    stiffness = membrane.stiffness(tangent)
    table = dense.matrix(stiffness.matrix(PETSc.COMM_SELF))
    scale = np.abs(expected).max()
    assert np.allclose(table, expected, rtol=0, atol=1e-14 * scale)
    assert np.array_equal(table, table.T)
    assert np.linalg.eigvalsh(table).min() >= -1e-13 * scale

    displacement = np.random.default_rng(3).standard_normal((COUNT, 2))
    assert np.allclose(stiffness.apply(displacement).ravel(), expected @ displacement.ravel(),
                       rtol=0, atol=1e-13 * scale)


def test_stiffness_is_how_the_force_answers_a_displacement(membrane, markers):
    """With the tangent kept, and the stretching advanced along it."""
    tangent = geometry.unit_tangent(markers, membrane.ds)
    stretch = geometry.stretching(markers, membrane.ds)
    move = np.random.default_rng(4).standard_normal((COUNT, 2))
    longer = stretch + geometry.surface_divergence(move, tangent, membrane.ds)
    change = membrane.force(markers + move, longer, tangent) - membrane.force(markers, stretch,
                                                                              tangent)
    expected = -membrane.stiffness(tangent).apply(move)
    assert np.allclose(change, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parallel([2, 3])
def test_stiffness_matrix_on_several_ranks(membrane, markers):
    tangent = geometry.unit_tangent(markers, membrane.ds)
    alone = dense.matrix(membrane.stiffness(tangent).matrix(PETSc.COMM_SELF))
    here = tangent if MPI.COMM_WORLD.rank == 0 else tangent[:0]
    together = membrane.stiffness(here).matrix(PETSc.COMM_WORLD)
    assert together.getLocalSize()[0] == 2 * len(here)
    assert np.array_equal(dense.matrix(together), alone)


@pytest.mark.parametrize("bending", [0.0, 0.03])
def test_rigid_motion_costs_nothing(markers, bending):
    membrane = Membrane(0.21, 40.0, bending, np.ones(COUNT))
    stiffness = membrane.stiffness(geometry.unit_tangent(markers, membrane.ds))
    assert np.abs(stiffness.apply(np.ones((COUNT, 2)))).max() <= 1e-9
    turned = np.column_stack((-markers[:, 1], markers[:, 0]))
    rate = geometry.surface_divergence(turned, stiffness.tangent, membrane.ds)
    assert np.abs(rate).max() <= 1e-13
