"""Pictures from synthetic runs: a tank-treading ellipse, a relaxing one, and broken folders."""

import builtins
import json
import os
import subprocess
import sys

import h5py
import numpy as np
import pytest

pytest.importorskip("matplotlib")
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.image import imread  # noqa: E402

from petscib import plot  # noqa: E402
from petscib.output import histories, plots, saved, tables, views  # noqa: E402

COLUMNS = (
    "step time dt area perimeter area_error perimeter_error kinetic tension_energy bending_energy "
    "energy ledger_inertia ledger_projection ledger_viscous ledger_tension ledger_bending "
    "ledger_reset ledger_wall_power ledger_change ledger_residual max_divergence max_speed cfl "
    "inclination treading_frequency momentum_iterations poisson_iterations coupled_iterations "
    "picard_iterations wall_seconds"
).split()


def ellipse(angle, phase, markers=120, axes=(0.5, 0.15), centre=(0.0, 0.0)):
    """Outline, shape (markers, 2), of an ellipse whose markers have moved on by a phase."""
    s = 2 * np.pi * np.arange(markers) / markers + phase
    x, y = axes[0] * np.cos(s), axes[1] * np.sin(s)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([x, y]) @ turn.T + centre


def inclination_at(time):
    """From upright at rest to a steady 0.13 pi."""
    return np.pi * (0.13 + 0.37 * np.exp(-1.5 * time))


def diagnostics_row(step, dt=0.02, shear_rate=1.0):
    """A row like that of a mbe run; the ledger's terms add up exactly but for the residual."""
    time = step * dt
    noise = np.random.default_rng(step)
    decay = np.exp(-3.0 * time)
    kinetic = 0.02 * (1 - np.exp(-40 * time)) * decay
    tension, bending = 1e-4 * decay + 1e-6, 0.12 + 0.1 * decay
    energy = kinetic + tension + bending
    dissipated = 0.1 * decay * dt * 3.0
    terms = dict(inertia=-0.1, projection=-0.08, viscous=-0.7, tension=-0.07, bending=-0.1)
    ledger = {f"ledger_{name}": part * dissipated for name, part in terms.items()}
    ledger["ledger_reset"] = 0.05 * dissipated
    ledger["ledger_wall_power"] = 0.0 if shear_rate == 0 else 0.4 * shear_rate * dissipated
    ledger = {name: value if step else 0.0 for name, value in ledger.items()}
    row = {
        "step": step, "time": time, "dt": dt, "area": 0.2356 * (1 + 1e-4 * time),
        "perimeter": 2.19, "area_error": 1e-4 * time, "perimeter_error": -3e-6 * (1 - decay),
        "kinetic": kinetic, "tension_energy": tension, "bending_energy": bending,
        "energy": energy, **ledger, "ledger_change": sum(ledger.values()),
        "ledger_residual": 10 ** noise.uniform(-9, -7), "max_divergence": 1e-12, "max_speed": 1.0,
        "cfl": 0.6, "wall_seconds": 0.05 * step,
        "inclination": (inclination_at(time) + np.pi / 2) % np.pi - np.pi / 2,
        "treading_frequency": None if shear_rate == 0 else 0.4 * (1 - np.exp(-2 * time)),
    }
    if step:
        row.update(momentum_iterations=int(noise.integers(5, 8)), poisson_iterations=9)
    return row


def write_fields(path, cells=(48, 64), time=1.0, periodic=False, domain=None, vesicles=1):
    """A checkpoint file with a shear flow and a vortex where the vesicle is."""
    n, m = cells
    a, b, c, d = domain or (-1.0, 1.0, -1.0, 1.0)
    x, y = np.linspace(a, b, m + 1), np.linspace(c, d, n + 1)
    middle = lambda line: (line[1:] + line[:-1]) / 2  # noqa: E731
    bump = lambda x, y: np.exp(-8 * (x[None] ** 2 + 2 * y[:, None] ** 2))  # noqa: E731
    u = middle(y)[:, None] * (1 - 0.7 * bump(x, middle(y)))
    v = 0.5 * middle(x)[None] * bump(middle(x), y)
    options = {"shear_rate": 1.0} if domain is None else {"domain": domain}
    with h5py.File(path, "w") as file:
        file["fluid/u"] = u[:, :-1] if periodic else u
        file["fluid/v"] = v[:-1] if periodic else v
        for vesicle in range(vesicles):
            file[f"vesicle_{vesicle}/X"] = ellipse(0.4, 0.0)
            file[f"vesicle_{vesicle}/tension"] = np.sin(4 * np.pi * np.arange(120) / 120)
        file.attrs["options"] = json.dumps(options)
        file.attrs["time"] = time


