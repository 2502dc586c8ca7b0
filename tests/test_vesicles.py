"""Several vesicles: the same physics for each, and files, options and messages for all."""
import json
import pathlib
import shutil

import h5py
import numpy as np
import pytest
from petsc4py import PETSc
from runs import arrays, assert_same_run, comm, prepare, rows, run

from petscib import diagnostics, options, restart, vesicle_files
from petscib.driver import Driver
from petscib.errors import InputError, SolveError
from petscib.membranes import arrangement, geometry, shapes
from petscib.membranes.curves import Curves
from petscib.membranes.gaps import Gaps
from petscib.output import tables

TRUTH = pathlib.Path(__file__).with_name("two_vesicles.json")
GCN = {"scheme": "gcn", "fft": "yes", "ts_dt": "0.1"}
TWO = {"vesicles": "2", "axes": "0.15,0.25", "stag_grid_x": "32", "flow": "shear", **GCN,
       "vesicle_0_center": "-0.4,0.12", "vesicle_1_center": "0.4,-0.12"}
# Of different shape, stiffness, rest length and number of markers.
UNLIKE = {**TWO, "vesicle_1_axes": "0.25,0.2", "vesicle_1_sigma0": "50", "vesicle_1_bending": "0",
          "vesicle_1_rest_length": "0.8", "vesicle_1_markers": "60", "vesicle_0_angle": "20"}




def largest_residual(folder, prepared=None, **words):
    """Of the energy law over a few steps, with tight solvers."""
    simulation = prepare(folder, **{"ts_max_steps": "4", "ledger": "record", "ts_dt": "0.05",
                                    "picard_rtol": "1e-11", "momentum_ksp_rtol": "1e-12",
                                    "coupled_ksp_rtol": "1e-12", **words})
    if prepared is not None:
        prepared(simulation)
    simulation.run()
    simulation.destroy()
    return np.nanmax(rows(folder)["ledger_residual"])


# ---------------------------------------------------------------- physics


def test_two_vesicles_pass_as_computed_by_boundary_integrals(tmp_path):
    """To t = 2 on 48^2; the scene's own grid and end stay within 0.003 of all values."""
    truth = json.loads(TRUTH.read_text())
    run(tmp_path, scene="pair", **{**GCN, "axes": "0.15,0.25"}, stag_grid_x="48",
        ts_max_time="2", ledger="record")
    found = tables.read(tmp_path / "diagnostics.csv")
    for time in ("0.5", "1.0", "1.5", "2.0"):
        row = int(np.argmin(abs(found["time"] - float(time))))
        expected = truth[time]
        assert found["centroid_x_0"][row] == pytest.approx(expected["x1"], abs=0.006)
        assert found["centroid_y_0"][row] == pytest.approx(expected["y1"], abs=0.006)
        assert found["inclination_0"][row] / np.pi == pytest.approx(expected["theta_pi"], abs=0.01)
        assert found["min_gap"][row] == pytest.approx(expected["d"], abs=0.008)
    for axis in "xy":
        middles = found[f"centroid_{axis}_0"], found[f"centroid_{axis}_1"]
        np.testing.assert_allclose(np.add(*middles), 0, atol=1e-12)
    assert found["area_error_0"].max() < 1e-12 and found["area_error_1"].max() < 1e-12
    assert np.nanmax(found["ledger_residual"]) < 1e-9


@pytest.mark.parametrize("scheme", ["mbe", "mcn", "be", "cn", "gbe", "gcn"])
def test_the_energy_law_with_unlike_vesicles(tmp_path, scheme):
    assert largest_residual(tmp_path, **{**UNLIKE, "scheme": scheme}) < 1e-10


