"""Append-only tables: exact numbers, whole lines, and going on after a kill."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from petscib.output import tables
from petscib.output.tables import Table

COLUMNS = ["step", "time", "energy", "iterations"]


def write_steps(path, steps, extra=""):
    with Table(path, COLUMNS) as table:
        for step in range(steps):
            table.write({"step": step, "time": 0.1 * step, "energy": 1 / (step + 3)})
    with open(path, "a") as file:
        file.write(extra)


def test_text_of_a_row(tmp_path):
    path = tmp_path / "t.csv"
    with Table(path, COLUMNS) as table:
        table.write({"step": np.int64(3), "time": 0.1, "energy": np.float32(0.5)})
        table.write([4, 0.1 + 0.2, float("nan"), 7])
    assert path.read_text() == (
        "step,time,energy,iterations\n3,0.1,0.5,\n4,0.30000000000000004,nan,7\n"
    )


def test_numbers_come_back_bit_by_bit(tmp_path):
    values = np.random.default_rng(1).standard_normal(500) * 10.0 ** np.arange(-250, 250)
    with Table(tmp_path / "t.csv", ["step", "value"]) as table:
        for step, value in enumerate(values):
            table.write([step, value])
    table = tables.read(tmp_path / "t.csv")
    assert list(table) == ["step", "value"]
    assert np.array_equal(table["value"], values)
    assert np.array_equal(table["step"], np.arange(500))


def test_each_row_is_readable_at_once(tmp_path):
    with Table(tmp_path / "t.csv", COLUMNS) as table:
        for step in range(3):
            table.write([step, 0.0, 0.0, None])
            assert len(tables.read(tmp_path / "t.csv")["step"]) == step + 1


def test_empty_field_is_nan(tmp_path):
    write_steps(tmp_path / "t.csv", 2)
    assert np.isnan(tables.read(tmp_path / "t.csv")["iterations"]).all()


@pytest.mark.parametrize("torn", ["5,0.5", "5,0.5,0.125,", "5,0.5,0.125,1", "5,0.5,1e"])
def test_torn_last_line_is_ignored(tmp_path, torn):
    write_steps(tmp_path / "t.csv", 5, torn)
    assert tables.read(tmp_path / "t.csv")["step"].tolist() == [0, 1, 2, 3, 4]


def test_headers_alone_and_torn_headers(tmp_path):
    path = tmp_path / "t.csv"
    write_steps(path, 0)
    table = tables.read(path)
    assert list(table) == COLUMNS and all(column.shape == (0,) for column in table.values())
    path.write_text("step,ti")
    assert tables.read(path) == {}
    assert tables.read_outlines(path) == []
    Table.resume(path, COLUMNS, 7).close()
    assert path.read_text() == "step,time,energy,iterations\n"


@pytest.mark.parametrize("row", [{"stop": 1}, [1, 2, 3], [1, 2, 3, 4, 5]])
def test_wrong_row_is_refused_and_leaves_no_trace(tmp_path, row):
    with Table(tmp_path / "t.csv", COLUMNS) as table:
        with pytest.raises(ValueError, match="column"):
            table.write(row)
    assert (tmp_path / "t.csv").read_text() == "step,time,energy,iterations\n"


def test_resumed_table_equals_an_uninterrupted_one(tmp_path):
    write_steps(tmp_path / "whole.csv", 9)
    write_steps(tmp_path / "t.csv", 7, "7,0.70000000")
    with Table.resume(tmp_path / "t.csv", COLUMNS, 4) as table:
        for step in range(5, 9):
            table.write({"step": step, "time": 0.1 * step, "energy": 1 / (step + 3)})
    assert (tmp_path / "t.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["t.csv", "whole.csv"]


def test_resume_without_a_file_starts_one(tmp_path):
    with Table.resume(tmp_path / "t.csv", COLUMNS, 4) as table:
        table.write([5, 0.5, 1.0, 2])
    assert tables.read(tmp_path / "t.csv")["step"].tolist() == [5]


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        (["step", "time", "energy"], "has in addition iterations"),
        (COLUMNS + ["cfl"], "lacks cfl"),
        (COLUMNS + list("abcdefg"), "lacks a, b, c, d and 3 more"),
        (["step", "energy", "time", "iterations"], "another order"),
    ],
)
def test_resume_refuses_other_columns_and_keeps_the_file(tmp_path, columns, text):
    write_steps(tmp_path / "t.csv", 3)
    before = (tmp_path / "t.csv").read_bytes()
    with pytest.raises(ValueError, match=f"t.csv.*{text}"):
        Table.resume(tmp_path / "t.csv", columns, 1)
    assert (tmp_path / "t.csv").read_bytes() == before


@pytest.mark.parametrize(("line", "text"), [("5,0.5\n", "line 5"), ("5,o.5,1,1\n", "step 5.*o.5")])
def test_damage_inside_the_file_is_named(tmp_path, line, text):
    write_steps(tmp_path / "t.csv", 3, line + "6,0.6,1.0,1\n")
    with pytest.raises(ValueError, match=f"t.csv.*{text}"):
        tables.read(tmp_path / "t.csv")


def test_outlines_of_vesicles_of_different_size(tmp_path):
    path = tmp_path / "outlines.csv"
    generator = np.random.default_rng(2)
    written = [
        (step, 0.25 * step, vesicle, generator.standard_normal((markers, 2)))
        for step in range(3)
        for vesicle, markers in enumerate((6, 4))
    ]
    with Table(path, tables.outline_columns(6)) as table:
        for outline in written:
            table.write(tables.outline_row(*outline, 6))
    with open(path, "a") as file:
        file.write("3,0.75,0,0.1,0.2")
    assert path.read_text().startswith("step,time,vesicle,x0,y0,x1,y1,")
    read = tables.read_outlines(path)
    assert [outline[:3] for outline in read] == [outline[:3] for outline in written]
    for (*_, X), (*_, expected) in zip(read, written):
        assert np.array_equal(X, expected)
    # The file is rectangular, so that any reader of tables takes it.
    assert np.isnan(tables.read(path)["x5"]).tolist() == [False, True] * 3


def test_other_table_is_no_table_of_outlines(tmp_path):
    write_steps(tmp_path / "t.csv", 3)
    with pytest.raises(ValueError, match="t.csv: not a table of outlines"):
        tables.read_outlines(tmp_path / "t.csv")


def test_killed_writer_leaves_whole_rows(tmp_path):
    path = tmp_path / "outlines.csv"
    program = (
        "import sys, itertools, numpy as np\n"
        "from petscib.output import tables\n"
        "X = np.random.default_rng(0).standard_normal((400, 2))\n"
        "table = tables.Table(sys.argv[1], tables.outline_columns(400))\n"
        "for step in itertools.count(): table.write(tables.outline_row(step, 0.5, 0, X, 400))\n"
    )
    writer = subprocess.Popen([sys.executable, "-c", program, str(path)])
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline and not (path.exists() and path.stat().st_size > 200_000):
        time.sleep(0.01)
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    steps = [step for step, _, _, X in tables.read_outlines(path) if X.shape == (400, 2)]
    assert len(steps) > 10 and steps == list(range(len(steps)))
