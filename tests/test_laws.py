"""Laws of membrane forces against the energies they come from; all membranes together."""
import dense
import numpy as np
import pytest

from petscib.fluid.grid import Grid
from petscib.membranes import shapes
from petscib.membranes.curves import Curves
from petscib.membranes.laws import LAWS, Bending, Contact, Load, Tension, Tether, WallContact
from petscib.membranes.membranes import Membranes

COUNTS, SPACINGS, CLOSED = (12, 16, 9), (0.2, 0.13, 0.11), (True, True, False)
GRID = Grid((30, 20), (-1.5, 1.5, -1.0, 1.0))
REACH = 0.25
every_law = pytest.mark.parametrize("name", LAWS)


def configuration():
    """Two closed curves near each other and one near walls, open."""
    random = np.random.default_rng(1)
    along = np.linspace(0.0, 1.0, 9)[:, None]
    parts = [shapes.ellipse((0.3, 0.5), (-0.5, 0.0), 10.0, 12),
             shapes.ellipse((0.35, 0.4), (0.25, 0.1), 10.0, 16), (0.6, -0.87) + along * (0.8, 0.1)]
    return np.concatenate(parts) + 0.01 * random.standard_normal((37, 2))


def lines():
    return Curves(COUNTS, SPACINGS, CLOSED)


def moved(markers, size):
    return markers + size * np.random.default_rng(2).standard_normal(markers.shape)


def make(name, curves):
    """A law whose constants are another on each curve."""
    random = np.random.default_rng(3)
    if name == "tension":
        sigma0 = np.repeat((40.0, 7.0, 25.0), (12, 16, 8))
        return Tension(curves, sigma0, random.uniform(0.7, 1.2, len(curves.edges)))
    if name == "bending":
        return Bending(curves, np.repeat((0.03, 0.1, 0.02), (12, 16, 7)))
    if name == "tether":
        stiffness = np.where(np.arange(37) % 3, 5.0 + np.arange(37), 0.0)
        return Tether(curves, stiffness, configuration() + 0.1)
    if name == "contact":
        return Contact(curves, 30.0, REACH, GRID)
    return WallContact(curves, 30.0, REACH, GRID)


def stress(law, markers, curves):
    return law.stress(markers, curves.stretching(markers), 0.0)


def rates(law, before, after):
    """C as a dense matrix."""
    table = np.zeros((len(law.columns), before.size))
    np.put_along_axis(table, law.columns, law.weights(before, after), axis=1)
    return table


def cover(law, before, after):
    if hasattr(law, "cover"):
        law.cover(before, after)


def energy(law, markers, curves):
    cover(law, markers, markers)
    return np.sum(stress(law, markers, curves) ** 2) / 2


# ---------------------------------------------------------------- every law


@every_law
def test_force_is_minus_the_gradient_of_the_energy(name):
    curves, markers, step = lines(), configuration(), 1e-5
    law = make(name, curves)
    cover(law, markers, markers)
    force = -rates(law, markers, markers).T @ stress(law, markers, curves)
    assert abs(force).max() > 1e-3 and law.name == name
    gradient = np.empty(markers.size)
    for place in range(markers.size):
        ahead, behind = markers.copy(), markers.copy()
        ahead.flat[place] += step
        behind.flat[place] -= step
        gradient[place] = (energy(law, ahead, curves) - energy(law, behind, curves)) / (2 * step)
    np.testing.assert_allclose(force, -gradient, rtol=0, atol=1e-6 * abs(gradient).max())


@every_law
@pytest.mark.parametrize("size", [0.02, 0.3])
def test_rates_are_exact_differences_between_two_configurations(name, size):
    curves, before = lines(), configuration()
    law, after = make(name, curves), moved(before, size)
    cover(law, before, after)
    found = rates(law, before, after) @ (after - before).ravel()
    expected = stress(law, after, curves) - stress(law, before, curves)
    assert abs(expected).max() > 1e-3
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * abs(expected).max())
    np.testing.assert_allclose(rates(law, after, before), rates(law, before, after), rtol=0,
                               atol=1e-13 * abs(rates(law, after, before)).max())