def test_a_far_vesicle_changes_nothing_of_the_fluid_that_it_drifts_with(tmp_path):
    """One without forces beside one with them: the latter moves as it would alone."""
    one = dict(UNLIKE, vesicle_0_sigma0="0", vesicle_0_bending="0", conserve_area="no")
    run(tmp_path / "both", **one, ts_max_steps="3")
    alone = {name.replace("vesicle_1_", ""): value for name, value in one.items()
             if not name.startswith("vesicle_0_")}
    run(tmp_path / "alone", **{**alone, "vesicles": "1"}, ts_max_steps="3")
    both, alone = (arrays(tmp_path / name / "final.h5") for name in ("both", "alone"))
    np.testing.assert_allclose(both["vesicle_1/X"], alone["vesicle_0/X"], atol=1e-8)
    np.testing.assert_allclose(both["fluid/u"], alone["fluid/u"], atol=1e-7)


def test_shifted_by_whole_cells_in_a_periodic_box(tmp_path):
    """The answer does not depend on where the origin is put."""
    box = {**UNLIKE, "periodic": "x", "stag_grid_x": "32"}
    run(tmp_path / "here", **box, ts_max_steps="4")
    shifted = {**box, "vesicle_0_center": "0.35,0.12", "vesicle_1_center": "1.15,-0.12"}
    run(tmp_path / "there", **shifted, ts_max_steps="4")
    here, there = (arrays(tmp_path / name / "final.h5") for name in ("here", "there"))
    for k in range(2):
        np.testing.assert_allclose(there[f"vesicle_{k}/X"] - (0.75, 0), here[f"vesicle_{k}/X"],
                                   atol=1e-8)
    np.testing.assert_allclose(np.roll(here["fluid/u"], 12, axis=1), there["fluid/u"], atol=1e-7)


def test_membranes_that_cross_end_the_run(tmp_path):
    """Driven onto each other in steps too long to see it coming."""
    words = {**TWO, "flow": "rest", "stag_grid_x": "24", "axes": "0.2,0.2", "scheme": "mbe",
             "vesicle_0_center": "-0.3,0", "vesicle_1_center": "0.3,0",
             "vesicle_0_load": "40,0", "vesicle_1_load": "-40,0"}
    simulation = prepare(tmp_path, **words, ts_max_steps="12")
    try:
        with pytest.raises(SolveError, match="vesicles 0 and 1 have crossed; .*-contact.*"
                                             "; the state before it is in "):
            simulation.run()
    finally:
        simulation.destroy()
    assert min(tables.read(tmp_path / "diagnostics.csv")["min_gap"]) > 0


@pytest.mark.parametrize("half, cells", [("0.22", 0.64), ("0.24", None)])
def test_a_narrow_gap_is_a_warning(tmp_path, half, cells):
    words = {**TWO, "axes": "0.2,0.2", "vesicle_0_center": f"-{half},0", "flow": "rest",
             "vesicle_1_center": f"{half},0"}
    simulation = prepare(tmp_path, **words, ts_max_steps="1")
    said = []
    simulation.results.say = said.append
    simulation.run()
    simulation.destroy()
    warnings = [line for line in said if "cells apart; below 1 " in line]
    assert len(warnings) == (cells is not None)
    assert cells is None or f"vesicles 0 and 1 are {cells:.2g} cells apart" in warnings[0]


@pytest.mark.parametrize("flow, words, expected", [
    ("shear", {}, 1.0), ("shear", {"mu": "2.5", "shear_rate": "-0.5"}, 2.5)])
@pytest.mark.parallel([1, 3])
def test_effective_viscosity_without_vesicles_is_the_fluid_s(tmp_path, flow, words, expected):
    run(tmp_path, scene="driven", axes="0.1,0.1", vesicles="1", sigma0="0", bending="0", flow=flow,
        periodic="x", ts_max_steps="2", **words)
    if comm.rank == 0:
        found = rows(tmp_path)["effective_viscosity"]
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_effective_viscosity_is_that_of_the_dissipation(tmp_path):
    """In the mean over a steady state: the walls' power is what is dissipated."""
    run(tmp_path, **{**GCN, "scheme": "gcn"}, periodic="x", vesicles="1", axes="0.25,0.4",
        stag_grid_x="32", ts_max_time="4", ledger="record", rho="0.1")
    found = rows(tmp_path)
    power = found["ledger_wall_power"][-1] / found["dt"][-1]
    assert 1.02 < found["effective_viscosity"][-1] < 1.5
    assert found["effective_viscosity"][-1] == pytest.approx(power / 4, rel=0.02)


