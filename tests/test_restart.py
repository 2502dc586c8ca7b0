"""A restarted run is the uninterrupted run: state, tables, options, folders."""
import json
import os
import shutil

import h5py
import numpy as np
import pytest
from runs import SMALL, arrays, assert_same_run, comm, prepare, rows, run

from petscib import options, restart, schemes
from petscib.errors import InputError, SolveError
from petscib.output import lock, tables, views
from petscib.output.checkpoint import Progress
from petscib.stepsize import GROW_AFTER, SMALLEST, StepSize


def refusal(folder, **words):
    """The message of a refused restart, the same on all ranks; nothing has been written."""
    before = sorted(os.listdir(folder)) if folder.exists() else None
    comm.Barrier()
    with pytest.raises(InputError) as caught:
        prepare(folder, **words)
    after = sorted(os.listdir(folder)) if folder.exists() else None
    assert before == after
    message = str(caught.value)
    assert set(comm.allgather(message)) == {message} and len(message.splitlines()) == 1
    return message


@pytest.fixture
def finished(tmp_path):
    """Folder of a run of 6 steps, with checkpoints of steps 2 and 4 and the final one."""
    run(tmp_path / "whole", ts_max_steps="6", checkpoint_every="2")
    return tmp_path / "whole"


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("scheme", ["ep", "mbe", "mcn", "gbe", "gcn"])
def test_restarted_equals_uninterrupted_bit_for_bit(tmp_path, scheme):
    # Multigrid on 3 ranks adds in the order of arrival, and keeps its coarse grids when the time
    # step changes: there the runs agree to solver tolerance only.
    words = {"scheme": scheme, "fft": "yes", "checkpoint_every": "3", "sigma0": "1e3",
             "ts_dt": "0.01", "delta": "yang"}
    run(tmp_path / "whole", ts_max_time="0.08", **words)
    run(tmp_path / "again", restart=str(tmp_path / "whole" / "checkpoint-00000003.h5"))
    comm.Barrier()
    assert len(rows(tmp_path / "whole")["step"]) == 9
    assert_same_run(tmp_path / "whole", tmp_path / "again")


@pytest.mark.parallel(2)
def test_an_interrupted_run_goes_on_in_its_folder(tmp_path):
    words = {"ts_max_time": "0.08", "ts_dt": "0.01", "checkpoint_every": "3", "outline_every": "2"}
    run(tmp_path / "whole", **words)
    if comm.rank == 0:  # as kill -9 after step 7, within a line and within a checkpoint
        broken = shutil.copytree(tmp_path / "whole", tmp_path / "broken")
        os.unlink(broken / "final.h5")
        (broken / "checkpoint-00000009.h5.part").write_bytes(b"\x89HDF\r\n\x1a\n torn")
        for name in ("diagnostics.csv", "outlines.csv"):
            lines = (broken / name).read_text()
            (broken / name).write_text(lines[:-20])
    comm.Barrier()
    run(tmp_path / "broken", restart="latest")
    comm.Barrier()
    assert_same_run(tmp_path / "whole", tmp_path / "broken")
    assert not list((tmp_path / "broken").glob("*.part"))


def test_other_ranks_agree_to_solver_tolerance(mpirun, tmp_path):
    small = [word for name, text in SMALL.items() for word in (f"-{name}", text)]
    mpirun(2, "-m", "petscib", *small, "-output", "whole", "-ts_max_steps", 6,
           "-checkpoint_every", 3, "-scheme", "mbe", "-poisson_ksp_rtol", "1e-10",
           "-momentum_ksp_rtol", "1e-10")
    result = mpirun(3, "-m", "petscib", "-restart", "whole/checkpoint-00000003.h5",
                    "-output", "on3")
    assert result.stderr == "petscib: continuing from whole/checkpoint-00000003.h5\n"
    run(tmp_path / "on1", restart=str(tmp_path / "whole" / "checkpoint-00000003.h5"))
    for name in ("on1", "on3"):
        assert_same_run(tmp_path / "whole", tmp_path / name, tolerance=1e-6)
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["petsc_options"]["poisson_ksp_rtol"] == "1e-10"  # the user's, from the file


