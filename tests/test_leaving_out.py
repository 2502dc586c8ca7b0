"""A run builds, computes and logs what its scene has, and nothing else."""
import numpy as np
import pytest
import runs
from petsc4py import PETSc

from petscib import events
from petscib.membranes import mobility
from petscib.membranes.curves import Curves
from petscib.membranes.laws import Bending, Tension
from petscib.membranes.membranes import Membranes

STEPS = 4
SOME = -1  # often, by the solvers' convergence
EVERY_RUN = {"set-up": 1, "diagnostics": STEPS + 1, "checks": STEPS,
             "output": STEPS + 3}  # a row for each diagnostics; final.h5 and summary.json
# The pressure's jumps ask for the interpolation once more, where the final checkpoint is written.
MARKERS = {"interpolation assembly": STEPS + 1, "marker operators": STEPS, "marker motion": STEPS}
MODEL = {"marker model": STEPS}
PASSIVE = {**MARKERS, "interpolation assembly": STEPS}
PROJECTION = {"momentum solve": STEPS, "Poisson solve": STEPS}
COUPLED = {"coupled solve": STEPS}
ITERATED = {**MARKERS, "interpolation assembly": SOME, "marker operators": SOME,
            "tangent iteration": SOME, "coupled solve": SOME, "marker model": SOME}
NO_VESICLE = dict(scene="driven", axes=None)  # without what runs.SMALL says of a vesicle

# Options to the events that occur, and how often; no others may.
SCENES = {
    "mbe": ({}, {**MARKERS, **MODEL, **PROJECTION}),
    "mbe, fft": ({"fft": ""}, {**MARKERS, **MODEL, **PROJECTION}),
    "explicit": (dict(scheme="ep", sigma0="1", ts_dt="1e-4"),
                 {**PASSIVE, **PROJECTION, "forces": STEPS}),
    "be": (dict(scheme="be"), {**MARKERS, **MODEL, **COUPLED}),
    "gbe": (dict(scheme="gbe"), ITERATED),
    "gbe with nothing to average": (dict(scheme="gbe", sigma0="0", conserve_area="no"),
                                    {**PASSIVE, **MODEL, **COUPLED}),
    "passive markers": (dict(sigma0="0", bending="0"), {**PASSIVE, **PROJECTION}),
    "passive markers, be": (dict(scheme="be", sigma0="0", bending="0"), {**PASSIVE, **COUPLED}),
    "passive markers, gcn": (dict(scheme="gcn", sigma0="0", bending="0"), {
        "interpolation assembly": SOME, "marker operators": SOME, "tangent iteration": SOME,
        "coupled solve": SOME, "marker motion": SOME}),
    "no vesicle": (NO_VESICLE, PROJECTION),
    "no vesicle, gbe": (dict(NO_VESICLE, scheme="gbe"), COUPLED),
    "rows now and then": (dict(diagnostics_every="3"), {
        **MARKERS, **MODEL, **PROJECTION, "diagnostics": 3, "output": 5}),
    "ledger in the rows": (dict(diagnostics_every="3", ledger="record"), {
        **MARKERS, **MODEL, **PROJECTION, "diagnostics": 3, "output": 5, "ledger": 2}),
    "ledger as a check": (dict(diagnostics_every="3", ledger="warn"), {
        **MARKERS, **MODEL, **PROJECTION, "diagnostics": 3, "output": 5, "ledger": STEPS}),
    "fields": (dict(xdmf_every="2"), {
        **MARKERS, **MODEL, **PROJECTION, "output": STEPS + 3 + 3,
        "interpolation assembly": STEPS + 1 + 2}),
    "checkpoints": (dict(checkpoint_every="2"), {
        **MARKERS, **MODEL, **PROJECTION, "output": STEPS + 3 + 1,
        "interpolation assembly": STEPS + 1 + 1}),
}


@pytest.fixture(autouse=True)
def only_these_options(monkeypatch):
    """Let an option that is None be left out, whatever the common ones for small runs are."""
    monkeypatch.setattr(runs, "SMALL", {})


COMMON = {**runs.SMALL, "scheme": "mbe", "ts_max_steps": str(STEPS), "ts_max_time": "10"}


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


def laws_of(simulation):
    return {law.name for law in simulation.problem.membranes.laws}


@pytest.mark.parametrize("scheme", ["ep", "mbe", "gcn"])
@pytest.mark.parametrize("options, laws", [
    (dict(bending="0"), {"tension"}), (dict(sigma0="0"), {"bending"}),
    (dict(sigma0="0", bending="0"), set())])
def test_a_law_that_is_not_asked_for_has_no_rows(scheme, options, laws, tmp_path):
    given = {"sigma0": "1", "bending": "0.01", **options}
    simulation = finished(tmp_path, scheme=scheme, ts_dt="1e-3", **given)
    membranes = simulation.problem.membranes
    assert laws_of(simulation) == laws == set(membranes.rows)
    count = len(simulation.state.markers)
    rows = count * ("tension" in laws) + 2 * count * ("bending" in laws)
    assert membranes.stress_count == rows
    simulation.destroy()


