"""A run builds, computes and logs what its scene has, and nothing else."""
import numpy as np
import pytest
import runs
from petsc4py import PETSc

from petscib import events
from petscib.membranes import geometry
from petscib.membranes.forces import Membrane

STEPS = 4
SOME = -1  # often, by the solvers' convergence
EVERY_RUN = {"set-up": 1, "diagnostics": STEPS + 1, "checks": STEPS,
             "output": STEPS + 3}  # a row for each diagnostics; final.h5 and summary.json
MARKERS = {"interpolation assembly": STEPS, "marker motion": STEPS}
TUBE = {"forces": STEPS, "tube set-up": STEPS, "tube solve": SOME}
PROJECTION = {"momentum solve": STEPS, "Poisson solve": STEPS}
COUPLED = {"coupled solve": STEPS}
ITERATED = {**MARKERS, "tangent iteration": SOME, "coupled solve": SOME,
            "forces": SOME, "tube set-up": SOME, "tube solve": SOME}
NO_VESICLE = dict(scene="driven", axes=None)  # without what runs.SMALL says of a vesicle

# Options to the events that occur, and how often; no others may.
SCENES = {
    "mbe": ({}, {**MARKERS, **TUBE, **PROJECTION}),
    "mbe, fft": ({"fft": ""}, {**MARKERS, **TUBE, **PROJECTION}),
    "explicit": (dict(scheme="ep", sigma0="1", ts_dt="1e-4"),
                 {**MARKERS, **PROJECTION, "forces": STEPS}),
    "be": (dict(scheme="be"), {**MARKERS, **TUBE, **COUPLED}),
    "gbe": (dict(scheme="gbe"), ITERATED),
    "gbe without tension": (dict(scheme="gbe", sigma0="0"), {**MARKERS, **TUBE, **COUPLED}),
    "passive markers": (dict(sigma0="0", bending="0"), {**MARKERS, **PROJECTION}),
    "passive markers, be": (dict(scheme="be", sigma0="0", bending="0"), {**MARKERS, **COUPLED}),
    "passive markers, gcn": (dict(scheme="gcn", sigma0="0", bending="0"), {
        "interpolation assembly": SOME, "tangent iteration": SOME, "coupled solve": SOME,
        "marker motion": SOME}),
    "no vesicle": (NO_VESICLE, PROJECTION),
    "no vesicle, gbe": (dict(NO_VESICLE, scheme="gbe"), COUPLED),
    "rows now and then": (dict(diagnostics_every="3"), {
        **MARKERS, **TUBE, **PROJECTION, "diagnostics": 3, "output": 5}),
    "ledger in the rows": (dict(diagnostics_every="3", ledger="record"), {
        **MARKERS, **TUBE, **PROJECTION, "diagnostics": 3, "output": 5, "ledger": 2}),
    "ledger as a check": (dict(diagnostics_every="3", ledger="warn"), {
        **MARKERS, **TUBE, **PROJECTION, "diagnostics": 3, "output": 5, "ledger": STEPS}),
    "fields": (dict(xdmf_every="2"), {**MARKERS, **TUBE, **PROJECTION, "output": STEPS + 3 + 3}),
    "checkpoints": (dict(checkpoint_every="2"), {
        **MARKERS, **TUBE, **PROJECTION, "output": STEPS + 3 + 1}),
}


@pytest.fixture(autouse=True)
def only_these_options(monkeypatch):
    """Let an option that is None be left out, whatever the common ones for small runs are."""
    monkeypatch.setattr(runs, "SMALL", {})


COMMON = {**runs.SMALL, "ts_max_steps": str(STEPS), "ts_max_time": "10"}


def prepared(folder, **options):
    words = {**COMMON, **options}
    return runs.prepare(folder, **{name: text for name, text in words.items() if text is not None})


def finished(folder, **options):
    simulation = prepared(folder, **options)
    simulation.run()
    return simulation


@pytest.mark.parametrize("scene", SCENES)
def test_events(scene, tmp_path):
    options, expected = SCENES[scene]
    finished(tmp_path, **options).destroy()
    expected = {**EVERY_RUN, **expected}
    counted = {name: SOME if expected.get(name) == SOME else count
               for name, count in events.calls.items()}
    assert counted == expected


def test_seconds_of_phases_add_up(tmp_path):
    simulation = prepared(tmp_path, scheme="gbe")
    summary = simulation.run()
    simulation.destroy()
    assert 0.8 * summary["total_seconds"] < sum(summary["phase_seconds"].values())
    assert sum(summary["phase_seconds"].values()) <= summary["total_seconds"]


def forbid(monkeypatch, *names):
    def called(*arguments):
        raise AssertionError(f"one of {names} is called")

    for name in names:
        monkeypatch.setattr(geometry, name, called)


@pytest.mark.parametrize("scheme", ["ep", "mbe", "mcn", "be", "gbe", "gcn"])
def test_no_bending_no_differences(scheme, tmp_path, monkeypatch):
    forbid(monkeypatch, "second_difference")
    finished(tmp_path, scheme=scheme, bending="0", sigma0="1", ts_dt="1e-3").destroy()


