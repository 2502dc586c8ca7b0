"""Functions and points of a script's, and the body force made of them."""
import dense
import numpy as np
import pytest

from petscib.errors import InputError
from petscib.fluid.body_force import BodyForce
from petscib.fluid.grid import Grid
from petscib.fluid.operators import Operators
from petscib.fluid.sides import Sides
from petscib.own import Function, Points, is_own


def swirl(x, y, t):
    return -t * y, 2.0


def test_a_function_is_asked_at_all_places_and_gives_two_arrays():
    function = Function(swirl, "flow")
    x, y = np.linspace(0, 1, 4), np.linspace(2, 3, 3)[:, None]
    u, v = function(x, y, 0.5)
    np.testing.assert_array_equal(u, np.broadcast_to(-0.5 * y, (3, 4)))
    np.testing.assert_array_equal(v, np.full((3, 4), 2.0))
    u[0, 0] = 7.0  # both are new
    assert function(x, y, 0.5)[0][0, 0] == -1.0
    assert str(function) == "function swirl" and is_own(function)
    assert function == Function(swirl, "body_force") != Function(print, "flow")
    assert hash(function) == hash(Function(swirl, "flow"))


@pytest.mark.parametrize("call, why", [
    (lambda x, y, t: x, "returns no two arrays"),
    (lambda x, y, t: (x[:-1], y), "returns no two arrays"),
    (lambda x, y, t: (x, "much"), "returns no two arrays"),
    (lambda x, y, t: None, "returns no two arrays"),
    (lambda x, y, t: (x, np.inf), "is not finite everywhere")])
def test_a_function_that_does_not_serve_is_refused(call, why):
    with pytest.raises(InputError, match=f"-flow function <lambda>: {why}.*; allowed: "):
        Function(call, "flow")(np.arange(3.0), np.arange(3.0), 0.0)


@pytest.mark.parametrize("call, why", [
    (lambda x, y: (x, y), r"TypeError: .*<lambda>\(\) takes 2 positional arguments but 3 were"),
    (lambda x, y, t: 1 / 0, r"ZeroDivisionError: division by zero \(test_own.py, line \d+\)")])
def test_what_a_function_raises_is_bad_input_at_the_start(call, why):
    with pytest.raises(InputError, match=f"-flow function <lambda>: {why}"):
        Function(call, "flow").tried(np.arange(3.0), np.arange(3.0), 0.0)
    with pytest.raises(Exception, match=why.partition(": ")[2].partition(r" \(test")[0]) as caught:
        Function(call, "flow")(np.arange(3.0), np.arange(3.0), 0.0)
    assert not isinstance(caught.value, InputError)


def test_points_are_equal_by_what_they_are():
    points = Points([[0, 1], [2, 3]])
    assert points == Points(np.array([[0.0, 1.0], [2.0, 3.0]])) != Points([[0, 1], [2, 4]])
    assert hash(points) == hash(Points([[0, 1], [2, 3]])) and str(points) == "array(2,2)"
    assert is_own(points) and not is_own("0,1")


@pytest.mark.parallel([1, 3])
def test_a_body_force_is_on_all_faces_but_those_of_walls():
    grid = Grid((9, 8), (-1.0, 2.0, 0.0, 1.0))
    operators, inner = Operators(grid, Sides(grid)), dense.inner_faces(grid)
    count = grid.u_index.size
    along = np.arange(len(inner)) < count
    uniform = BodyForce(operators, (2.0, -3.0))
    assert uniform.at(0.0) is uniform.at(1.0)
    np.testing.assert_array_equal(dense.velocity(grid, uniform.at(0.0)),
                                  np.where(along, 2.0, -3.0) * inner)
    moving = BodyForce(operators, Function(lambda x, y, t: (t * x * y, t + x - y), "body_force"))
    for time in (0.5, 2.0):
        (x, y), (x_v, y_v) = grid.u_points(), grid.v_points()
        expected = np.concatenate(((time * x * y).ravel(), (time + x_v - y_v).ravel())) * inner
        np.testing.assert_allclose(dense.velocity(grid, moving.at(time)), expected, atol=1e-14)
        assert moving.at(time) is moving.at(time)