@pytest.mark.parametrize("options, slips, projects", [
    ({}, True, True), (dict(kink_correction="no"), False, True),
    (dict(conserve_area="no"), True, False), (dict(sigma0="0", bending="0"), False, True),
    (dict(scheme="ep", ts_dt="1e-6"), False, False)])
def test_corrections_that_are_off_are_not_made(options, slips, projects, tmp_path, monkeypatch):
    made = set()
    for name in ("Slip", "AreaProjector"):
        kind = getattr(mobility, name)

        def make(*arguments, name=name, kind=kind):
            made.add(name)
            return kind(*arguments)

        monkeypatch.setattr(mobility, name, make)
    finished(tmp_path, **{"scheme": "mbe", **options}).destroy()
    assert ("Slip" in made) is slips and ("AreaProjector" in made) is projects


@pytest.mark.parametrize("sigma0, bending, entries", [(1.0, 1.0, 10), (1.0, 0.0, 4), (0.0, 1.0, 6)])
def test_rates_have_the_entries_they_need(sigma0, bending, entries):
    count = 12
    angle = 2 * np.pi * np.arange(count) / count
    markers = np.column_stack((np.cos(angle), np.sin(angle)))
    curves = Curves([count], [0.5])
    laws = [Tension(curves, sigma0, np.ones(count))] * (sigma0 > 0)
    laws += [Bending(curves, bending)] * (bending > 0)
    rates = Membranes(1, curves, laws, np.ones(count)).rates(markers, markers)
    assert rates.nnz == entries * count


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
    assert simulation.problem.membranes is None and len(simulation.state.markers) == 0
    assert type(simulation.scheme.system._iteration).__name__ == "Alone"
    assert not any("model" in name or "stress" in name for name in PETSc.Options().getAll())
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "diagnostics.csv", "final.h5", "summary.json"]
    simulation.destroy()


@pytest.mark.parametrize("options, iteration", [
    ({}, "Elimination"), (dict(fft="yes"), "Force"), (dict(scheme="be"), "Block"),
    (dict(ts_dt="10"), "Block"), (dict(sigma0="0", bending="0"), "Alone"),
    (dict(kink_correction="no"), "Elimination")])
def test_the_iteration_that_a_system_needs(options, iteration, tmp_path):
    simulation = prepared(tmp_path, **{"scheme": "mbe", **options})
    assert type(simulation.scheme.system._iteration).__name__ == iteration
    simulation.destroy()


def test_a_scheme_has_no_other_schemes_state(tmp_path):
    simulation = finished(tmp_path, scheme="mbe")
    assert set(simulation.state.history) == {
        "stage", "stage_rate", "stage_time", "stress", "stress_rate", "pressure_jump",
        "pressure_jump_place", "turning"}
    assert not any(name.startswith("coupled") for name in PETSc.Options().getAll())
    simulation.destroy()


def test_the_damped_start_makes_no_second_solver(tmp_path):
    simulation = prepared(tmp_path, scheme="gcn")
    assert simulation.scheme.damped.system is simulation.scheme.scheme.system
    simulation.destroy()


@pytest.mark.parametrize("words, loaded", [
    ([], set()), (["-plot", "yes"], {"matplotlib"}), (["-fft", "-xdmf_every", "1"],
     {"petscib.solvers.transforms.bases", "petscib.output.xdmf"}), (["-monitor", "bar"], {"tqdm"})])
def test_modules(words, loaded, mpirun):
    if "tqdm" in loaded:
        pytest.importorskip("tqdm")
    lazy = {"matplotlib", "tqdm", "petscib.solvers.transforms.bases", "petscib.output.xdmf",
            "petscib.output.plots"}
    arguments = ["-scheme", "mbe", "-stag_grid_x", "24", "-axes", "0.25,0.4", "-ts_max_steps", "1",
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
    text = mpirun(1, "-m", "petscib", "-scheme", "mbe", "-stag_grid_x", 24, "-axes", "0.25,0.4",
                  "-ts_max_steps", 2,
                  "-ledger", "record", "-plot", "no", "-log_view").stdout
    stages = {}
    for part in text.split("--- Event Stage ")[1:]:
        title, _, body = part.partition("\n")
        stages.setdefault(title.split(": ")[1], body)
    assert {"set-up", "stepping", "output"} <= set(stages)
    assert "\nset-up " in stages["set-up"] and "\noutput " in stages["output"]
    assert "KSPSolve" not in stages["set-up"]
    for name in (*MARKERS, *MODEL, *PROJECTION, "diagnostics", "ledger", "checks"):
        assert f"\n{name} " in stages["stepping"], name
    for name in ("coupled solve", "tangent iteration", "momentum assembly"):
        assert name not in text
