"""Simulations in scripts."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import petscib
from petscib.output import tables

ROOT = Path(__file__).parents[1]
SMALL = dict(stag_grid_x=24, axes=(0.25, 0.4), ts_dt=0.05, ts_max_time=0.2, sigma0=1e4,
             bending=0.01, scheme="gbe", fft=True)
comm = MPI.COMM_WORLD


def test_the_code_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"petscib": petscib}
    page = (ROOT / "docs" / "library.md").read_text()
    for block in re.findall(r"```python\n(.*?)```", page, re.S):
        exec(block, names)
        if isinstance(names.get("simulation"), petscib.Simulation):
            names["simulation"].close()
    assert isinstance(names["scene"], petscib.Scene)
    assert not list(tmp_path.iterdir())
    assert "0.2 " in capsys.readouterr().out


@pytest.mark.parallel([1, 2])
def test_a_run_is_that_of_the_command_line(tmp_path):
    folder = str(tmp_path / "files")
    with petscib.Simulation(**SMALL, output=folder, monitor="none", plot=False) as written:
        written.run()
    with petscib.Simulation(**SMALL) as simulation:
        rows = list(simulation)
        assert simulation.finished and simulation.step == 4 and len(rows) == 4
        table, last = simulation.diagnostics, simulation.last_row
        markers, fields = simulation.markers, simulation.fields()
        membranes, tension = simulation.membranes, simulation.tension
        assert simulation.doubts == []
    assert last == rows[-1] and last["time"] == pytest.approx(0.2)
    assert len(table["energy"]) == 5 and np.isnan(table["cfl"][0])
    assert comm.allgather(table["energy"].tolist()) == [table["energy"].tolist()] * comm.size
    if comm.rank:
        assert markers.shape == (0, 2) and fields is None and membranes == []
        return
    files = tables.read(tmp_path / "files" / "diagnostics.csv")
    np.testing.assert_allclose(table["energy"], files["energy"], rtol=1e-12)
    assert membranes[0].shape == markers.shape and len(tension[0]) == len(markers)
    with pytest.raises(ValueError):
        markers[0] = 0
    assert fields["u"].shape == fields["p"].shape == (24, 24)
    assert fields["u_faces"].shape == (24, 25) and fields["v_faces"].shape == (25, 24)
    faces = fields["u_faces"]
    np.testing.assert_allclose(fields["u"], (faces[:, 1:] + faces[:, :-1]) / 2)


def test_messages_are_those_of_the_command_line():
    for words, message in ((dict(scheme="foo"), "-scheme foo: no such choice; allowed: ep"),
                           (dict(mue=1), "-mue 1: unknown option; "),
                           (dict(axes=(0.1, 2.0)), "-axes 0.1,2: "),
                           (dict(flow=lambda x, y, t: (t * y, 0 * x)), "changes in time"),
                           (dict(flow=lambda x, y, t: x), "returns no two arrays")):
        with pytest.raises(petscib.InputError) as raised:
            petscib.Simulation(**{**SMALL, **words})
        assert message in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("scheme", ["mbe", "gcn"])
def test_the_ledger_balances_with_a_flow_and_a_force_of_ones_own(scheme):
    def flow(x, y, t):
        return 0.6 * x - 0.4 * y, 0.4 * x - 0.6 * y

    def push(x, y, t):
        return np.sin(5 * t) * np.cos(y), x * np.exp(t)

    words = dict(SMALL, scheme=scheme, momentum_ksp_rtol=1e-11, coupled_ksp_rtol=1e-11,
                 poisson_ksp_rtol=1e-11)
    with petscib.Simulation(**words, flow=flow, body_force=push, ledger="record") as simulation:
        simulation.run()
        table = simulation.diagnostics
    assert np.nanmax(table["ledger_residual"]) < 1e-9
    assert abs(table["ledger_body_power"][1:]).min() > 1e-7
    assert abs(table["ledger_wall_power"][1:]).min() > 1e-3


def test_a_flow_of_ones_own_is_the_named_one():
    found = []
    for words in (dict(flow="shear", shear_rate=0.7), dict(flow=lambda x, y, t: (0.7 * y, 0 * x))):
        with petscib.Simulation(**SMALL, **words) as simulation:
            simulation.run()
            found.append(simulation.markers)
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12)


def test_calls_by_step_and_by_time():
    with petscib.Simulation(**SMALL) as simulation:
        steps, times = [], []
        simulation.every(lambda simulation: steps.append(simulation.step), steps=2)

        @simulation.every(time=0.1)
        def note(simulation):
            times.append(simulation.time)

        simulation.run()
    assert steps == [2, 4]
    assert times == pytest.approx([0.1, 0.2])
    with pytest.raises(ValueError):
        simulation.every(note)


class Springs:
    name, linear = "springs", True

    def __init__(self, curves, markers, exact=True):
        self.target, self.exact = markers.copy(), exact
        self._root = np.repeat(np.sqrt(30.0 * curves.ds), 2)
        self.columns = np.arange(2 * len(curves.ds))[:, None]

    def stress(self, markers, stretch, time=0.0):
        return self._root * (markers - self.target).ravel()

    def weights(self, before, after):
        return self._root[:, None] * (1.0 if self.exact else 1.1)


@pytest.mark.parallel([1, 2])
def test_a_law_of_ones_own_is_the_tether():
    found = []
    for words in (dict(laws=[Springs]), dict(tether=30.0)):
        with petscib.Simulation(**SMALL, **words) as simulation:
            simulation.run()
            found.append((simulation.markers, simulation.diagnostics))
    (own, table), (tethered, other) = found
    np.testing.assert_allclose(own, tethered, rtol=0, atol=1e-10)
    np.testing.assert_allclose(table["springs_energy"], other["tether_energy"], rtol=1e-6)
    with pytest.raises(petscib.InputError, match="Springs: its weights do not turn the change"):
        petscib.Simulation(**SMALL, laws=[lambda *place: Springs(*place, exact=False)])
    come_and_go = type("Ghosts", (Springs,), {"cover": lambda law, before, after: False})
    with pytest.raises(petscib.InputError, match="Ghosts: has no forget; allowed: an object with"):
        petscib.Simulation(**SMALL, laws=[come_and_go])


def test_points_are_the_shape():
    s = 2 * np.pi * np.arange(400) / 400
    ellipse = np.stack((0.25 * np.sin(s), 0.4 * np.cos(s)), axis=1)
    words = {name: value for name, value in SMALL.items() if name != "axes"}
    with petscib.Simulation(**words, points=[ellipse - (0.4, 0), ellipse + (0.4, 0)]) as pair:
        first, second = pair.membranes
        np.testing.assert_allclose(second - first, np.broadcast_to((0.8, 0), first.shape),
                                   atol=1e-12)
    with petscib.Simulation(**SMALL) as other:
        np.testing.assert_allclose(first[0] + (0.4, 0), other.markers[0], atol=1e-3)
        assert len(first) == len(other.markers)


@pytest.mark.parametrize("points, message", [
    (3 * np.eye(9, 2), "points array(9,2): "), ("abc", "points: could not convert"),
    ([np.eye(9, 2)[:, ::-1], np.eye(9, 2)[:4]], "points[0] array(9,2): ")])
def test_messages_name_the_points(points, message):
    with pytest.raises(petscib.InputError) as caught:
        petscib.Simulation(stag_grid_x=24, points=points)
    assert str(caught.value).startswith(message)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("failing", [None, 0, 1])
def test_a_script_that_fails_leaves_the_last_state(tmp_path, capfd, monkeypatch, failing):
    if failing is not None and failing >= comm.size:
        return
    # Shorter than a real one, as the other ranks of a test go on.
    monkeypatch.setattr("petscib.driver.PATIENCE", 0.5)
    kept = comm.bcast(str(tmp_path), root=0)
    raises = failing is None or comm.rank == failing
    simulation = petscib.Simulation(**SMALL, output=kept, monitor="none", plot=False)
    simulation.__enter__()
    for row in simulation:
        if row["step"] == 2:
            break
    error = RuntimeError("the script's own")
    simulation.__exit__(*((type(error), error, None) if raises else (None, None, None)))
    comm.Barrier()
    if comm.rank == 0:
        assert os.listdir(kept).count("checkpoint-00000002.h5") == 1
    with petscib.Simulation(restart=os.path.join(kept, "checkpoint-00000002.h5"),
                            ts_max_time=0.2) as again:
        assert again.step == 2
        again.run()
        with petscib.Simulation(**SMALL) as whole:
            whole.run()
            assert np.allclose(again.markers, whole.markers, rtol=0, atol=1e-8)


def test_a_closed_simulation_says_so():
    simulation = petscib.Simulation(**SMALL)
    simulation.close()
    simulation.close()
    for use in (simulation.run, simulation.fields, lambda: simulation.markers):
        with pytest.raises(RuntimeError, match="has been closed"):
            use()


def test_what_cannot_be_called_is_refused():
    for words in (dict(laws=[3]), dict(measures={"width": 3})):
        with pytest.raises(petscib.InputError, match="3 cannot be called"):
            petscib.Simulation(**SMALL, **words)


def test_a_measure_that_gives_no_number_is_refused():
    with petscib.Simulation(**SMALL, measures={"width": lambda simulation: "wide"}) as simulation:
        with pytest.raises(petscib.InputError, match="measures: width: 'wide' is no number"):
            simulation.run()


def test_simulations_side_by_side_do_not_share_their_options(capfd):
    """Neither what the user of one tells PETSc, nor the defaults of its solvers."""
    small = {**SMALL, "scheme": "mbe"}
    alone = petscib.Simulation(**small)
    expected = alone.run()
    alone.close()
    first = petscib.Simulation(**{**small, "fft": False}, momentum_ksp_rtol=1e-3)
    next(iter(first))
    second = petscib.Simulation(**small)
    found = second.run()
    assert found["petsc_options"] == expected["petsc_options"]
    np.testing.assert_array_equal(found["last_row"]["energy"], expected["last_row"]["energy"])
    rest = first.run()
    assert float(rest["petsc_options"]["momentum_ksp_rtol"]) == 1e-3
    first.close()
    second.close()
    assert "no solver has read" not in capfd.readouterr().err


def test_a_checkpoint_of_a_script_goes_on(tmp_path, capfd):
    with petscib.Simulation(**SMALL) as whole:
        for row in whole:
            if row["step"] == 2:
                break
        whole.save(tmp_path / "half.h5")
        whole.run()
        with petscib.Simulation(restart=str(tmp_path / "half.h5")) as rest:
            rest.run()
            np.testing.assert_array_equal(rest.markers, whole.markers)
    assert os.listdir(tmp_path) == ["half.h5"]
    assert capfd.readouterr().err == ""


def test_a_scene_in_a_file(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import petscib\nscene = petscib.Scene('mine', 'turning', dict(\n"
        "    flow=lambda x, y, t: (-y, x), axes=(0.2, 0.3), stag_grid_x=24, ts_max_steps=1,\n"
        "    ts_dt=0.05), measures={'answer': lambda simulation: 42.0})\n")
    words = "-scene mine.py -fft -monitor none -plot no -output out".split()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-m", "petscib", *words], cwd=tmp_path, text=True,
                          capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert tables.read(tmp_path / "out" / "diagnostics.csv")["answer"].tolist() == [42.0, 42.0]
    (tmp_path / "mine.py").write_text("scene = 1 / 0\n")
    done = subprocess.run([sys.executable, "-m", "petscib", *words], cwd=tmp_path, text=True,
                          capture_output=True, env=environment)
    assert done.returncode == 2
    assert done.stderr.startswith("petscib: -scene mine.py: line 1: ZeroDivisionError")
    assert done.stderr.count("\n") == 1


def test_an_exception_on_one_rank_ends_the_job(mpirun, tmp_path):
    (tmp_path / "script.py").write_text(
        "import petscib\nfrom mpi4py import MPI\n"
        "simulation = petscib.Simulation(stag_grid_x=24, ts_dt=0.05)\n"
        "if MPI.COMM_WORLD.rank == 1: raise ValueError('mine')\nsimulation.run()\n")
    done = mpirun(2, "script.py", check=False, timeout=60)
    assert done.returncode != 0 and "ValueError: mine" in done.stderr
