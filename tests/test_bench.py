"""The benchmark: a small one from end to end, and the ratios it draws from its records."""
import csv

import pytest

from petscib.studies import bench
from petscib.studies.campaign import Campaign


def test_small_benchmark(tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "RANKS", (1,))
    monkeypatch.setattr(bench, "STIFFNESSES", (1e5,))
    campaign = Campaign("bench", str(tmp_path))
    monkeypatch.setattr(bench, "COUPLED", {"fft": ("be", "gbe")})
    monkeypatch.setattr(bench, "MULTIGRIDS", {"Jacobi": {"pc_type": "jacobi"}})
    records = bench.study(campaign, (32,), most_literal=32, explicit=(), coupled=(32,),
                          multigrid=(32,))
    assert [one["status"] for one in records.values()] == ["finished"] * 8
    for case, one in records.items():
        assert one["no phase seconds"] < 0.5 * one["step_seconds"]  # the phases are complete
        assert 0 < one["fast_solve_seconds"] < one["step_seconds"]
        assert (one["coupled_iterations"] is not None) == (case.scheme in ("be", "gbe"))
    plain, literal, ours = (
        records[bench.Case(name, 32, 1e5)] for name in (bench.PLAIN, bench.LITERAL, "GAMG"))
    other = records[bench.Case("Jacobi", 32, 1e9)]
    assert other["poisson_iterations"] > 2 * ours["poisson_iterations"]
    assert plain["momentum_iterations"] > 3 * ours["momentum_iterations"]
    assert literal["momentum_iterations"] <= 3
    with open(tmp_path / "bench.csv") as file:
        assert [row["solver"] for row in csv.DictReader(file)] == [one.solver for one in records]
    assert (tmp_path / "bench.png").stat().st_size > 10_000
    assert "| 32^2 | 1 | 1e5 |" in (tmp_path / "bench.md").read_text()


def test_speed_up_is_that_of_the_fastest_steps():
    case = bench.Case("fft", 128, 1e9, ranks=2)
    records = {case: {"fastest_step_seconds": 2.0, "step_seconds": 9.0}}
    assert bench.speed_up(records, case) is None
    records[bench.Case("fft", 128, 1e9)] = {"fastest_step_seconds": 3.0, "step_seconds": 3.0}
    assert bench.speed_up(records, case) == 1.5


def test_power_of_cells():
    records = {bench.Case("fft", count, 1e9): {"step_seconds": 3e-7 * count**2.2}
               for count in (128, 256, 512)}
    records[bench.Case("fft", 64, 1e9)] = {"step_seconds": 1.0}  # too small to count
    records[bench.Case("fft", 1024, 1e9)] = {"status": "failed"}
    assert bench.exponent(records, "fft") == pytest.approx(1.1)
    assert bench.exponent(records, "GAMG") is None


def test_no_target_is_met_without_a_result():
    cases = [bench.Case(solver, cells, sigma0) for solver in (*bench.SOLVERS, bench.PLAIN)
             for cells in (128, 512) for sigma0 in (1e5, 1e9)]
    records = {case: {"status": "crashed"} for case in cases}
    records[bench.Case(bench.PLAIN, 128, 1e5)].update(
        {"step_seconds": 1.0, **{f"{name} seconds": 1.0 for name in bench.MOMENTUM}})
    header, rule, *rows = bench._targets_table(records, None).strip().splitlines()
    assert "met" in header and rows == []