@pytest.mark.parametrize("scheme", ["ep", "mbe", "mcn", "be", "gbe", "gcn"])
@pytest.mark.parametrize("bending", ["0", "0.01"])
def test_no_tension_no_tangent(scheme, bending, tmp_path, monkeypatch):
    forbid(monkeypatch, "unit_tangent", "surface_divergence")
    ledger = "none" if scheme == "ep" else "error"
    finished(tmp_path, scheme=scheme, sigma0="0", bending=bending, ts_dt="1e-3",
             ledger=ledger).destroy()


@pytest.mark.parametrize("sigma0, bending, entries", [(1.0, 1.0, 10), (1.0, 0.0, 6), (0.0, 1.0, 5)])
def test_stiffness_has_the_entries_it_needs(sigma0, bending, entries):
    count = 12
    angle = 2 * np.pi * np.arange(count) / count
    markers = np.column_stack((np.cos(angle), np.sin(angle)))
    membrane = Membrane(0.5, sigma0, bending, np.ones(count))
    stiffness = membrane.stiffness(membrane.tangent(markers))
    matrix = stiffness.matrix(PETSc.COMM_SELF)
    assert matrix.getInfo()["nz_used"] == entries * 2 * count
    move = np.random.default_rng(1).standard_normal((count, 2))
    x, y = matrix.createVecs()
    x.setArray(move.ravel())
    matrix.mult(x, y)
    assert np.allclose(y.getArray(), stiffness.apply(move).ravel(), rtol=1e-13)


@pytest.mark.parametrize("options, moving, through", [
    (dict(flow="rest", shear_rate="0"), False, False), (dict(flow="shear"), True, True),
    (dict(flow="shear", shear_rate="0"), False, False)])
def test_walls(options, moving, through, tmp_path):
    simulation = prepared(tmp_path, **options)
    operators = simulation.problem.operators
    assert (operators.wall_source is not None) is moving
    assert (operators.wall_flux is not None) is through
    simulation.destroy()


def test_solvers_and_files_of_a_vesicle_are_not_made_without(tmp_path):
    simulation = finished(tmp_path, **NO_VESICLE)
    momentum = simulation.scheme.solver
    assert simulation.problem.membrane is None and len(simulation.state.markers) == 0
    assert momentum.direct is None and momentum.condensation is None
    assert momentum.ksp.getOperators()[0].getType() != "python"
    assert not any("tube" in name for name in PETSc.Options().getAll())
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "diagnostics.csv", "final.h5", "summary.json"]
    simulation.destroy()


def test_a_scheme_has_no_other_schemes_state(tmp_path):
    simulation = finished(tmp_path, scheme="mbe")
    assert set(simulation.state.history) == {"stage", "stage_change", "stretch_reset"}
    assert not any(name.startswith("coupled") for name in PETSc.Options().getAll())
    simulation.destroy()


@pytest.mark.parametrize("options", [
    dict(scheme="ep", sigma0="1", ts_dt="1e-4"), dict(sigma0="0"), dict(stretch="evolve")])
def test_no_reset_no_state_of_it(options, tmp_path):
    simulation = finished(tmp_path, **options)
    assert "stretch_reset" not in simulation.state.history
    simulation.destroy()


def test_the_damped_start_makes_no_second_solver(tmp_path):
    simulation = prepared(tmp_path, scheme="gcn")
    assert simulation.scheme.damped.solver is simulation.scheme.scheme.solver
    simulation.destroy()


@pytest.mark.parametrize("words, loaded", [
    ([], set()), (["-fft"], {"petscib.solvers.transforms.bases"}),
    (["-xdmf_every", "1"], {"petscib.output.xdmf"}), (["-plot", "yes"], {"matplotlib"}),
    (["-monitor", "bar"], {"tqdm"})])
def test_modules(words, loaded, mpirun):
    if "tqdm" in loaded:
        pytest.importorskip("tqdm")
    lazy = {"matplotlib", "tqdm", "petscib.solvers.transforms.bases", "petscib.output.xdmf",
            "petscib.output.plots"}
    arguments = ["-stag_grid_x", "24", "-axes", "0.25,0.4", "-ts_max_steps", "1",
                 "-monitor", "none", "-plot", "no", *words]
    script = ("import sys; sys.argv = ['petscib']; from petscib.__main__ import main; "
              f"assert main({arguments}) == 0; print('modules', *sys.modules)")
    line = mpirun(1, "-c", script).stdout.splitlines()[-1].split()
    assert line[0] == "modules"
    found = lazy & set(line)
    if "matplotlib" in loaded:
        assert loaded <= found
    else:
        assert found == loaded


def test_log_view_shows_stages_and_events(mpirun):
    text = mpirun(1, "-m", "petscib", "-stag_grid_x", 24, "-axes", "0.25,0.4", "-ts_max_steps", 2,
                  "-ledger", "record", "-plot", "no", "-log_view").stdout
    stages = {}
    for part in text.split("--- Event Stage ")[1:]:
        title, _, body = part.partition("\n")
        stages.setdefault(title.split(": ")[1], body)
    assert {"set-up", "stepping", "output"} <= set(stages)
    assert "\nset-up " in stages["set-up"] and "\noutput " in stages["output"]
    assert "KSPSolve" not in stages["set-up"] + stages["output"]
    for name in (*MARKERS, *TUBE, *PROJECTION, "diagnostics", "ledger", "checks"):
        assert f"\n{name} " in stages["stepping"], name
    for name in ("coupled solve", "tangent iteration", "momentum assembly"):
        assert name not in text