@every_law
def test_a_law_that_calls_itself_linear_has_one_matrix(name):
    curves, markers = lines(), configuration()
    law, other = make(name, curves), moved(markers, 0.1)
    cover(law, markers, other)
    same = np.array_equal(rates(law, markers, markers), rates(law, other, markers))
    assert same == law.linear


@every_law
def test_a_law_without_markers(name):
    nothing, curves = np.zeros((0, 2)), Curves([], [])
    if name == "tension":
        law = Tension(curves, 0.0, np.empty(0))
    elif name == "bending":
        law = Bending(curves, 0.0)
    elif name == "tether":
        law = Tether(curves, 1.0, nothing)
    else:
        law = {"contact": Contact, "wall_contact": WallContact}[name](curves, 1.0, 0.1, GRID)
        law.cover(nothing, nothing)
    assert law.stress(nothing, np.empty(0), 0.0).shape == (0,)
    assert law.columns.shape == law.weights(nothing, nothing).shape and len(law.columns) == 0


# ---------------------------------------------------------------- tension, bending


def one_closed_curve():
    markers = configuration()[12:28]
    return Curves([16], [0.13]), markers, np.random.default_rng(4).uniform(0.7, 1.2, 16)


def test_tension_is_that_of_the_paper():
    curves, markers, rest = one_closed_curve()
    law, stretch = Tension(curves, 40.0, rest), np.linspace(0.8, 1.3, 16)
    energy = law.stress(markers, stretch) @ law.stress(markers, stretch) / 2
    assert energy == pytest.approx(20 * 0.13 * np.sum((stretch - rest) ** 2), rel=1e-13)
    np.testing.assert_allclose(law.tension(stretch), 40 * (stretch - rest), rtol=1e-14)
    stress = law.stress(None, stretch)
    np.testing.assert_allclose(law.of_stress(stress), 40 * (stretch - rest), rtol=1e-13)
    slopes = dense.to_half_points(16, 0.13) @ markers
    tangent = slopes / np.hypot(*slopes.T)[:, None]
    rate = dense.surface_divergence(tangent, 0.13)
    np.testing.assert_allclose(rates(law, markers, markers), np.sqrt(40 * 0.13) * rate, rtol=0,
                               atol=1e-13 * abs(rate).max())
    # D_s (sigma tau) at the markers, times ds
    force = -rates(law, markers, markers).T @ law.stress(markers, stretch)
    pulled = 40 * (stretch - rest)[:, None] * tangent
    np.testing.assert_allclose(force.reshape(-1, 2), np.roll(pulled, -1, axis=0) - pulled, rtol=0,
                               atol=1e-13 * abs(pulled).max())
    np.testing.assert_allclose(law.stretch_rate(rates(law, markers, markers) @ np.ones(32)), 0,
                               atol=1e-13)
    motion = np.random.default_rng(5).standard_normal(32)
    np.testing.assert_allclose(law.stretch_rate(rates(law, markers, markers) @ motion),
                               rate @ motion, rtol=1e-12, atol=1e-12)


def test_stretching_of_a_curve_without_tension_is_not_followed():
    curves = Curves([8, 8], [0.1, 0.1])
    law = Tension(curves, np.repeat((2.0, 0.0), 8), np.ones(16))
    assert law.stretch_rate(np.ones(16))[8:].tolist() == [0.0] * 8
    assert (law.stretch_rate(np.ones(16))[:8] > 0).all()


def test_bending_is_that_of_the_paper():
    curves, markers, _ = one_closed_curve()
    law, fourth = Bending(curves, 0.03), dense.fourth_difference(16, 0.13)
    table = rates(law, markers, markers)
    np.testing.assert_allclose(table.T @ table, 0.03 * 0.13 * fourth, rtol=0,
                               atol=1e-13 * abs(fourth).max())
    np.testing.assert_allclose(law.stress(markers, None), table @ markers.ravel(), rtol=1e-12,
                               atol=1e-12)


@pytest.mark.parametrize("name", ["tension", "bending"])
def test_a_translation_costs_nothing(name):
    curves, markers = lines(), configuration()
    law = make(name, curves)
    table = rates(law, markers, markers)
    assert abs(table @ np.tile((1.0, -2.0), 37)).max() <= 1e-12 * abs(table).max()