# ---------------------------------------------------------------- files


@pytest.mark.parallel([1, 2])
def test_restarted_equals_uninterrupted(tmp_path):
    run(tmp_path / "whole", **UNLIKE, ts_max_steps="6")
    run(tmp_path / "parts", **UNLIKE, ts_max_steps="3")
    run(tmp_path / "parts", restart=str(tmp_path / "parts/final.h5"), ts_max_steps="6")
    if comm.rank == 0:
        assert_same_run(tmp_path / "whole", tmp_path / "parts")
        outlines = tables.read_outlines(tmp_path / "whole/outlines.csv")
        assert [(step, k, len(X)) for step, _, k, X in outlines[-2:]] == [
            (6, k, len(arrays(tmp_path / "whole/final.h5")[f"vesicle_{k}/X"])) for k in (0, 1)]
        assert outlines[-1][3].shape == (60, 2)


@pytest.mark.parallel([2, 3])
def test_ranks_agree(tmp_path):
    words = {**UNLIKE, "stag_grid_y": "29", "ts_max_steps": "3"}
    run(tmp_path / "together", **words)
    if comm.rank == 0:
        run(tmp_path / "alone", PETSc.COMM_SELF, **words)
        assert_same_run(tmp_path / "alone", tmp_path / "together", 1e-8)


def test_columns():
    assert "area" in diagnostics.columns(0) and "area_0" not in diagnostics.columns(1)
    names = diagnostics.columns(3)
    for name in ("area", "perimeter", "area_error", "perimeter_error", "inclination",
                 "treading_frequency", "centroid_x", "centroid_y"):
        assert name not in names and {f"{name}_{k}" for k in range(3)} <= set(names)
    assert set(diagnostics.columns(1)) - set(names) == {
        name.removesuffix("_0") for name in names if name.endswith("_0")}


def test_each_vesicle_is_measured_by_itself(tmp_path):
    simulation = prepare(tmp_path, **UNLIKE)
    row = simulation.diagnostics.row(simulation.state)
    curves, markers = simulation.problem.curves, simulation.state.markers
    for k, part in enumerate(curves.parts(markers)):
        assert row[f"area_{k}"] == pytest.approx(geometry.area(part), rel=1e-12)
        assert row[f"perimeter_{k}"] == pytest.approx(geometry.perimeter(part), rel=1e-12)
        assert row[f"inclination_{k}"] == pytest.approx(geometry.inclination(part), rel=1e-10)
        assert (row[f"centroid_x_{k}"], row[f"centroid_y_{k}"]) == pytest.approx(
            tuple(geometry.centroid(part)), abs=1e-12)
        local = part - part.mean(axis=0)
        velocity = np.column_stack((-local[:, 1], local[:, 0])) * (k + 0.5)
        other = np.zeros_like(markers)
        other[curves.starts[k] : curves.starts[k + 1]] = velocity
        assert geometry.treading_frequency(markers, other, curves)[k] == pytest.approx(
            geometry.treading_frequency(part, velocity), rel=1e-12)


def test_a_checkpoint_of_version_1_is_continued(tmp_path):
    words = dict(GCN, stag_grid_x="24", ts_max_steps="2")
    run(tmp_path / "new", **words)
    shutil.copytree(tmp_path / "new", tmp_path / "old")
    with h5py.File(tmp_path / "old/final.h5", "a") as file:
        file.attrs["format_version"] = 1
        for name in ("closed", "period"):
            del file["vesicle_0"].attrs[name]
        saved = json.loads(file.attrs["options"])
        for name in ("vesicle_file", "arrangement", "seed", "area_fraction", "shape", "amplitude",
                     "tether", "load", "contact", "contact_range"):
            del saved[name]
        file.attrs["options"] = json.dumps(saved)
    for name in ("new", "old"):
        run(tmp_path / name, restart=str(tmp_path / name / "final.h5"), ts_max_steps="4")
    assert_same_run(tmp_path / "new", tmp_path / "old")


