"""Checkpoint files: content, the same file however it is written, and damaged ones."""
import json
import os
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from conftest import mpi_environment
from runs import arrays, comm, prepare, run

from petscib.errors import InputError, OutputError
from petscib.output import checkpoint, files


def contents(path):
    """Every dataset and attribute of a file."""
    found = arrays(path)
    with h5py.File(path, "r") as file:
        for name in ("/", "fluid", "vesicle_0", "fluid/u", "vesicle_0/X"):
            found.update({f"{name}@{key}": value for key, value in file[name].attrs.items()})
    return found


@pytest.mark.parallel([1, 3])
def test_through_rank_0_gives_the_same_file(tmp_path, monkeypatch):
    simulation = prepare(tmp_path / "run", stag_grid_y="30")
    simulation.diagnostics.row(simulation.state)
    path = simulation._save("one.h5")
    monkeypatch.setattr(simulation, "_wall_seconds", lambda: simulation.progress.wall_seconds)
    monkeypatch.setattr(h5py, "get_config", lambda: type("Config", (), {"mpi": False}))
    other = simulation._save("other.h5")
    comm.Barrier()
    first, second = contents(path), contents(other)
    assert first.keys() == second.keys()
    for name, value in first.items():
        np.testing.assert_array_equal(second[name], value, err_msg=name)
        assert np.asarray(second[name]).dtype == np.asarray(value).dtype


@pytest.mark.parallel([1, 3])
def test_layout_and_natural_order(tmp_path):
    simulation = prepare(tmp_path / "run", ts_max_steps="2", stag_grid_y="30",
                         domain="-1,1,-1,1.5")
    grid, state = simulation.problem.grid, simulation.state
    x, y = grid.u_points(grid.u_box)
    u = 100 * x + y
    x, y = grid.v_points(grid.v_box)
    grid.set_velocity(state.velocity, u, 100 * x - y)
    x, y = grid.p_points(grid.p_box)
    grid.set_pressure(state.pressure, x + 100 * y)
    simulation.diagnostics.row(state)
    path = simulation._save("here.h5")
    found = arrays(path)
    dx, dy = 2 / 24, 2.5 / 30
    faces_x, faces_y = -1 + dx * np.arange(25), -1 + dy * np.arange(31)
    middle_x, middle_y = (faces_x[1:] + faces_x[:-1]) / 2, (faces_y[1:] + faces_y[:-1]) / 2
    np.testing.assert_allclose(found["fluid/u"], 100 * faces_x + middle_y[:, None], atol=1e-12)
    np.testing.assert_allclose(found["fluid/v"], 100 * middle_x - faces_y[:, None], atol=1e-12)
    np.testing.assert_allclose(found["fluid/p"], middle_x + 100 * middle_y[:, None], atol=1e-12)
    count = comm.bcast(len(state.markers))
    assert found["vesicle_0/X"].shape == (count, 2)
    assert found["vesicle_0/stretch"].shape == found["vesicle_0/rest_stretch"].shape == (count,)
    assert {values.dtype for values in found.values()} == {np.dtype("f8")}
    with h5py.File(path, "r") as file:
        assert file.attrs["format_version"] == 2 and file.attrs["scheme"] == "gcn"
        assert json.loads(file.attrs["options"])["stag_grid_y"] == 30
        assert file["fluid/u"].attrs["location"] == "x-faces"
        assert file["fluid/u"].attrs["unit"] == "length/time"
        np.testing.assert_allclose(file["fluid"].attrs["spacing"], (dx, dy))
    header = checkpoint.read_header(path)
    again = checkpoint.load_state(header, grid, state.markers, state.stretch)
    assert again.velocity.equal(state.velocity) and again.pressure.equal(state.pressure)


def test_the_last_few_are_kept_and_the_final_one_apart(tmp_path):
    run(tmp_path, ts_max_steps="9", checkpoint_every="2", checkpoint_keep="3")
    names = sorted(path.name for path in tmp_path.glob("*.h5"))
    assert names == [f"checkpoint-{k:08d}.h5" for k in (4, 6, 8)] + ["final.h5"]


@pytest.mark.parallel(2)
def test_wall_time_is_judged_on_rank_0(tmp_path):
    run(tmp_path / "all", ts_max_steps="4", checkpoint_minutes="1e-9", checkpoint_keep="9")
    assert len(list((tmp_path / "all").glob("checkpoint-*"))) == 3
    run(tmp_path / "none", ts_max_steps="4", checkpoint_minutes="60")
    assert not list((tmp_path / "none").glob("checkpoint-*"))


@pytest.mark.parallel(2)
def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path, monkeypatch):
    simulation = prepare(tmp_path / "run")
    simulation.diagnostics.row(simulation.state)
    before = sorted(os.listdir(tmp_path / "run"))

    def full(descriptor, offset, size):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OutputError, match=r"checkpoint-00000000.h5.part: No space left on device"):
        simulation._save()
    monkeypatch.undo()
    if comm.rank == 1:  # a write that fails on one rank only, after the room was there

        def broken(self, *arguments):
            raise OSError("error message = 'Input/output error', more words")

        monkeypatch.setattr(h5py.Dataset, "__setitem__", broken)
    if h5py.get_config().mpi:
        with pytest.raises(OutputError, match="fluid/u: Input/output error"):
            simulation._save()
    comm.Barrier()
    assert sorted(os.listdir(tmp_path / "run")) == before


# --- damaged and foreign files

@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    run(folder, ts_max_steps="1")
    return folder / "final.h5"


def edit(change):
    """A damage that changes an open HDF5 file."""

    def damage(path):
        with h5py.File(path, "r+") as file:
            change(file)

    return damage


def cut(part):
    return lambda path: path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])


