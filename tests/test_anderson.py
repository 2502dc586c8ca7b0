"""Anderson acceleration of fixed-point iterations."""
import numpy as np
import pytest

from petscib.solvers.anderson import Anderson


def iterations(matrix, depth, shape=(-1,), most=400, tolerance=1e-12):
    """Passes of x = A x + b until the residual is small, and the last image."""
    rhs = np.arange(1.0, len(matrix) + 1)
    guess, acceleration = np.zeros(len(matrix)).reshape(shape), Anderson(depth)
    for passes in range(1, most + 1):
        image = (matrix @ guess.ravel() + rhs).reshape(guess.shape)
        if abs(image - guess).max() <= tolerance * abs(image).max():
            return passes, image.ravel()
        guess = acceleration.next(guess, image)
        assert guess.shape == image.shape
    return most, guess.ravel()


def contraction(size, radius):
    vectors = np.linalg.qr(np.random.default_rng(1).standard_normal((size, size)))[0]
    return vectors @ np.diag(np.linspace(-radius, radius, size)) @ vectors.T


def test_depth_zero_is_the_plain_iteration():
    acceleration = Anderson(0)
    for image in np.random.default_rng(2).standard_normal((3, 4, 2)):
        assert np.array_equal(acceleration.next(np.ones((4, 2)), image), image)


@pytest.mark.parametrize("shape", [(6,), (3, 2)])
def test_a_linear_map_is_solved_in_as_many_passes_as_it_has_unknowns(shape):
    matrix = contraction(6, 0.9)
    passes, found = iterations(matrix, 10, shape)
    expected = np.linalg.solve(np.eye(6) - matrix, np.arange(1.0, 7.0))
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    assert passes <= 9 and iterations(matrix, 0)[0] > 100


def test_what_does_not_contract_is_solved_too():
    matrix = contraction(8, 3.0)
    passes, found = iterations(matrix, 20)
    np.testing.assert_allclose(
        found, np.linalg.solve(np.eye(8) - matrix, np.arange(1.0, 9.0)), rtol=1e-8)
    assert passes <= 14


def test_older_differences_are_forgotten():
    acceleration, random = Anderson(2), np.random.default_rng(3)
    pairs = random.standard_normal((6, 2, 5))
    for guess, image in pairs:
        found = acceleration.next(guess, image)
    later = Anderson(2)
    for guess, image in pairs[3:]:
        expected = later.next(guess, image)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_ranks_without_markers_hand_their_nothing_through():
    acceleration, nothing = Anderson(3), np.zeros((0, 2))
    for _ in range(3):
        assert acceleration.next(nothing, nothing).shape == (0, 2)


def test_two_equal_passes_do_no_harm():
    """The differences vanish, and the image is the answer."""
    acceleration = Anderson(5)
    for _ in range(3):
        found = acceleration.next(np.zeros(3), np.ones(3))
    np.testing.assert_array_equal(found, np.ones(3))