def test_fields_for_paraview(tmp_path):
    run(tmp_path, **UNLIKE, ts_max_steps="1", xdmf_every="1")
    with h5py.File(tmp_path / "fields-00000001.h5", "r") as frame:
        for k in range(2):
            X = arrays(tmp_path / "final.h5")[f"vesicle_{k}/X"]
            np.testing.assert_allclose(frame[f"vesicle_{k}/X"][...], X, atol=1e-6)
            edges = frame[f"vesicle_{k}/edges"][...]
            assert sorted(edges[:, 1]) == list(range(len(X)))
            assert ((edges[:, 0] + 1) % len(X) == edges[:, 1]).all()
        assert (frame["vesicle_1/stretch"][...] != 0).all()
    index = (tmp_path / "vesicles.xdmf").read_text()
    assert index.count("Spatial") == index.count("<Time") == 2
    assert index.count("/vesicle_1/X") == index.count("/vesicle_0/X") == 2


def test_options_of_hundreds_of_vesicles_fit_in_a_checkpoint(tmp_path):
    words = {f"vesicle_{k}_{name}": value for k in range(400)
             for name, value in (("bending", "0.012345678901"), ("sigma0", "123456.78901"),
                                 ("angle", "12.345678901"))}
    simulation = prepare(tmp_path, vesicles="400", arrangement="lattice", axes="0.01,0.01",
                         stag_grid_x="256", **words)
    simulation.diagnostics.row(simulation.state)
    path = simulation._save("one.h5")
    again = options.read(restart.merge({"restart": path, "ts_max_steps": "2"}, comm))
    assert again.vesicle(399).sigma0 == 123456.78901
    simulation.destroy()


# ---------------------------------------------------------------- options


def test_what_is_not_given_for_one_is_the_common_value():
    settings = options.read({**UNLIKE, "bending": "0.5"})
    one, other = settings.each_vesicle()
    assert (one.axes, other.axes) == ((0.15, 0.25), (0.25, 0.2))
    assert (one.bending, other.bending) == (0.5, 0.0)
    assert (one.sigma0, other.sigma0) == (1e5, 50.0)
    assert one.option("center") == "vesicle_0_center" and one.option("sigma0") == "sigma0"
    again = options.read({name: value for name, value in restart.given_text(
        settings.to_dict()).items()})
    assert again.each_vesicle() == settings.each_vesicle()