def write_run(folder, steps=150, shear_rate=1.0, fields=True):
    """A finished run: tables, final.h5 and summary.json."""
    folder.mkdir(exist_ok=True)
    with tables.Table(folder / "diagnostics.csv", COLUMNS) as table:
        for step in range(steps + 1):
            table.write(diagnostics_row(step, shear_rate=shear_rate))
    with tables.Table(folder / "outlines.csv", tables.outline_columns(120)) as table:
        for step in range(0, steps + 1, 2):
            X = ellipse(inclination_at(0.02 * step), -0.02 * step * 2.2)
            table.write(tables.outline_row(step, 0.02 * step, 0, X, 120))
    if fields:
        write_fields(folder / "final.h5", time=0.02 * steps)
    (folder / "summary.json").write_text(json.dumps({"options": {"shear_rate": shear_rate}}))
    return folder


def assert_picture(path):
    """A picture of sane size that is not blank."""
    pixels = imread(path)[..., :3]
    assert min(pixels.shape[:2]) > 250 and max(pixels.shape[:2]) < 2500
    assert pixels.min() < 0.3 and pixels.max() == 1.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("runs") / "treading")


def test_all_pictures_of_a_finished_run(run, tmp_path):
    paths = plots.plot_all(run, tmp_path)
    names = ["outlines", "inclination", "conservation", "energy", "ledger", "fields", "tension"]
    assert paths == [str(tmp_path / f"{name}.png") for name in names]
    for path in paths:
        assert_picture(path)
    assert sorted(os.listdir(tmp_path)) == sorted(f"{name}.png" for name in names)
    assert not list(run.glob("*.png"))


def test_resting_fluid_has_no_inclination_picture(tmp_path):
    write_run(tmp_path, steps=20, shear_rate=0.0, fields=False)
    assert plots.plot_inclination(tmp_path) is None
    assert_picture(plots.plot_ledger(tmp_path))
    assert plots.plot_fields(tmp_path) is None


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_first_moments_of_a_run(tmp_path, rows):
    write_run(tmp_path, steps=rows - 1)
    paths = plots.plot_all(tmp_path)
    # Nothing is lost, wrong or solved in row 0: no ledger and no conservation yet.
    assert len(paths) == {0: 2, 1: 5, 2: 7}[rows]
    for path in paths:
        assert_picture(path)


def test_torn_last_lines_are_left_out(tmp_path):
    write_run(tmp_path, steps=6, fields=False)
    for name in ("diagnostics.csv", "outlines.csv"):
        with open(tmp_path / name, "a") as file:
            file.write("7,0.14,0.0")
    write_run(tmp_path / "whole", steps=6, fields=False)
    for draw in (plots.plot_outlines, plots.plot_energy):
        assert np.array_equal(imread(draw(tmp_path)), imread(draw(tmp_path / "whole")))


def test_run_without_vesicle(tmp_path):
    absent = {"area_error", "perimeter_error", "inclination", "treading_frequency", "area"}
    with tables.Table(tmp_path / "diagnostics.csv", COLUMNS) as table:
        for step in range(10):
            row = diagnostics_row(step)
            table.write({name: row[name] for name in row if name not in absent})
    tables.Table(tmp_path / "outlines.csv", tables.outline_columns(0)).close()
    write_fields(tmp_path / "final.h5", vesicles=0)
    names = [os.path.basename(path) for path in plots.plot_all(tmp_path)]
    assert names == ["conservation.png", "energy.png", "ledger.png", "fields.png"]


def test_several_vesicles_of_different_size(tmp_path):
    columns = [name for name in COLUMNS if name not in ("inclination", "area_error")]
    columns += ["inclination_0", "inclination_1", "area_error_0", "area_error_1"]
    with tables.Table(tmp_path / "diagnostics.csv", columns) as table:
        for step in range(30):
            row = diagnostics_row(step)
            angle = row.pop("inclination")
            row.update(inclination_0=angle, inclination_1=-angle)
            row.update(area_error_0=row.pop("area_error"), area_error_1=1e-3)
            table.write(row)
    with tables.Table(tmp_path / "outlines.csv", tables.outline_columns(120)) as table:
        for step in range(0, 30, 3):
            for vesicle, markers in enumerate((120, 60)):
                centre = (0.4 * (-1) ** vesicle * (1 - step / 20), 0.3 * (-1) ** vesicle)
                X = ellipse(0.3, step / 10, markers, (0.3, 0.12), centre)
                table.write(tables.outline_row(step, 0.02 * step, vesicle, X, 120))
    for draw in (plots.plot_outlines, plots.plot_inclination, plots.plot_conservation):
        assert_picture(draw(tmp_path))


