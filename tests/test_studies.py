"""The studies: their parts, and a tiny case of each."""
import csv
import importlib
import os
from dataclasses import replace

import numpy as np
import pytest

from petscib import options
from petscib.membranes import shapes
from petscib.output import tables
from petscib.settings import text_of
from petscib.studies import (
    compare,
    contrast,
    convergence,
    cputime,
    defaults,
    gallery,
    iterations,
    maxstep,
    methods,
    report,
    runs,
    stability,
    tanktreading,
    tolerance,
    truth,
    vesicles,
    workprecision,
)
from petscib.studies.__main__ import STUDIES
from petscib.studies.campaign import Campaign

TINY = dict(scene="relaxation", stag_grid_x=16, fft=True, ts_dt=0.03125, ts_max_time=0.0625)


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    """Make a campaign of a name in the test's folder, in a shell that has set nothing for MPI."""
    for name in list(os.environ):
        if name.startswith(("OMPI_", "PRTE_")):
            monkeypatch.delenv(name)
    return lambda name: Campaign(name, str(tmp_path / name))


def forbid_runs(monkeypatch):
    def execute(run, folder):
        raise AssertionError(f"made again: {run.command(folder)}")

    monkeypatch.setattr(runs, "execute", execute)


def table(campaign):
    with open(campaign.path(f"{campaign.name}.csv")) as file:
        return list(csv.DictReader(file))


def assert_results(campaign, picture=None):
    """CSV, Markdown and picture are there, and nothing in them is NaN or infinite."""
    picture = picture or f"{campaign.name}.png"
    with open(campaign.path(picture), "rb") as file:
        assert file.read(8) == b"\x89PNG\r\n\x1a\n"
    for suffix in ("csv", "md"):
        with open(campaign.path(f"{campaign.name}.{suffix}")) as file:
            words = file.read().lower().replace(",", " ").replace("|", " ").split()
        assert words and not {"nan", "inf", "-inf"} & set(words)


# ---------------------------------------------------------------- parts


def test_a_run_is_a_command_line_and_its_key_depends_on_every_option():
    run = runs.Run(TINY)
    assert run.command("out/x") == (
        "mpiexec -n 1 python -m petscib -scene relaxation -stag_grid_x 16 -fft true "
        "-ts_dt 0.03125 -ts_max_time 0.0625 -monitor none -plot false -output out/x")
    assert run.key == runs.Run(dict(reversed(TINY.items()))).key
    assert len({run.key, runs.Run({**TINY, "ts_dt": 0.03}).key, runs.Run(TINY, ranks=2).key}) == 3


def test_runs_are_made_once_and_failures_are_outcomes(campaign, monkeypatch):
    one = campaign("some")
    good = one.run("good", TINY)
    bad = one.run("bad", {**TINY, "scheme": "ep", "sigma0": 1e9})
    slow = one.run("slow", {**TINY, "ts_dt": 1e-6}, time_limit=2.0)
    assert one.exit_status == 0 and all(run.is_result for run in (good, bad, slow))
    refused = one.run("refused", {**TINY, "ts_dt": -1})
    assert good.finished and good.steps == 2 and good.largest("area_error") < 1e-3
    assert good.step_seconds > 0 and good.final()["u"].shape == (16, 17)
    assert bad.status == runs.FAILED and bad.reason.startswith("petscib: step ")
    assert slow.status == runs.STOPPED and slow.seconds < 2.0 + runs.GRACE
    assert refused.status == runs.REFUSED and "-ts_dt" in refused.reason
    assert not refused.is_result

    with open(one.path("runs.csv")) as file:
        index = {row["title"]: row for row in csv.DictReader(file)}
    assert index["good"]["command"].endswith(good.folder)
    assert index["slow"]["status"] == "time limit"
    forbid_runs(monkeypatch)
    again = campaign("some")
    assert again.run("good", TINY) == good
    assert again.run("bad", {**TINY, "scheme": "ep", "sigma0": 1e9}).status == runs.FAILED
    assert again.run("slow", {**TINY, "ts_dt": 1e-6}, 1.0).status == runs.STOPPED
    # With more time, or when the input was at fault, there is reason to try again.
    with pytest.raises(AssertionError, match="made again"):
        again.run("slow", {**TINY, "ts_dt": 1e-6}, time_limit=60.0)
    with pytest.raises(AssertionError, match="made again"):
        again.run("refused", {**TINY, "ts_dt": -1})


