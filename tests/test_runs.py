"""Whole runs: the paper's cases, ranks, failures and what is left."""
import json

import h5py
import numpy as np
import pytest

from petscib import Simulation
from petscib.output import tables

QUIET = ("-plot", "false", "-monitor", "none")

# The columns, and the content of files, that other programs rely on.
COLUMNS = """step time dt area perimeter area_error perimeter_error kinetic tension_energy
    bending_energy energy ledger_residual max_divergence max_speed cfl inclination
    treading_frequency momentum_iterations poisson_iterations coupled_iterations picard_iterations
    wall_seconds""".split()


@pytest.fixture
def petscib(mpirun):
    def run(ranks, *options, **keywords):
        return mpirun(ranks, "-m", "petscib", *QUIET, *options, **keywords)

    return run


def run(folder, **options):
    """The diagnostics of a run in this process, by column."""
    with Simulation(**options, output=str(folder), plot=False, monitor="none") as simulation:
        simulation.run()
    return read(folder)


def read(folder):
    """The diagnostics of a run, by column."""
    return tables.read(folder / "diagnostics.csv")


# Errors: the paper's Table 1, and a prototype with exact solves (two to three digits).
@pytest.mark.parametrize("scheme, paper, prototype", [
    ("mbe", (1.470e-3, 7.444e-3), (2.61e-5, 7.83e-4)),
    ("mcn", (2.688e-3, 6.899e-3), (2.67e-5, 2.66e-4))])
def test_relaxation_by_the_papers_method(tmp_path, scheme, paper, prototype):
    table = run(tmp_path, scene="relaxation", scheme=scheme, delta="yang", kink_correction=False,
                conserve_area=False, stag_grid_x=64)
    assert table["time"][-1] == pytest.approx(0.125) and len(table["step"]) == 17
    errors = table["area_error"][-1], table["perimeter_error"][-1]
    assert errors[0] <= paper[0] and errors[1] <= paper[1]
    assert errors == pytest.approx(prototype, rel=0.02)


@pytest.mark.parametrize("sigma0", ["1e5", "1e9"])
@pytest.mark.parametrize("scheme, largest", [("mbe", 8e-3), ("gcn", 1e-8)])
def test_stiff_vesicle_at_a_long_time_step(tmp_path, scheme, largest, sigma0):
    table = run(tmp_path, scene="stiff", sigma0=sigma0, scheme=scheme, ts_dt=2 / 64, fft=True)
    assert len(table["step"]) == 33 and table["time"][-1] == pytest.approx(1)
    assert table["area_error"].max() <= 1e-9
    # What the tension itself stretches is left to the weaker membrane.
    assert table["perimeter_error"].max() <= largest + (1e-4 if sigma0 == "1e5" else 0.0)
    if scheme == "mbe":
        assert np.nanmax(table["momentum_iterations"]) <= 12


def test_explicit_scheme_fails_at_a_long_time_step(petscib, tmp_path):
    result = petscib(2, "-scene", "stiff", "-scheme", "ep", "-stag_grid_x", 64, check=False)
    assert result.returncode == 3
    assert result.stderr.startswith("petscib: step ") and result.stderr.count("\n") == 1
    assert "try a smaller -ts_dt" in result.stderr and "-scheme mbe" in result.stderr
    assert "Traceback" not in result.stdout + result.stderr
    steps = read(tmp_path / "out/stiff")["step"]
    assert f"step {steps[-1] + 1:.0f} " in result.stderr
    saved = list((tmp_path / "out/stiff").glob("checkpoint-*.h5"))
    assert len(saved) == 1 and str(saved[0].name) in result.stderr