def test_blown_up_run_is_still_drawn(tmp_path):
    write_run(tmp_path, steps=5, fields=False)
    with tables.Table.resume(tmp_path / "diagnostics.csv", COLUMNS, 5) as table:
        table.write({"step": 6, "time": 0.12, "energy": np.inf, "kinetic": np.nan})
    with tables.Table.resume(tmp_path / "outlines.csv", tables.outline_columns(120), 5) as table:
        table.write(tables.outline_row(6, 0.12, 0, np.full((120, 2), np.nan), 120))
    for path in plots.plot_all(tmp_path):
        assert_picture(path)


def test_newest_saved_file_is_drawn(tmp_path):
    write_fields(tmp_path / "final.h5", time=1.0)
    write_fields(tmp_path / "checkpoint-00000200.h5", time=2.0)
    os.utime(tmp_path / "final.h5", (1, 1))
    assert saved.read_fields(tmp_path).time == 2.0


def test_tension_is_that_of_the_edges_drawn(tmp_path):
    write_fields(tmp_path / "final.h5")
    fields = saved.read_fields(tmp_path)
    # Edge k of a closed outline leads from marker k on; the files have it one further.
    np.testing.assert_allclose(fields.tensions[0][:3], np.sin(4 * np.pi * np.arange(1, 4) / 120))
    assert len(fields.tensions[0]) == len(fields.outlines[0]) - 1
    with h5py.File(tmp_path / "final.h5", "a") as file:
        del file["vesicle_0/tension"]  # as in files of format 1
    assert plots.plot_tension(tmp_path) is None
    assert_picture(plots.plot_fields(tmp_path))


def test_channel_with_periodic_ends(tmp_path):
    write_fields(tmp_path / "final.h5", (24, 96), periodic=True, domain=(-2.0, 2.0, -0.5, 0.5))
    fields = saved.read_fields(tmp_path)
    assert fields.domain == (-2.0, 2.0, -0.5, 0.5)
    assert_picture(plots.plot_fields(tmp_path))
    # An outline that has left through the right side shows at the left as well.
    X = ellipse(0.0, 0.0, centre=(6.0, 0.0))
    shifts = saved.periodic_shifts(fields, X)
    assert sorted(shift[0] for shift in shifts) == [-8.0, -4.0]
    assert {shift[1] for shift in shifts} == {0.0}
    moved, = saved.newest_in_the_box(fields._replace(outlines=[X + (0.5, 0.1)]))
    np.testing.assert_allclose(moved, X + (-7.5, 0.1), atol=1e-12)
    assert_picture(plots.plot_tension(tmp_path))


def test_outlines_are_drawn_in_the_periodic_box(tmp_path):
    write_run(tmp_path, steps=20, shear_rate=0.0, fields=False)
    (tmp_path / "summary.json").write_text(json.dumps({"options": {
        "flow": "rest", "body_force": [1.0, 0.0], "periodic": "x", "domain": [9, 11, 8, 10]}}))
    options = saved.read_options(tmp_path)
    X = ellipse(0.3, 0.0, centre=(-0.1, 0.0))
    (time, ((vesicle, moved),)), = saved.in_the_box([(0.5, [(3, X)])], options)
    assert (time, vesicle) == (0.5, 3)
    np.testing.assert_allclose(moved, X + (10.0, 0.0), atol=1e-12)
    assert_picture(plots.plot_outlines(tmp_path))
    assert_picture(plots.plot_inclination(tmp_path))  # the fluid is driven


def test_sides_of_the_box_are_lines_or_dashed():
    axis = Figure().subplots()
    views._draw_sides(axis, {})
    assert not axis.lines
    views._draw_sides(axis, {"domain": [0, 4, -1, 1], "periodic": "x"})
    assert [line.get_linestyle() for line in axis.lines] == ["--", "--", "-", "-"]
    assert [tuple(line.get_xdata()) for line in axis.lines] == [(0, 0), (4, 4), (0, 4), (0, 4)]