def replace(name, values):
    def change(file):
        del file[name]
        if values is not None:
            file[name] = values

    return edit(change)


def set_attribute(name, value):
    return edit(lambda file: file.attrs.__setitem__(name, value))


def foreign(path):
    with h5py.File(path, "w") as file:
        file["fluid/u"] = np.zeros((24, 25))


DAMAGES = {
    "empty": (lambda path: path.write_bytes(b""), "not an HDF5 file"),
    "text": (lambda path: path.write_text("step,time\n"), "not an HDF5 file"),
    "few bytes": (cut(0.0001), "not an HDF5 file"),
    "half": (cut(0.5), "truncated file"),
    "last byte": (cut(0.99999), "truncated file"),
    "foreign": (foreign, "not a checkpoint of petscib"),
    "newer": (set_attribute("format_version", 3), "format version is 3; allowed: 1 or 2"),
    "no step": (edit(lambda file: file.attrs.__delitem__("step")), "lacks the attribute step"),
    "no options": (edit(lambda file: file.attrs.__delitem__("options")), "the attribute options"),
    "time is nan": (set_attribute("time", np.nan), "not every number"),
    "options are no JSON": (set_attribute("options", "{"), "its options cannot be read"),
    "options lack the grid": (set_attribute("options", "{}"), "its options cannot be read"),
    "unknown option": (edit(lambda file: file.attrs.__setitem__(
        "options", file.attrs["options"].replace('"given": [', '"sigma9": 1, "given": ["sigma9", ')
    )), "-sigma9 1: unknown option"),
    "no pressure": (replace("fluid/p", None), "no dataset fluid/p"),
    "no fluid": (replace("fluid", None), "no dataset fluid/u"),
    "group for dataset": (edit(lambda file: (file.__delitem__("fluid/p"),
                                             file.create_group("fluid/p"))), "no dataset fluid/p"),
    "velocity of another grid": (replace("fluid/v", np.zeros((24, 24))), "shape (24, 24)"),
    "velocity of whole numbers": (replace("fluid/v", np.zeros((25, 24), int)), "array of int64"),
    "no markers": (replace("vesicle_0/X", None), "no dataset vesicle_0/X"),
    "markers in 3D": (replace("vesicle_0/X", np.zeros((9, 3))), "shape (9, 3)"),
    "stretch too short": (replace("vesicle_0/stretch", np.ones(3)), "shape (3,)"),
    "velocity is nan": (edit(lambda file: file["fluid/u"].__setitem__((20, 20), np.nan)),
                        "not every entry of /fluid/u is finite"),
    "pressure is inf": (edit(lambda file: file["fluid/p"].__setitem__((0, 0), np.inf)),
                        "not every entry of /fluid/p is finite"),
    "marker is nan": (edit(lambda file: file["vesicle_0/X"].__setitem__((0, 0), np.nan)),
                      "not every entry of /vesicle_0/X is finite"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_file_is_refused(good, tmp_path, name):
    damage, reason = DAMAGES[name]
    path = tmp_path / "bad.h5"
    shutil.copy(good, path)
    damage(path)
    with pytest.raises(InputError) as caught:
        prepare(tmp_path / "out", restart=str(path), ts_max_steps="3")
    message = str(caught.value)
    assert message.startswith(f"-restart {path}: ") and reason in message
    assert len(message.splitlines()) == 1 and len(message) < 400
    assert not (tmp_path / "out").exists()


def test_only_damage_is_called_damage(good, tmp_path):
    def why(path):
        with pytest.raises(InputError) as caught:
            checkpoint.read_header(str(path))
        return str(caught.value)

    assert why(tmp_path / "none.h5") == f"-restart {tmp_path}/none.h5: No such file or directory"
    assert why(tmp_path) == f"-restart {tmp_path}: Is a directory"
    path = tmp_path / "held.h5"
    shutil.copy(good, path)
    with h5py.File(path, "r+"):
        holder = subprocess.run(
            [sys.executable, "-c", "import sys; from petscib.output import checkpoint\n"
             "try: checkpoint.read_header(sys.argv[1])\n"
             "except Exception as error: print(error)", path],
            stdout=subprocess.PIPE, text=True, env=mpi_environment(HDF5_USE_FILE_LOCKING="TRUE"))
    assert holder.stdout == f"-restart {path}: locked, another program is writing to it\n"
    cut(0.5)(path)
    assert why(path).endswith("(a damaged or cut off checkpoint)")


def test_any_cut_is_refused_or_read_whole(good, tmp_path):
    """Wherever a file is cut off, it is refused with one line, never half read."""
    whole = good.read_bytes()
    path = tmp_path / "cut.h5"
    for size in np.random.default_rng(3).integers(0, len(whole), 60):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError):
            checkpoint.read_header(str(path))


@pytest.mark.parallel(3)
def test_damage_that_one_rank_sees_ends_all(tmp_path):
    """The last row belongs to the last rank, and only it reads the NaN there."""
    run(tmp_path / "run", ts_max_steps="1")
    path = tmp_path / "run" / "final.h5"
    if comm.rank == 0:
        edit(lambda file: file["fluid/u"].__setitem__((-1, -1), np.nan))(path)
    comm.Barrier()
    with pytest.raises(InputError, match="not every entry of /fluid/u is finite"):
        prepare(tmp_path / "out", restart=str(path), ts_max_steps="3")


def test_replacing_keeps_the_old_file_when_writing_fails(tmp_path):
    path = tmp_path / "file"
    files.write_text(str(path), "old")
    with pytest.raises(ZeroDivisionError), files.replacing(str(path)) as temporary:
        open(temporary, "w").write("half")
        1 / 0  # noqa: B018
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["file"]