def test_a_rotation_stretches_nothing():
    curves, markers = lines(), configuration()
    turned = np.stack((-markers[:, 1], markers[:, 0]), axis=1)
    table = rates(make("tension", curves), markers, markers)
    assert abs(table @ turned.ravel()).max() <= 1e-13 * abs(table).max()


@pytest.mark.parametrize("name", ["tension", "bending"])
def test_a_curve_across_a_periodic_side_is_like_any_other_straight_line(name):
    """No difference is taken across the box."""
    markers = np.outer(np.arange(10) * 0.3, (1.0, 0.0)) + (0.0, 0.5)
    curves = Curves([10], [0.3], None, [(3.0, 0.0)])
    law = Bending(curves, 0.1) if name == "bending" else Tension(curves, 2.0, np.full(10, 0.9))
    expected = 0.0 if name == "bending" else np.sqrt(2 * 0.3) * 0.1
    np.testing.assert_allclose(stress(law, markers, curves), expected, rtol=0, atol=1e-12)


# ---------------------------------------------------------------- tethers, contact


def test_tethers_hold_the_markers_they_are_given():
    curves, markers = Curves([5], [0.5]), np.random.default_rng(6).standard_normal((5, 2))
    law = Tether(curves, np.array([0.0, 2.0, 0.0, 8.0, 0.0]), lambda time: markers + (time, 0.0))
    assert law.moves and not Tether(curves, 1.0, markers).moves
    np.testing.assert_allclose(law.stress(markers, None, 3.0), [-3.0, 0.0, -6.0, 0.0], atol=1e-14)
    force = -rates(law, markers, markers).T @ law.stress(markers, None, 3.0)
    np.testing.assert_allclose(force.reshape(-1, 2), np.outer([0, 3.0, 0, 12.0, 0], (1.0, 0.0)),
                               atol=1e-14)


def pairs_in_range(markers, curves):
    """Distance and weights of all markers of different curves within the reach, one by one."""
    owner, ds = curves.owner, curves.ds
    return [(np.hypot(*(markers[i] - markers[j])), ds[i] * ds[j])
            for i in range(37) for j in range(i) if owner[i] != owner[j]
            and np.hypot(*(markers[i] - markers[j])) < REACH]


def test_contact_counts_every_pair_of_markers_once():
    curves, markers = lines(), configuration()
    pairs = pairs_in_range(markers, curves)
    assert len(pairs) >= 5
    expected = sum(30.0 / 2 * weight * (1 - d / REACH) ** 4 for d, weight in pairs)
    law = Contact(curves, 30.0, REACH, GRID)
    assert law.energy(markers) == pytest.approx(expected, rel=1e-12)
    assert energy(law, markers, curves) == pytest.approx(expected, rel=1e-12)
    # Also where they have come from far away since the list was made.
    apart = markers + np.where(curves.owner == 1, 5.0, 0.0)[:, None]
    law.cover(apart, markers)
    assert np.sum(stress(law, markers, curves) ** 2) / 2 == pytest.approx(expected, rel=1e-12)


def test_contact_sees_the_nearest_image():
    curves = Curves([8, 8], [0.2, 0.2])
    circle = shapes.ellipse((0.2, 0.2), (0.0, 0.0), 0.0, 8)
    grid = Grid((30, 20), (-1.5, 1.5, -1.0, 1.0), periodic=(True, False))
    law = Contact(curves, 30.0, REACH, grid)
    inside = law.energy(np.concatenate((circle, circle + (0.5, 0.0))))
    assert inside > 0
    for shift in (3.0, -3.0, 9.0):
        assert law.energy(np.concatenate((circle, circle + (0.5 + shift, 0.0)))) == pytest.approx(
            inside, rel=1e-9)
    walled = Contact(curves, 30.0, REACH, GRID)
    assert walled.energy(np.concatenate((circle, circle + (3.5, 0.0)))) == 0.0