@pytest.mark.parallel(2)
def test_options_come_from_the_file_and_those_given_now_win(finished, tmp_path):
    file = str(finished / "checkpoint-00000004.h5")
    simulation = prepare(tmp_path / "other", restart=file, sigma0="7", stag_grid_x="24",
                         ts_max_steps="9")
    settings = simulation.settings
    simulation.destroy()
    assert (settings.stag_grid_x, settings.axes, settings.checkpoint_every) == (24, (0.25, 0.4), 2)
    assert (settings.sigma0, settings.ts_max_steps) == (7.0, 9)
    assert simulation.state.step == 4 and simulation.wall_seconds_before > 0
    before = rows(finished)["energy"][:5]
    assert np.isclose(simulation.progress.largest_energy, before.max(), rtol=1e-14)
    # Without -output it goes on where the file is.
    merged = restart.merge({"restart": file}, comm)
    assert merged["output"] == str(finished)


def test_a_changed_default_does_not_change_a_restart(finished, monkeypatch):
    file = str(finished / "final.h5")
    moved = options.TABLE["mu"].__class__(**{**vars(options.TABLE["mu"]), "default": 3.0})
    monkeypatch.setitem(options.TABLE, "mu", moved)
    assert options.read({}).mu == 3.0
    assert options.read(restart.merge({"restart": file}, comm)).mu == 1.0


@pytest.mark.parametrize("name, text, saved", [
    ("stag_grid_x", "32", "24"), ("stag_grid_y", "32", "24"), ("domain", "-2,2,-2,2", "-1,1,-1,1"),
    ("axes", "0.3,0.4", "0.25,0.4"), ("center", "0.1,0", "0,0"), ("angle", "5", "0"),
    ("markers", "99", "0"), ("vesicles", "0", "1"), ("rest_length", "0.5", "None"),
    ("flow", "extensional", "shear"), ("shear_rate", "2", "1"), ("scene", "stiff", "tanktreading"),
    ("marker_file", __file__, "None"),
])
def test_what_the_state_depends_on_cannot_change(finished, tmp_path, name, text, saved):
    file = str(finished / "final.h5")
    message = refusal(tmp_path / "other", restart=file, ts_max_steps="9", **{name: text})
    assert message.startswith(f"-{name} {text}: a restart cannot change it")
    assert f"made with {saved};" in message and f"no -{name}" in message


@pytest.mark.parallel([1, 2])
def test_an_end_before_the_restart_is_refused(finished, tmp_path):
    file = str(finished / "final.h5")
    for name, text in (("ts_max_time", "0.1"), ("ts_max_time", "0.5"), ("ts_max_steps", "6")):
        message = refusal(tmp_path / "other", restart=file, **{name: text})
        assert message.startswith(f"-{name} {text}: {file} has reached")