def test_vorticity_and_centre_velocity_are_exact_for_linear_flows():
    n, m = 6, 8
    x, y = np.linspace(-1, 1, m + 1), np.linspace(0, 3, n + 1)
    u = np.broadcast_to(2.0 * (y[1:] + y[:-1])[:, None] / 2, (n, m + 1))
    v = np.broadcast_to(-0.5 * (x[1:] + x[:-1])[None] / 2, (n + 1, m))
    fields = saved.Fields(u, v, [], [], 0.0, (-1.0, 1.0, 0.0, 3.0))
    vorticity, x_lines, y_lines = saved.corner_vorticity(fields)
    np.testing.assert_allclose(vorticity, np.full((n + 1, m + 1), -2.5), atol=1e-13)
    np.testing.assert_allclose(x_lines, x, atol=1e-14)
    np.testing.assert_allclose(y_lines, y, atol=1e-14)
    centre_u, centre_v = saved.centre_velocity(u, v)
    assert centre_u.shape == centre_v.shape == (n, m)
    np.testing.assert_allclose(centre_u[:, 0], y[1:] + y[:-1])


def test_inclination_is_unwrapped():
    wrap = lambda angle: np.pi / 2 - (np.pi / 2 - angle) % np.pi  # noqa: E731
    settling = np.linspace(0.52, 0.1, 40) * np.pi
    tumbling = np.linspace(0.4, -2.3, 80) * np.pi
    for angles in (settling, tumbling):
        turns = histories._half_turns(wrap(angles)[:, None])[:, 0]
        np.testing.assert_allclose(turns, angles / np.pi, atol=1e-12)
    gap = wrap(settling)
    gap[3:6] = np.nan
    turns = histories._half_turns(gap[:, None])[:, 0]
    assert np.isnan(turns[3:6]).all() and turns[-1] == pytest.approx(0.1)


def test_animation(run, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.setattr(views, "FRAMES", 5)
    monkeypatch.setattr(plots, "plot_all", lambda folder, output: [])
    assert plot.main([str(run), "-o", str(tmp_path), "-animate"]) == 0
    with Image.open(tmp_path / "animation.gif") as image:
        assert image.n_frames == 5 and min(image.size) > 250


def test_mp4_without_ffmpeg_is_one_line(run, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(plots, "plot_all", lambda folder, output: [])
    with pytest.raises(SystemExit) as end:
        plot.main([str(run), "-o", str(tmp_path), "-animate", "-mp4"])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_pyplot_is_not_touched(run, tmp_path):
    program = (
        "import sys; from petscib.output import plots; plots.plot_energy(*sys.argv[1:]); "
        "assert 'matplotlib.pyplot' not in sys.modules; assert 'petsc4py' not in sys.modules"
    )
    command = [sys.executable, "-c", program, str(run), str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["missing"], "no such folder: missing"),
        (["."], "no data to draw"),
        ([".", "-animte"], "-animte"),
        ([], "folder"),
        ([".", "-mp4"], "-animate"),
    ],
)
def test_bad_call_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, arguments, text):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        plot.main(arguments)
    assert end.value.code == 2
    message = capsys.readouterr().err
    assert text in message and message.count("\n") == 1


@pytest.mark.parametrize("name", ["diagnostics.csv", "summary.json", "final.h5"])
def test_damaged_file_is_one_line_that_names_it(tmp_path, capsys, name):
    write_run(tmp_path, steps=3)
    if name == "diagnostics.csv":
        text = (tmp_path / name).read_text()
        (tmp_path / name).write_text(text.replace("0.04", "0.o4"))
    else:
        (tmp_path / name).write_text("rubbish")
    with pytest.raises(SystemExit) as end:
        plot.main([str(tmp_path)])
    assert end.value.code == 2
    message = capsys.readouterr().err
    assert name in message and message.count("\n") == 1


def test_without_matplotlib(run, monkeypatch, capsys):
    genuine = builtins.__import__

    def refuse(name, *rest, **more):
        if name.split(".")[0] == "matplotlib":
            raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")
        return genuine(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(ImportError):
        plots.plot_all(run)
    with pytest.raises(SystemExit) as end:
        plot.main([str(run)])
    assert end.value.code == 2
    assert capsys.readouterr().err == "petscib.plot: cannot draw, matplotlib is not installed\n"