def test_markers_are_compared_at_the_same_parameter_whatever_their_number():
    coarse, fine = (shapes.ellipse((0.2, 0.5), (0, 0), 0, count) for count in (91, 600))
    assert compare.marker_error(coarse, fine) < 1e-7
    assert compare.marker_error(coarse + (3e-3, 4e-3), fine) == pytest.approx(5e-3, rel=1e-4)


@pytest.mark.parametrize("component", "uv")
def test_velocities_are_compared_at_the_coarse_faces(component):
    def field(cells):
        shape = (cells, cells + 1) if component == "u" else (cells + 1, cells)
        y, x = np.meshgrid(*compare.face_points(shape, component, (-1, 1, -1, 1)), indexing="ij")
        return 2 * x - 3 * y + x * y

    # Bilinear fields are interpolated exactly, and only at the right places.
    coarse, fine = field(12), field(40)
    assert compare.velocity_error(coarse, fine, component) < 1e-13
    coarse[5, 7] += 0.25
    assert compare.velocity_error(coarse, fine, component) == pytest.approx(0.25)


def test_rates():
    assert convergence.rates((64, 128, 256), [8e-3, 2e-3, None]) == [
        None, pytest.approx(2.0), None]
    # Of round-off there is none.
    assert convergence.rates((64, 128), [3e-16, 1e-16]) == [None, None]
    assert convergence.paper("mbe", methods.LITERAL, "perimeter", (32, 256)) == [None, 1.154e-3]
    assert convergence.paper("mbe", methods.CORRECTED, "perimeter", (32, 256)) == [None, None]


def test_literal_is_the_papers_method_and_ep_has_no_other(tmp_path):
    series = methods.series(["ep", "mbe", "gcn"])
    assert series == [("ep", methods.LITERAL), ("mbe", methods.LITERAL),
                      ("mbe", methods.CORRECTED), ("gcn", methods.CORRECTED)]
    for scheme, method in series:
        given = dict(methods.OPTIONS[method], scheme=scheme, output=str(tmp_path))
        found = options.read({name: text_of(value) for name, value in given.items()})
        assert found.delta == "yang"
        assert found.kink_correction is found.conserve_area is (method == methods.CORRECTED)


@pytest.mark.parametrize("limit, relation, found", [
    (100.0, ">=", 64.0), (3.0, "=", 2 ** 1.5), (0.3, "=", 0.25), (0.01, "<", 1 / 16)])
@pytest.mark.parametrize("doubted, again", [(64.0, 1000.0), (1.0, 20.0)])
def test_the_search_for_the_largest_step(limit, relation, found, doubted, again):
    tried = []

    def judge(dt):  # steps so long that the run has few are good again
        tried.append(dt)
        return "" if dt <= limit or dt > again else f"trouble at {dt:.4g}"

    answer = maxstep.search(judge, 1 / 16, 64.0, 2, doubted)
    assert answer[:2] == (relation, pytest.approx(found))
    assert len(tried) <= np.log2(64 / max(min(found / 2, doubted), 1 / 16)) + 2
    if relation == "=":
        assert answer[2] == f"trouble at {2 ** 0.5 * found:.4g}"


def test_the_pareto_front_and_the_cheapest_setting():
    records = [dict(seconds=seconds, X=error) for seconds, error in (
        (1, 1e-2), (2, 3e-2), (3, 1e-3), (4, 1e-3), (5, 1e-5))]
    records += [dict(status="failed"), dict(seconds=0.5, area=0.0)]
    assert [one["seconds"] for one in workprecision.front(records, "X")] == [1, 3, 5]
    assert workprecision.cheapest(records, "X", 1e-3)["seconds"] == 3
    assert workprecision.cheapest(records, "X", 1e-6) is None


@pytest.mark.parametrize("reduced", tanktreading.REDUCED_AREAS)
def test_ellipses_of_a_reduced_area(reduced):
    rx, ry = tanktreading.ellipse_axes(reduced, tanktreading.PERIMETER)
    length = shapes.ellipse_perimeter((rx, ry))
    assert length == pytest.approx(tanktreading.PERIMETER, rel=1e-10) and rx < ry
    assert 4 * np.pi * np.pi * rx * ry / length**2 == pytest.approx(reduced, rel=1e-10)