@pytest.mark.parametrize("words, fragments", [
    (dict(vesicles="2"), ["vesicle 1 meets vesicle 0", "-vesicle_1_center"]),
    (dict(vesicles="2", vesicle_1_axes="0.02,0.03", markers="60", axes="0.4,0.4"),
     ["vesicle 1 meets vesicle 0"]),
    (dict(vesicles="2", vesicle_1_axs="1"), ["-vesicle_1_axs 1: unknown", "-vesicle_1_axes"]),
    (dict(vesicles="2", vesicle_1_axes="1"), ["-vesicle_1_axes 1: not 2 values", "rx,ry"]),
    (dict(vesicles="2", vesicle_2_axes="0.1,0.1"),
     ["-vesicle_2_axes 0.1,0.1: the last of 2 vesicles is number 1", "more -vesicles"]),
    (dict(vesicles="0", vesicle_0_angle="3"), ["-vesicle_0_angle 3: there is no vesicle"]),
    (dict(vesicle_0_center="0.9,0"), ["-vesicle_0_center 0.9,0: the vesicle comes within",
                                      "at least"]),
    (dict(vesicles="1", vesicle_0_markers="7"), ["-vesicle_0_markers 7: 7 markers"]),
    (dict(vesicle_0_rest_length="0.5", vesicle_0_sigma0="0"), ["-vesicle_0_rest_length 0.5: has"]),
    (dict(vesicle_0_marker_file="nowhere"), ["-vesicle_0_marker_file nowhere: no such file"]),
    (dict(arrangement="random", center="0,0"), ["-center 0,0: -arrangement random gives"]),
    (dict(arrangement="random", angle="3"), ["-angle 3: -arrangement random gives the angles"]),
    (dict(arrangement="lattice", vesicle_0_center="0,0"), ["-vesicle_0_center 0,0: "]),
    (dict(arrangement="lattice", vesicles="300"), ["no room for 300 vesicles", "smaller -axes"]),
    (dict(arrangement="random", area_fraction="0.9"), ["no place was found for more than"]),
    (dict(arrangement="lattice", area_fraction="0.2", axes="0.1,0.1", vesicles="9"),
     ["-area_fraction 0.2: -vesicles and -axes say it already"]),
    (dict(arrangement="lattice", area_fraction="0.2", vesicle_0_axes="0.1,0.1"),
     ["-area_fraction 0.2: the vesicles have axes of their own", "-vesicle_0_axes"]),
    (dict(arrangement="lattice", shape="line", periodic="x"), ["only ellipses are arranged"]),
    (dict(seed="3"), ["-seed 3: there is no arrangement"]),
    (dict(shape="line"), ["-shape line: a line goes across a periodic box", "-periodic x"]),
    (dict(shape="line", periodic="x", axes="0.1,0.1"), ["-axes 0.1,0.1: a line goes straight"]),
    (dict(amplitude="0.1"), ["-amplitude 0.1: only a line has one"]),
    (dict(shape="line", periodic="x", amplitude="0.95"), ["-amplitude 0.95: the vesicle comes"]),
])
def test_what_cannot_be_is_refused(tmp_path, words, fragments):
    given = {"stag_grid_x": "32", "axes": "0.1,0.2", **words}
    if "shape" in words and "axes" not in words:
        del given["axes"]
    with pytest.raises(InputError) as caught:
        Driver(options.read({**given, "output": str(tmp_path / "out")}))
    message = str(caught.value)
    assert "allowed: " in message or "unknown" in message
    for fragment in fragments:
        assert fragment in message, message


@pytest.mark.parametrize("name, value, saved", [
    ("vesicle_1_axes", "0.3,0.1", "0.25,0.2"), ("vesicle_0_center", "0,0", "-0.4,0.12"),
    ("vesicle_0_axes", "0.3,0.1", "0.15,0.25"), ("arrangement", "lattice", "none")])
def test_a_restart_cannot_change_shapes(tmp_path, name, value, saved):
    if not (tmp_path.parent / "pair").exists():
        run(tmp_path.parent / "pair", **UNLIKE, ts_max_steps="1")
    path = str(tmp_path.parent / "pair/final.h5")
    with pytest.raises(InputError, match=f"-{name} .* cannot change it, .*with {saved};"):
        prepare(tmp_path, restart=path, **{name: value})


def test_a_restart_may_change_the_membrane_of_one(tmp_path):
    run(tmp_path, **UNLIKE, ts_max_steps="1")
    simulation = prepare(tmp_path, restart=str(tmp_path / "final.h5"), vesicle_1_sigma0="70",
                         ts_max_steps="2")
    assert simulation.settings.vesicle(1).sigma0 == 70
    tension = simulation.problem.membranes.law("tension")
    assert {part[0] for part in simulation.problem.curves.edge_parts(tension.sigma0)} == {1e5, 70}
    simulation.destroy()


# ---------------------------------------------------------------- lists and arrangements


def test_a_list_of_vesicles(tmp_path):
    path = tmp_path / "list.txt"
    path.write_text("# three\n\naxes=0.2,0.1 center=-0.5,0.1\n  CENTER=0.5,-0.1 angle=30 # x\n"
                    "center=0,0.6 sigma0=1e3\n")
    found = options.read(vesicle_files.expand(
        {"vesicle_file": str(path), "axes": "0.1,0.2", "vesicle_2_center": "0,0.5"}, comm))
    assert found.vesicles == 3
    assert [one.axes for one in found.each_vesicle()] == [(0.2, 0.1), (0.1, 0.2), (0.1, 0.2)]
    assert [one.center for one in found.each_vesicle()] == [(-0.5, 0.1), (0.5, -0.1), (0.0, 0.5)]
    assert found.vesicle(1).angle == 30 and found.vesicle(2).sigma0 == 1e3