@pytest.mark.parallel([1, 2])
def test_latest_is_the_newest_complete_checkpoint(finished, tmp_path, capfd):
    if comm.rank == 0:
        whole = (finished / "final.h5").read_bytes()
        (finished / "final.h5").write_bytes(whole[: len(whole) // 2])
        (finished / "checkpoint-00000009.h5").write_bytes(b"")
    comm.Barrier()
    capfd.readouterr()
    summary = run(finished, restart="latest", ts_max_steps="8")
    assert summary["steps"] == 4
    said = capfd.readouterr().err
    if comm.rank == 0:
        assert "skipped" in said and "final.h5" in said
        assert f"continuing from {finished}/checkpoint-00000004.h5" in said
    message = refusal(tmp_path / "empty", restart="latest")
    assert "no complete checkpoint in" in message and "-output" in message


def test_tables_and_frames_are_continued_from_an_earlier_step(tmp_path):
    folder = tmp_path / "run"
    run(folder, ts_max_steps="6", checkpoint_every="2", xdmf_every="1")
    before = rows(folder)
    run(folder, restart=str(folder / "checkpoint-00000004.h5"), ts_max_steps="7")
    assert list(rows(folder)["step"]) == list(range(8))
    np.testing.assert_equal(rows(folder)["energy"][:7], before["energy"])
    times = (folder / "fields.xdmf").read_text().count("<Time")
    assert times == 8 == len(list(folder.glob("fields-*.h5")))
    # What was done again has been kept beside.
    kept = {path.name for path in (folder / "previous").iterdir()}
    assert kept >= {"final.h5", "fields-00000005.h5", "fields-00000006.h5"}
    clock = tables.read(folder / "diagnostics.csv")["wall_seconds"]
    assert (np.diff(clock) > 0).all()


def test_a_new_run_keeps_the_results_of_the_one_before(finished, capfd):
    before = arrays(finished / "final.h5")
    run(finished, ts_max_steps="2")
    assert "are now in" in capfd.readouterr().err
    assert not list(finished.glob("checkpoint-*"))
    np.testing.assert_equal(arrays(finished / "previous" / "final.h5"), before)
    run(finished, ts_max_steps="1")
    with h5py.File(finished / "previous" / "final.h5") as file:
        assert file.attrs["step"] == 2
    assert not list((finished / "previous").glob("checkpoint-*"))
    np.testing.assert_equal(arrays(finished / "previous-1" / "final.h5"), before)


def test_a_run_that_went_on_in_previous_is_kept(finished):
    run(finished, ts_max_steps="2")
    run(finished / "previous", restart="latest", ts_max_steps="8")
    continued = arrays(finished / "previous" / "final.h5")
    for _ in range(2):
        run(finished, ts_max_steps="1")
    np.testing.assert_equal(arrays(finished / "previous-1" / "final.h5"), continued)
    run(finished, restart=str(finished / "previous-1" / "final.h5"), ts_max_steps="9")
    np.testing.assert_equal(arrays(finished / "previous-1" / "final.h5"), continued)
    assert list(rows(finished)["step"]) == list(range(10))
    # A run that is going on there is not moved away beneath.
    going_on = prepare(finished / "previous", ts_max_steps="1")
    with pytest.raises(InputError, match="previous: in use by process"):
        run(finished, ts_max_steps="1")
    going_on.destroy()


def test_files_of_the_user_are_left_alone(tmp_path):
    theirs = ["notes.part", "thesis.png", "animation.key", "checkpoint-good.h5",
              "checkpoint-1.h5", "fields-mine.h5", "summary.json.bak", "previous-work"]
    ours = ["checkpoint-00000007.h5.part", "outlines.png.part", "diagnostics.csv.part"]
    for name in (*theirs, *ours, "animation.gif", "outlines.png"):
        (tmp_path / name).write_text(name)
    (tmp_path / "previous").mkdir()
    (tmp_path / "previous" / "mine.txt").write_text("kept")
    for _ in range(3):
        run(tmp_path, ts_max_steps="1")
    for name in theirs:
        assert (tmp_path / name).read_text() == name
    assert not any((tmp_path / name).exists() for name in ours)
    assert (tmp_path / "previous-1" / "mine.txt").read_text() == "kept"
    assert (tmp_path / "previous-2" / "animation.gif").read_text() == "animation.gif"
    assert (tmp_path / "previous-2" / "outlines.png").read_text() == "outlines.png"


def test_every_file_of_a_run_is_known_and_set_aside(tmp_path):
    """But for the lock, which goes with the run."""
    words = {"plot": "yes", "xdmf_every": "1", "checkpoint_every": "1", "ledger": "record"}
    folder = tmp_path / "run"
    run(folder, ts_max_steps="3", **words)
    views.animate(str(folder))
    before = {path.name for path in folder.iterdir()}
    assert {"animation.gif", "ledger.png", "fields.png", "fields.xdmf", "final.h5"} < before
    prepare(folder)
    assert {path.name for path in (folder / "previous").iterdir()} == before
    assert {path.name for path in folder.iterdir()} == {
        lock.NAME, "previous", "diagnostics.csv", "outlines.csv"}


def test_the_default_folder_does_not_matter_to_a_restart_elsewhere(finished, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").write_text("a file where out/tanktreading would be")
    file = str(finished / "checkpoint-00000004.h5")
    run(tmp_path / "again", restart=file)
    assert_same_run(finished, tmp_path / "again")
    assert restart.merge({"restart": file}, comm)["output"] == str(finished)


@pytest.mark.parallel([1, 2])
def test_a_wider_delta_function_near_a_wall_is_refused(tmp_path):
    words = {"center": "0.5,0", "ts_max_steps": "2"}
    run(tmp_path / "run", delta="roma3", **words)
    file = str(tmp_path / "run" / "final.h5")
    message = refusal(tmp_path / "other", restart=file, delta="bspline65", ts_max_steps="4")
    assert message.startswith("-delta bspline65: the vesicle has come to the wall x = 1")
    assert file in message


def test_a_marker_file_need_not_be_there_any_more(tmp_path, monkeypatch):
    s = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    np.savetxt(tmp_path / "curve.txt", np.stack((0.3 * np.cos(s), 0.4 * np.sin(s)), axis=1))
    words = {"marker_file": str(tmp_path / "curve.txt"), "ts_max_steps": "4",
             "checkpoint_every": "2"}
    monkeypatch.delitem(SMALL, "axes")
    run(tmp_path / "whole", **words)
    os.unlink(tmp_path / "curve.txt")
    run(tmp_path / "again", restart=str(tmp_path / "whole" / "checkpoint-00000002.h5"))
    assert_same_run(tmp_path / "whole", tmp_path / "again")


def test_extra_state_survives(tmp_path):
    simulation = prepare(tmp_path / "a", ts_max_steps="1")
    state, grid = simulation.state, simulation.problem.grid
    velocity, pressure = grid.velocity_vector(), grid.pressure_vector()
    velocity.setRandom()
    pressure.setRandom()
    markers = np.random.default_rng(1).random((5, 2))
    state.history.update(earlier=markers, flow=velocity, load=pressure)
    progress = Progress(1.0, reference={"area": [1.0], "perimeter": [1.0]})
    path = simulation.results.save(state, progress)
    again = prepare(tmp_path / "b", restart=path).state.history
    np.testing.assert_array_equal(again["earlier"], markers)
    assert again["flow"].equal(velocity) and again["load"].equal(pressure)


def test_step_size_halves_and_grows():
    step = StepSize(1.0, adapt=True)
    assert step.reject(1.0) and step.dt == 0.5
    assert step.reject(0.5) and step.dt == 0.25
    for _ in range(GROW_AFTER):
        assert step.dt == 0.25
        step.accept()
    assert step.dt == 0.5
    resumed = StepSize(1.0, True, step.dt, step.good_steps)
    for _ in range(3 * GROW_AFTER):
        step.accept()
        resumed.accept()
        assert step.dt == resumed.dt <= 1.0
    assert step.dt == 1.0
    attempts = 0
    while step.reject(step.dt):
        attempts += 1
    assert attempts == int(np.log2(1 / SMALLEST)) and step.dt >= SMALLEST
    assert not StepSize(1.0).reject(1.0)


@pytest.mark.parallel([1, 2])
def test_failed_steps_are_retried_without_a_trace(tmp_path, monkeypatch):
    """A run whose steps 3 and 4 fail unless they are small goes on, also across a restart."""

    create = schemes.create

    def create_fragile(*arguments):
        scheme = create(*arguments)
        step = scheme.step

        def fragile(state, dt):
            taken = step(state, dt)
            if 2 <= state.step < 4 and dt > 0.006:
                raise SolveError("too large")
            return taken

        scheme.step = fragile
        return scheme

    monkeypatch.setattr(schemes, "create", create_fragile)
    words = {"ts_dt": "0.02", "ts_max_time": "0.2", "ts_adapt": "yes", "checkpoint_every": "5",
             "checkpoint_keep": "9", "fft": "yes"}
    run(tmp_path / "whole", **words)
    run(tmp_path / "again", restart=str(tmp_path / "whole" / "checkpoint-00000005.h5"))
    comm.Barrier()
    assert_same_run(tmp_path / "whole", tmp_path / "again")
    dt, time = rows(tmp_path / "whole")["dt"], rows(tmp_path / "whole")["time"]
    np.testing.assert_allclose(dt[1:8], [0.02, 0.02, *[0.005] * 5])
    assert dt[8] == 0.01 and np.isclose(time[-1], 0.2)
    with h5py.File(tmp_path / "whole" / "checkpoint-00000005.h5") as file:
        assert (file.attrs["dt"], file.attrs["good_steps"]) == (0.005, 3)
        assert json.loads(file.attrs["options"])["ts_dt"] == 0.02