@pytest.mark.parametrize("status, energies, area_error, verdict", [
    (runs.FINISHED, [1.0, 0.5, 0.25], 1e-3, stability.SOUND),
    (runs.FINISHED, [0.0, 0.0, 0.0], 0.0, stability.SOUND),
    (runs.FINISHED, [1.0, 0.5, 0.6], 0.0, stability.RISES),
    (runs.FINISHED, [1.0, 0.5, 0.25], 2e-2, stability.DRIFTS),
    (runs.FAILED, [1.0, 0.5, 0.25], 0.0, stability.LOST),
])
def test_verdicts_on_stability(tmp_path, status, energies, area_error, verdict):
    columns = "step", "energy", "area_error", "perimeter_error"
    with tables.Table(tmp_path / "diagnostics.csv", columns) as file:
        for step, energy in enumerate(energies):
            file.write((step, energy, area_error, 0.0))
    outcome = runs.Outcome(runs.Run({}), str(tmp_path), status)
    judge, case = stability.judge, stability.Case("group", "name", {})
    record = judge(case, "mbe", methods.LITERAL, outcome)
    assert record["verdict"] == verdict
    assert record["energy_rise"] == pytest.approx(0.1 if verdict == stability.RISES else 0.0)
    moved = stability.Case("group", "name", {"flow": "shear"})
    in_shear = judge(moved, "mbe", methods.LITERAL, outcome)
    assert "monotone" not in in_shear and in_shear["verdict"] != stability.RISES


def test_stability_cases_can_all_be_asked_for(tmp_path):
    names = set()
    for case in stability.cases():
        names.add((case.group, case.name))
        for scheme, method in methods.series(stability.SCHEMES):
            declared = {**stability.declare(case, scheme, method), "output": str(tmp_path)}
            options.read({name: text_of(value) for name, value in declared.items()})
    assert len(names) == len(stability.cases())


def test_numbers_in_tables():
    values = None, float("nan"), 0, 1.2345, 1e-5, 1236.0, 123456.0
    found = [report.number(value) for value in values]
    assert found == ["-", "-", "0", "1.23", "1.00e-5", "1240", "1.23e5"]


# ---------------------------------------------------------------- crashes

REFUSAL = """--------------------------------------------------------------------------
mpiexec has detected an attempt to run as root.

Running as root is *strongly* discouraged as any mistake (e.g., in
defining TMPDIR) or bug can result in catastrophic damage.
--------------------------------------------------------------------------
"""


@pytest.fixture
def launcher(tmp_path, monkeypatch):
    """Take a shell script, given as text, for the launcher."""
    def install(text):
        path = tmp_path / "launcher"
        path.write_text("#!/bin/sh\n" + text)
        path.chmod(0o755)
        monkeypatch.setenv("MPIEXEC", str(path))

    return install


def crashing(launcher, folder, words):
    """Make the runs crash that have these words among their options."""
    (folder / "refusal").write_text(REFUSAL)
    real = os.environ.get("MPIEXEC") or "mpiexec"
    launcher(f"""case "$*" in *"{words}"*) cat {folder}/refusal; exit 213;; esac
        exec {real} "$@"\n""")


@pytest.mark.parametrize("name", [*STUDIES, "bench"])
def test_a_study_whose_runs_all_crash_says_why_and_leaves_nothing(tmp_path, launcher, name):
    crashing(launcher, tmp_path, "-output")
    main = importlib.import_module(f"petscib.studies.{name}").main
    with pytest.raises(SystemExit) as end:
        main(["-quick", "-output", str(tmp_path / "out")])
    message = end.value.code  # a text, with which Python ends with status 1
    assert message.startswith(f"{name}: none of ") and "has given a result" in message
    assert "crashed: mpiexec has detected an attempt to run as root. (exit status 213)" in message
    log = message.split(": ")[-1]
    assert open(log).read() == REFUSAL
    assert sorted(os.listdir(tmp_path / "out")) == ["runs", "runs.csv"]


def test_a_launcher_that_is_not_there(campaign, monkeypatch):
    monkeypatch.setenv("MPIEXEC", "no-such-launcher")
    outcome = campaign("some").run("one", TINY)
    assert outcome.status == runs.CRASHED and not outcome.is_result
    assert outcome.reason == ("cannot start no-such-launcher: No such file or directory "
                              "(exit status 127)")


