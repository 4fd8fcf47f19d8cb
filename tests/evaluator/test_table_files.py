"""Tables as files: CSV, where nothing of a stranger is a formula; Parquet, which says what the JSON does, in rows."""

from __future__ import annotations

import csv
import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.cli.eval import main
from gpusimbench.evaluator.render.table_files import to_csv
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.parquet import METRICS, RUNS, parquet_tables
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.schemas.errors import UsageError
from tests.conftest import Command
from tests.synthetic import configured, grid, write_recording

CELLS = st.none() | st.integers() | st.floats(allow_nan=False) | st.text()


def read(text: str) -> list[list[str]]:
    """The rows of a CSV file, as a strict reader finds them."""
    return list(csv.reader(io.StringIO(text, newline=""), strict=True))


@given(st.lists(st.tuples(CELLS, CELLS), max_size=5))
def test_every_table_can_be_read(rows: list[tuple[str | int | float | None, ...]]) -> None:
    """Give back as many rows and cells as were written, numbers without loss, and no formula."""
    text = to_csv(("a [m]", "b"), rows)
    header, *found = read(text)
    assert header == ["a [m]", "b"]
    assert text.count("\r\n") == len(rows) + 1 == text.count("\n") == text.count("\r")
    for row, cells in zip(rows, found, strict=True):
        for value, cell in zip(row, cells, strict=True):
            if value is None:
                assert cell == ""
            elif isinstance(value, str):
                assert cell == "-" or not cell.startswith(("=", "+", "-", "@", "\t", "\r"))
            else:
                assert type(value)(cell) == value


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1 m", "@SUM(A1)", "\t=1", " =HYPERLINK(0)", "\uff1d1", "\r=1"])
def test_formulas_are_text(text: str) -> None:
    """Put an apostrophe before what a spreadsheet would compute."""
    ((cell,),) = read(to_csv((text,), []))
    assert cell == f"'{text.strip()}"


def test_texts_of_strangers() -> None:
    """Keep quotes and commas, show control characters, and let no line break through."""
    ((_,), (cell,)) = read(to_csv(("a",), [['x, "y"\r\nz\x1b[2J']]))
    assert cell == 'x, "y" z\\x1b[2J'


def test_what_is_not_finite() -> None:
    """Write values that are not finite as readers of numbers know them."""
    assert read(to_csv(("a",), [[float("nan")], [float("-inf")]])) == [["a"], ["nan"], ["-inf"]]


pl = pytest.importorskip("polars")


def test_the_tables_say_what_the_document_says(tmp_path: Path, small_set: list[Path], gsb_eval: Command) -> None:
    """Write every metric of every group and every recording, with the values of the JSON."""
    out = tmp_path / "tables"
    done = gsb_eval(*small_set, "--sample-time", 1, "--json", "-", "--tables", out, "--no-cache", code=0)
    document = json.loads(done.stdout)
    metrics = pl.read_parquet(out / METRICS)
    for group in document["groups"]:
        rows = metrics.filter(pl.col("group") == group["label"])
        assert set(rows["metric"]) == set(group["metrics"])
        for row in rows.iter_rows(named=True):
            told = group["metrics"][row["metric"]]
            for name in ("value", "unit", "sd", "n", "exactness", "method", "value_missing"):
                assert row[name] == told[name]
            assert [row["low"], row["high"]] == (told["ci95"] or [None, None])
    runs = pl.read_parquet(out / RUNS)
    assert sorted(runs["file"]) == [str(p) for p in small_set]
    assert set(runs["content_hash"]) == {r["content_hash"] for r in document["recordings"]}
    assert not list(out.glob("*.partial"))


def test_tables_of_several_evaluations_are_one(tmp_path: Path) -> None:
    """Scan tables of two folders together, and group them."""
    for name, elapsed in (("a", 1.0), ("b", 2.0)):
        (tmp_path / name).mkdir()
        files = [write_recording(tmp_path / name, grid(2), run=run, elapsed_s=elapsed) for run in range(2)]
        (tmp_path / name / METRICS).write_bytes(parquet_tables(evaluate_files(files))[METRICS])
    fps = pl.scan_parquet(tmp_path / "*" / METRICS).filter(pl.col("metric") == "fps")
    found = fps.group_by("simulator").agg(pl.col("value").max() / pl.col("value").min()).collect()
    assert found["value"].to_list() == [pytest.approx(2.0)]


def test_strange_texts_and_seeds(tmp_path: Path) -> None:
    """Hold names that are no text, and seeds beyond 64 bits with a sign."""
    folder = tmp_path / "caf\udce9"
    folder.mkdir()

    path = write_recording(folder, grid(1), status="FAILED", reason="a\x1b[2J", change=configured(seed=2**64 - 1))
    evaluation = evaluate_files([path])
    (row,) = pl.read_parquet(parquet_tables(evaluation)[RUNS]).iter_rows(named=True)
    assert row["file"].endswith(f"caf\\udce9/{path.name}")
    assert (row["reason"], row["seed"], row["status"]) == ("a\\x1b[2J", str(2**64 - 1), "failed")


def test_values_that_are_none(tmp_path: Path) -> None:
    """Leave a value that could not be computed empty, with the reason beside it."""
    path = write_recording(tmp_path, np.full((2, 27, 3), np.nan))
    evaluation = evaluate_files([path])
    metrics = pl.read_parquet(parquet_tables(evaluation)[METRICS])
    row = metrics.row(by_predicate=pl.col("metric") == "w1_parallel", named=True)
    told = to_json(evaluation)["groups"][0]["metrics"]["w1_parallel"]
    assert (row["value"], row["value_missing"]) == (None, told["value_missing"])
    assert row["value_missing"]


def test_without_the_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, small: Path) -> None:
    """Say what to install, and write nothing."""
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(UsageError, match=r"pip install 'gpusimbench\[tables\]'"):
        parquet_tables(evaluate_files([small]))
    assert main([str(tmp_path / "missing.mcap"), "--tables", str(tmp_path / "out")]) == 2  # and reads no file


def test_a_folder_that_cannot_be_made(tmp_path: Path, small: Path, gsb_eval: Command) -> None:
    """Say in one line where the tables could not be written."""
    (tmp_path / "file").write_text("")
    done = gsb_eval(small, "--tables", tmp_path / "file" / "out", code=1)
    table = tmp_path / "file" / "out" / METRICS
    assert done.stderr == f"gsb-eval: cannot write {table}: Not a directory\n"