def test_same_answer_on_any_number_of_ranks(petscib, tmp_path):
    """65 x 50 cells, shear flow; and the files of a run."""
    answers = []
    for ranks in (1, 2, 3):
        folder = tmp_path / str(ranks)
        petscib(ranks, "-stag_grid_x", 65, "-stag_grid_y", 50, "-ts_dt", 2 / 65, "-ts_max_steps", 5,
                "-scheme", "mbe", "-output", folder, "-momentum_ksp_rtol", 1e-11,
                "-poisson_ksp_rtol", 1e-11)
        with h5py.File(folder / "final.h5") as file:
            names = ("fluid/u", "fluid/v", "fluid/p", "vesicle_0/X", "vesicle_0/stretch",
                     "vesicle_0/rest_stretch")
            answers.append({name: file[name][()] for name in names})
            check_attributes(file)
        check_files(folder, ranks)
    alone = answers[0]
    markers = len(alone["vesicle_0/X"])
    assert {name: values.shape for name, values in alone.items()} == {
        "fluid/u": (50, 66), "fluid/v": (51, 65), "fluid/p": (50, 65), "vesicle_0/X": (markers, 2),
        "vesicle_0/stretch": (markers,), "vesicle_0/rest_stretch": (markers,)}
    # The walls say that rows are y: u = y at the left wall.
    y = -1 + (np.arange(50) + 0.5) / 25
    assert np.allclose(alone["fluid/u"][:, 0], y, rtol=0, atol=1e-14)
    # So does the divergence, for columns that are x.
    divergence = np.diff(alone["fluid/u"], axis=1) * 65 / 2 + np.diff(alone["fluid/v"], axis=0) * 25
    assert np.abs(divergence).max() <= 1e-6
    for other in answers[1:]:
        for name, values in alone.items():
            difference = np.abs(other[name] - values).max()
            assert difference <= 1e-8 * np.abs(values).max(), name


def check_attributes(file):
    assert file.attrs["step"] == 5 and file.attrs["format_version"] >= 1
    assert file.attrs["dt"] == pytest.approx(2 / 65)
    assert file.attrs["time"] == pytest.approx(10 / 65)
    assert file.attrs["scheme"] == "mbe"
    assert json.loads(file.attrs["options"])["stag_grid_x"] == 65


def check_files(folder, ranks):
    table = read(folder)
    assert set(COLUMNS) <= set(table)
    assert np.array_equal(table["step"], np.arange(6))
    assert (table["max_divergence"] <= 1e-6).all()
    assert (table["momentum_iterations"][1:] > 0).all()
    with open(folder / "summary.json") as file:
        summary = json.load(file)
    assert summary["ranks"] == ranks
    assert {"petscib", "petsc", "petsc4py", "mpi4py", "numpy", "h5py", "python"} <= set(
        summary["versions"])
    assert summary["options"]["sigma0"] == 1e5 and summary["options"]["scene"] == "tanktreading"
    assert summary["last_row"]["step"] == 5
    assert summary["last_row"]["area"] == pytest.approx(table["area"][-1])
    seconds = summary["phase_seconds"]
    assert summary["total_seconds"] > 0 and all(part >= 0 for part in seconds.values())
    assert summary["cpu_seconds"] > 0
    outlines = tables.read_outlines(folder / "outlines.csv")
    assert len(outlines) >= 2


def test_a_failed_solve_ends_the_run_with_its_reason(petscib):
    result = petscib(3, "-scheme", "mbe", "-stag_grid_x", 32, "-poisson_ksp_max_it", 1,
                     "-poisson_ksp_rtol", 1e-13, check=False)
    assert result.returncode == 3
    assert result.stderr.startswith("petscib: step 1 from time 0 failed: pressure Poisson solve")
    assert "DIVERGED" in result.stderr and result.stderr.count("\n") == 1


@pytest.mark.parametrize("options", [
    dict(scene="tanktreading", ts_dt=0.011, ts_max_time=0.0551),
    dict(scene="poiseuille", stag_grid_x=64, ts_dt=0.0625, ts_max_time=0.13)])
@pytest.mark.parametrize("scheme", ["mbe", "gcn"])
def test_a_last_step_that_is_much_shorter(tmp_path, options, scheme):
    """Multigrid made for another time step would no longer precondition."""
    assert run(tmp_path, **options, scheme=scheme)["time"][-1] == options["ts_max_time"]