@pytest.mark.parametrize("text, reason", [
    ("petscib: a remark\nTraceback (most recent call last):\n  File \"a.py\", line 1\n    f()\n"
     "KeyError: 'x'\n---\nMPI_ABORT was invoked on rank 0\n", "KeyError: 'x'"),
    ("[0]PETSC ERROR: ----------------\n[0]PETSC ERROR: Caught signal number 11 SEGV: Segmentation "
     "Violation\n[0]PETSC ERROR: Try option -start_in_debugger\n",
     "Caught signal number 11 SEGV: Segmentation Violation"),
    (REFUSAL, "mpiexec has detected an attempt to run as root."),
    ("petscib: a remark\n\n", "no message"), ("", "no message"),
])
def test_why_a_run_has_crashed(tmp_path, text, reason):
    (tmp_path / "log.txt").write_text(text)
    found = runs._reason(str(tmp_path / "log.txt"), runs.CRASHED, 9)
    assert found == f"{reason} (exit status 9)"


def test_a_crash_among_results_is_none_of_them(campaign, launcher, tmp_path, capsys):
    crashing(launcher, tmp_path, "-scheme gbe")
    one = campaign("stability")
    small = {"stag_grid_x": 16, "axes": (0.25, 0.4), "ts_dt": 0.125}
    records = stability.study(one, [stability.Case("group", "name", small)], steps=2,
                              time_limit=60, schemes=("be", "gbe"))
    assert [record["verdict"] for record in records] == [stability.SOUND, stability.UNKNOWN]
    assert one.exit_status == 1
    assert_results(one)
    crash = "crashed | mpiexec has detected an attempt to run as root. (exit status 213)"
    assert crash in open(one.path("stability.md")).read()
    assert "gbe corrected: crashed, 0 steps, 0.0 s: mpiexec has detected" in capsys.readouterr().err

    one = campaign("maxstep")
    first, *others = maxstep.study(one, (16,), (1e7,), explicit_steps=2, octave=1, time_limit=60,
                                   schemes=("be", "gbe"), smallest=32.0)
    assert first["relation"] != maxstep.UNKNOWN and first["dt"] > 0
    assert [record["relation"] for record in others[1:]] == [maxstep.UNKNOWN] * 2
    assert_results(one)
    assert "| no result |" in open(one.path("maxstep.md")).read()

    one = campaign("convergence")
    convergence.study(one, (16,), 24, schemes=("be", "gbe"))
    assert_results(one)
    assert one.exit_status == 1 and campaign("other").exit_status == 0


# ---------------------------------------------------------------- a tiny case of each


def test_convergence(campaign, monkeypatch):
    one = campaign("convergence")
    rows = convergence.study(one, (16,), 24, schemes=("mbe",))
    assert_results(one)
    errors = {(method, quantity): error for _, method, quantity, _, error, _, _ in rows}
    assert set(errors) == {(m, q) for m in methods.OPTIONS for q in convergence.QUANTITIES}
    assert all(1e-5 < errors[method, "X"] < 0.05 for method in methods.OPTIONS)
    assert errors[methods.CORRECTED, "area"] < 1e-14 < 1e-6 < errors[methods.LITERAL, "area"]
    forbid_runs(monkeypatch)
    assert convergence.study(campaign("convergence"), (16,), 24, schemes=("mbe",)) == rows


def test_maxstep(campaign, monkeypatch):
    monkeypatch.setattr(maxstep, "EXPLICIT_SPAN", 4.0)
    one = campaign("maxstep")
    records = maxstep.study(one, (16,), (1e7,), explicit_steps=5, octave=1, time_limit=60,
                            schemes=("ep", "gbe"), smallest=4.0)
    assert_results(one)
    explicit, geometric, at_end = records
    assert (explicit["method"], geometric["method"]) == (methods.LITERAL, methods.CORRECTED)
    assert explicit["dt"] < 1e-2 < geometric["dt"] <= at_end["dt"]


def test_cputime(campaign):
    one = campaign("cputime")
    records = cputime.study(one, (16,), 3, 2, 60, schemes=("ep", "mbe"))
    assert_results(one)
    explicit, modified, corrected = records
    assert corrected["method"] == methods.CORRECTED and corrected["step_seconds"] > 0
    assert explicit["steps"] == 3 and explicit["extrapolated"] == 1
    # Two steps of 1/8 stand for eight.
    assert modified["total_seconds"] == pytest.approx(
        modified["set_up_seconds"] + 8 * modified["step_seconds"])