def test_walls_repel_what_is_near():
    curves = Curves([3], [0.5], [False])
    markers = np.array([[-1.4, 0.0], [0.0, 0.9], [0.0, 0.0]])
    law = WallContact(curves, 30.0, REACH, GRID)
    law.cover(markers, markers)
    expected = 2 * 30.0 * REACH * 0.5 / 2 * (1 - 0.1 / REACH) ** 4
    assert law.energy(markers) == pytest.approx(expected, rel=1e-12)
    force = -(rates(law, markers, markers).T @ stress(law, markers, curves)).reshape(-1, 2)
    assert force[0, 0] > 0 and force[1, 1] < 0 and not force[2].any()
    assert force[0, 1] == force[1, 0] == 0.0
    periodic = Grid((30, 20), (-1.5, 1.5, -1.0, 1.0), periodic=(True, True))
    assert WallContact(curves, 30.0, REACH, periodic).energy(markers) == 0.0


def test_loads_are_per_parameter_length():
    curves = lines()
    density = np.random.default_rng(7).standard_normal((37, 2))
    load = Load(curves, lambda time: time * density)
    np.testing.assert_allclose(load.force(2.0), 2 * curves.ds[:, None] * density, rtol=1e-14)
    np.testing.assert_allclose(Load(curves, density).force(9.0), curves.ds[:, None] * density,
                               rtol=1e-14)


# ---------------------------------------------------------------- together


def test_membranes_put_their_laws_together():
    curves, before = lines(), configuration()
    after = moved(before, 0.05)
    laws = [make(name, curves) for name in ("contact", "tension", "bending", "tether")]
    membranes = Membranes(3, curves, laws, np.ones(36))
    table = membranes.rates(before, after).toarray()
    assert list(membranes.rows) == ["tension", "bending", "tether", "contact"]  # what varies last
    for law in laws:
        rows = membranes.rows[law.name]
        np.testing.assert_allclose(table[rows], rates(law, before, after), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(
            membranes.stress(after, curves.stretching(after))[rows], stress(law, after, curves))
    assert membranes.stress_count == len(table) and membranes.fixed == 36 + 70 + 48
    np.testing.assert_allclose(
        table @ (after - before).ravel(),
        membranes.stress(after, curves.stretching(after))
        - membranes.stress(before, curves.stretching(before)), rtol=0, atol=1e-12)
    energies = membranes.energies(after, curves.stretching(after))
    whole = membranes.by_law(membranes.stress(after, curves.stretching(after)))
    assert energies.keys() == whole.keys()
    for name, value in energies.items():
        assert value == pytest.approx(whole[name], rel=1e-12)
    assert membranes.law("bending") is laws[2] and membranes.law("wall_contact") is None
    assert membranes.act and membranes.varies and not membranes.linear and not membranes.move


def test_entries_of_the_rates_stay_where_they_are():
    """Whatever the configuration, until neighbours come and go; and no more than are needed."""
    curves, markers = lines(), configuration()
    membranes = Membranes(3, curves, [make("tension", curves), make("bending", curves)],
                          np.ones(36))
    one, other = membranes.rates(markers, markers), membranes.rates(markers, moved(markers, 0.3))
    assert one.nnz == 4 * 36 + 3 * 70 and one.has_sorted_indices
    assert np.array_equal(one.indices, other.indices) and np.array_equal(one.indptr, other.indptr)
    assert membranes.version == 0


def test_neighbours_that_come_count_as_another_version():
    curves, markers = lines(), configuration()
    apart = markers + np.where(curves.owner == 1, 5.0, 0.0)[:, None]
    membranes = Membranes(3, curves, [make("tension", curves), make("contact", curves)],
                          np.ones(36))
    membranes.cover(apart, apart)
    version, count = membranes.version, membranes.stress_count
    membranes.rates(apart, apart)
    assert membranes.version == version
    assert membranes.rates(markers, markers).shape[0] == membranes.stress_count > count
    assert membranes.version > version


def test_membranes_without_laws_only_drift():
    membranes = Membranes(3, lines(), [], np.ones(36))
    markers = configuration()
    assert not membranes.act and membranes.stress_count == 0 and membranes.linear
    assert membranes.stress(markers, np.ones(36)).shape == (0,)
    assert membranes.rates(markers, markers).shape == (0, 74)
    assert membranes.energies(markers, np.ones(36)) == {}