@pytest.mark.parametrize("text, words, fragments", [
    ("center=0,0\naxs=1,2\n", {}, ["line 2: axs=1,2: not a value of a vesicle", "nearest: axes"]),
    ("axes=1\n", {}, ["line 1: -axes 1: not 2 values"]),
    ("\n# none\n", {}, ["lists no vesicle"]),
    ("center 0,0\n", {}, ["line 1: center: needs a value"]),
    ("center=0,0\n", {"vesicles": "2"}, ["-vesicles 2: ", "lists 1"]),
    (None, {}, ["No such file"]),
])
@pytest.mark.parallel([1, 2])
def test_a_wrong_list(tmp_path, text, words, fragments):
    path = tmp_path / "list.txt"
    if comm.rank == 0 and text is not None:
        path.write_text(text)
    with pytest.raises(InputError) as caught:
        vesicle_files.expand({"vesicle_file": str(path), **words}, comm)
    assert "allowed: " in str(caught.value)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_a_list_is_not_read_again_at_a_restart(tmp_path):
    path = tmp_path / "list.txt"
    path.write_text("center=-0.4,0\ncenter=0.4,0 axes=0.1,0.2\n")
    words = {"vesicle_file": str(path), "axes": "0.2,0.2", "output": str(tmp_path / "out"),
             "stag_grid_x": "24", "monitor": "none", "plot": "no", **GCN}
    expanded = vesicle_files.expand(words, comm)
    run(tmp_path / "out", **{**expanded, "ts_max_steps": "1"})
    path.unlink()
    again = vesicle_files.expand(restart.merge(
        {"restart": str(tmp_path / "out/final.h5"), "ts_max_steps": "2"}, comm), comm)
    assert options.read(again).vesicle(1).axes == (0.1, 0.2)


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("kind", ["random", "lattice"])
def test_arranged_ellipses_keep_apart(kind, periodic):
    domain, gap, margin = (-1.0, 2.0, -1.0, 1.0), 0.06, (0.1, 0.08)
    box = arrangement.Box(domain, periodic, gap, margin)
    axes = [(0.08, 0.2), (0.15, 0.1)] * 7
    given = [30.0 * k for k in range(14)]
    place = {"random": lambda: arrangement.random(box, axes, 5),
             "lattice": lambda: arrangement.lattice(box, axes, given)}[kind]
    centers, angles = place()
    assert kind == "random" or list(angles) == given
    parts = [shapes.ellipse(*one, 60) for one in zip(axes, centers, angles)]
    for axis, (low, high) in enumerate(((-1, 2), (-1, 1))):
        if not periodic[axis]:
            everything = np.concatenate(parts)[:, axis]
            assert everything.min() >= low + margin[axis] - 1e-3
            assert everything.max() <= high - margin[axis] + 1e-3
    grid = type("Grid", (), {"domain": domain, "periodic": periodic})
    found = Gaps(Curves([60] * 14, [0.02] * 14), grid).measure(np.concatenate(parts))
    assert found.crossed is None and found.between >= 0.9 * gap
    np.testing.assert_array_equal(place()[0], centers)
    if kind == "random":
        assert not np.allclose(arrangement.random(box, axes, 6)[0], centers)


def test_area_fraction_sets_number_or_size():
    common = {"arrangement": "lattice", "area_fraction": "0.2", "domain": "0,4,0,1"}
    count = options.read({**common, "axes": "0.1,0.15"})
    assert count.vesicles == round(0.2 * 4 / (np.pi * 0.1 * 0.15)) and count.axes == (0.1, 0.15)
    size = options.read({**common, "vesicles": "10"})
    assert size.vesicles * np.pi * np.prod(size.axes) == pytest.approx(0.8)
    assert size.axes[1] / size.axes[0] == pytest.approx(5)