def test_tanktreading(campaign, monkeypatch):
    monkeypatch.setattr(tanktreading, "NEXT_STRAIN", 0.5)
    monkeypatch.setattr(tanktreading, "WINDOW", 0.25)
    one = campaign("tanktreading")
    records = tanktreading.study(one, (24,), (0.8,), (2.0,), 60, last_strain=1.0, first_strain=0.5)
    assert_results(one)
    assert [record["method"] for record in records] == list(methods.OPTIONS)
    for record in records:
        assert record["strain"] == pytest.approx(1.0) and not record["steady"]
        assert 0.2 < record["inclination_over_pi"] < 0.5 and record["centroid_offset"] < 1e-6
    assert records[1]["area_error"] < 1e-14 < 1e-4 < records[0]["area_error"]
    assert "| 0.8 | - |" in open(one.path("tanktreading.md")).read()


def test_workprecision(campaign, monkeypatch):
    cases = {name: replace(case, options={**case.options, "ts_max_time": 0.125})
             for name, case in workprecision.CASES.items()}
    monkeypatch.setattr(workprecision, "CASES", cases)
    one = campaign("workprecision")
    records = workprecision.study(one, (16, 24), 32, (0.5,), (), (1e-2,), 60, ("gcn",), (1e5,),
                                  most_work=600)
    assert_results(one)
    found = {(record["case"], record["rtol"]): record for record in records}
    # The finer of the fixed steps are more work than is allowed.
    assert [record["cells"] for record in records] == [16, 16, 24] * 2
    assert "Left out for the work they would be: 24^2 with dt = h/2, relax" in open(
        one.path("workprecision.md")).read()
    relaxing = [record for record in records if record["case"] == "relaxation"]
    assert 1e-4 < min(record["X"] for record in relaxing) < 0.02
    assert sum(record.get("X_on_front", 0) for record in relaxing) > 0
    # An upright vesicle has not turned by then.
    assert found["treading", None]["inclination"] > 1 and "X" not in found["treading", None]
    assert all(record["seconds"] > 0 for record in records)


def test_stability(campaign):
    one = campaign("stability")
    small = {"stag_grid_x": 16, "axes": (0.25, 0.4), "ts_dt": 0.125}
    chosen = [stability.Case("stiffness", f"sigma0 {sigma0:g}", {**small, "sigma0": sigma0})
              for sigma0 in (1.0, 1e13)]
    records = stability.study(one, chosen, steps=3, time_limit=60, schemes=("ep", "gbe"))
    assert_results(one)
    found = {(record["case"], record["scheme"]): record for record in records}
    assert found["sigma0 1e+13", "ep"]["verdict"] == stability.LOST
    good = found["sigma0 1", "gbe"]
    assert good["verdict"] == stability.SOUND and good["monotone"] == 1
    assert good["ledger_residual"] < 1e-6 and good["steps"] == 3
    lost = [row for row in table(one) if row["verdict"] == stability.LOST]
    assert all(row["reason"] for row in lost) and os.path.exists(one.path("runs.csv"))


def test_the_order_of_a_quantity():
    assert truth.triples((32, 48, 64, 96, 128)) == [(32, 64, 128)]
    assert truth.order(1.16, 1.04, 1.01) == pytest.approx(2.0)
    assert truth.order(1.16, 1.04, 1.05) is None is truth.order(1.16, 1.14, 1.0)
    assert truth.fitted_order({32: 0.16, 64: -0.04, 128: 0.01}) == pytest.approx(2.0)
    assert truth.fitted_order({32: 0.16}) is None
    among = [dict(cells=cells, value=1 + error, error=error)
             for cells, error in ((32, 0.16), (64, 0.04), (128, 0.01))]
    assert truth._orders(among) == ["2", "2"] and truth._orders(among[:2]) == ["-", "2"]


def test_sizes_of_a_dumbbell():
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False) + 0.01
    radius = 1 + 0.5 * np.cos(2 * angle)
    markers = np.stack((radius * np.sin(angle), radius * np.cos(angle)), axis=1)
    found = truth.sizes(markers)
    assert found["half_height"] == pytest.approx(1.5) and found["waist"] == pytest.approx(0.5)
    assert found["half_width"] == pytest.approx(np.abs(markers[:, 0]).max(), rel=1e-3)
    assert found["half_width"] > 0.6


def test_truth(campaign, monkeypatch):
    monkeypatch.setattr(truth, "STRAIN", {0.25: 1.0})
    monkeypatch.setattr(truth, "EQUILIBRIUM", 0.25)
    one = campaign("truth")
    records = truth.study(one, {truth.BEST: (24,)}, (0.25,), (0.125, 0.5), (0.9,), (24,), 60)
    assert_results(one)
    found = {(record["problem"], record["time"], record["quantity"]): record for record in records}
    # Also this grid comes within percents where the time was given.
    for name, error in (("half_width", 0.02), ("energy", 0.02)):
        assert abs(found["relaxation", 0.5, name]["relative_error"]) < error
    turning = found["turning", 1, "inclination"]
    assert turning["truth"] == 0.22056 and abs(turning["error"]) < 5e-3
    assert found["treading", 1.0, "frequency"]["value"] > 0
    assert found["least energy", 0.25, "energy ratio"]["value"] > 1.2
    assert "| bspline43, corrected | " in open(one.path("truth.md")).read().split("Largest")[-1]


def test_tolerance(campaign):
    one = campaign("tolerance")
    cases = {"relaxation": dict(scene="relaxation", ts_max_time=0.125)}
    records = tolerance.study(one, 16, {"gcn": (1e-3, 1e-5)}, {"gcn": (0, 1)}, 1e-6, cases)
    assert_results(one)
    loose, tight, long, short = (record["error"] for record in records)
    assert loose > 1.5 * tight and long > 1.5 * short
    assert all(record["seconds"] > 0 for record in records)


def test_seconds_of_fixed_steps_are_found_between_those_tried():
    records = [dict(error=error, seconds=seconds)
               for error, seconds in ((1e-2, 1.0), (1e-4, 100.0))] + [dict(status="failed")]
    assert tolerance.fixed_seconds(records, 1e-3) == pytest.approx(10.0)
    assert tolerance.fixed_seconds(records, 1e-5) is None is tolerance.fixed_seconds([], 1e-3)
    falling = [dict(rtol=10.0**-k, error=10.0 ** (-k / 2)) for k in range(4)]
    assert tolerance.slope(falling) == pytest.approx(0.5) and tolerance.slope(falling[:1]) is None


def test_distances_from_a_curve_do_not_depend_on_where_along_it():
    curve = shapes.ellipse((0.2, 0.5), (0, 0), 0, 80)
    along = shapes.ellipse((0.2, 0.5), (0, 0), 0, 83)
    assert defaults.curve_error(along, curve) < 1e-4  # of the finer curve's own edges
    assert defaults.curve_error(along + (0.01, 0), curve) == pytest.approx(0.01, rel=1e-2)
    line = np.stack((np.linspace(0, 1, 20), np.zeros(20)), axis=1)
    points = np.array([[0.5, 0.1], [1.3, 0.4]])
    assert defaults.curve_error(points, line, True) == pytest.approx(0.5)


def test_velocities_on_twice_the_grid():
    def velocity(cells):
        faces, centres = np.arange(cells + 1.0) / cells, (np.arange(cells) + 0.5) / cells
        return {"u": faces + 2 * centres[:, None], "v": 3 * faces[:, None] - centres}

    ours = velocity(8)
    assert defaults.velocity_error(ours, velocity(16)) < 1e-14
    ours["u"] *= 1.1
    ours["v"] *= 1.1
    assert defaults.velocity_error(ours, velocity(16)) == pytest.approx(0.1)


def test_defaults(campaign):
    one = campaign("defaults")
    relaxing, driven = defaults.study(one, ("relaxation", "driven"), 60, stag_grid_x=16,
                                      ts_max_time=0.25)
    assert relaxing["area"] < 1e-14 and 1e-3 < relaxing["shape"] < 0.1
    assert relaxing["right"] == int(max(relaxing["shape"], relaxing["place"]) <= defaults.ALLOWED)
    assert driven["velocity"] > 0 and "shape" not in driven and driven["right"] in (0, 1)
    assert "| relaxation | cn | 16 x 16 |" in open(one.path("defaults.md")).read()


def test_vesicles_are_put_where_an_arrangement_had_them(tmp_path):
    given = dict(vesicles="2", axes="0.1,0.2", output=str(tmp_path))
    settings = options.read({**given, "arrangement": "random", "stag_grid_x": "32"})
    placed = [((0.3, -0.2), 25.0), ((-0.4, 0.1), -70.0)]
    with tables.Table(tmp_path / "outlines.csv", tables.outline_columns(40)) as file:
        for step in (0, 5):
            for k, (center, angle) in enumerate(placed):
                markers = shapes.ellipse((0.1, 0.2), center, angle + step, 40)
                file.write((step, 0.1 * step, k, *markers.ravel()))
    found = defaults.places(runs.Outcome(runs.Run({}), str(tmp_path), runs.FINISHED), settings)
    again = options.read({**given, **{name: text_of(value) for name, value in found.items()}})
    for vesicle, (center, angle) in zip(again.each_vesicle(), placed):
        assert vesicle.center == pytest.approx(center)
        assert (vesicle.angle - angle + 90) % 180 == pytest.approx(90)


@pytest.mark.parametrize("start", [0.5, 0.0])
@pytest.mark.parametrize("A, regime", [(1.3, contrast.TREADS), (0.8, contrast.TUMBLES)])
def test_the_regime_is_that_of_keller_and_skalak(start, A, regime):
    """d theta / dt = -(1 - A cos 2 theta) / 2, from an upright start and from a level one."""
    time = np.linspace(0, 16, 1601)
    angle = np.full(len(time), np.pi * start)
    for k in range(len(time) - 1):
        angle[k + 1] = angle[k] - 0.005 * (1 - A * np.cos(2 * angle[k]))
    assert contrast.regime(time, angle / np.pi) == regime
    if start:  # before it has turned
        early = time <= 1.0
        assert contrast.regime(time[early], angle[early] / np.pi) is None


def test_the_critical_contrast_is_bracketed():
    asked = []

    def ask(value):
        asked.append(value)
        return contrast.TREADS if value < 4.7 else contrast.TUMBLES

    found = contrast.bisect(ask, 2.0, 9.0, 0.05)
    assert found == pytest.approx(4.7, rel=0.025) and len(asked) <= 8
    assert contrast.bisect(ask, 5.0, 9.0, 0.05) is None is contrast.bisect(ask, 2.0, 4.0, 0.05)


def test_values_are_extrapolated_by_the_two_smallest_sizes():
    values = [3 + 2 * size**2 for size in (0.5, 0.25, 1.0)]
    assert contrast.extrapolated((0.5, 0.25, 1.0), values) == pytest.approx(3.0)
    assert contrast.extrapolated((0.5, 0.25), (3.5, 3.25), power=1) == pytest.approx(3.0)
    assert contrast.extrapolated((0.5, 0.25), (3.5, None)) is None


def test_iterations(campaign):
    one = campaign("iterations")
    rows = iterations.study(one, (24,), (1e5,), solvers=("momentum, transforms",))
    (solver, cells, sigma0, count), = rows
    assert (solver, cells, sigma0) == ("momentum, transforms", 24, 1e5) and 1 < count < 30
    assert f"| momentum, transforms | 24^2 | {count} |" in open(one.path("iterations.md")).read()


def test_grids_may_be_asked_for(tmp_path):
    asked = ["-cells", "16,24", "-output", str(tmp_path)]
    one = Campaign.from_command_line("some", "", asked)
    assert one.grids(64) == (16, 24)
    assert Campaign.from_command_line("some", "", asked[2:]).grids(64, 128) == (64, 128)


def test_gallery(campaign):
    one = campaign("gallery")
    words = dict(ts_max_steps=2, stag_grid_x=32, ts_dt=0.02)
    pictures = gallery.study(one, ("taylor-green", "elastic"), ("elastic",), words, 60)
    assert pictures == {"taylor-green": ["taylor-green.png"],
                        "elastic": ["elastic.png", "elastic.gif"]}
    page = open(one.path("gallery.md")).read()
    for name in sum(pictures.values(), []):
        assert f"]({name})" in page and os.path.getsize(one.path(name)) > 1000
    assert "./run -scene elastic" in page


def test_vesicles(campaign):
    study = campaign("vesicles")
    records = vesicles.study(study, 64, (1, 4), (1,), schemes=("mbe",), ranks=(1,))
    assert_results(study)
    one, four, grown = records
    assert (one["scheme"], one["vesicles"], one["over_one"]) == ("mbe", 1, 1.0)
    assert one["tangent_passes"] is None
    assert four["vesicles"] == 4 and four["markers"] == 4 * one["markers"]
    assert four["over_one"] == four["step_seconds"] / one["step_seconds"]
    assert four["iterations"] > 0 and 0 < four["min_gap"] < one["min_gap"]
    assert (grown["cells"], grown["box"], grown["vesicles"]) == (32, 1, 16)
