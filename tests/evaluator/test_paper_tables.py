"""Tables of the report as CSV, Markdown and LaTeX."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from gpusimbench.evaluator.cli.eval import main
from gpusimbench.evaluator.render.document import table
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.evaluator.render.numbers import mean_sd
from gpusimbench.evaluator.render.table_files import as_latex, table_files
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from tests.conftest import Command
from tests.pages import rows_of, tables_of
from tests.synthetic import grid, write_recording, write_simulators, write_sweep

HOSTILE = "=cmd|'/C calc'!A0 | [x](http://x) & \\input{a} % <b>"


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Two simulators with states, one of a hostile name; a sweep that fails."""
    folder = tmp_path_factory.mktemp("tables")
    write_simulators(folder, "one", HOSTILE)
    return evaluate_files(sorted(folder.glob("*.mcap")))


def test_tables_say_what_was_evaluated(evaluation: Evaluation) -> None:
    """Give a row to each group, point, check and need, with the values that the page shows."""
    found = tables_of(evaluation, published=True)
    assert {"simulators", "variability", "variability-distances", "validity", "recordings"} <= set(found)
    assert {"published-variability", "published-scaling"} <= set(found)
    assert all(len({c.title for c in table.columns}) == len(table.columns) for table in found.values())
    source = Source(evaluation, False, "")
    for result, row in zip(source.shown, found["throughput"].rows, strict=True):
        assert row.cells[0].text == source.names[result.label]
        assert row.cells[2].text == mean_sd(result.metrics["fps"])
    points = found["scaling-points-free-fall-one"]
    assert [row.cells[0].text for row in points.rows] == ["1", "4", "16"]
    assert any("failed" in note for note in points.rows[2].cells[-1].notes)
    assert not any(key.startswith("published") for key in tables_of(evaluation))


def test_what_the_page_alone_had(tmp_path: Path) -> None:
    """Give rows to the capability table and to the price list, with what limits and why there is no price."""
    write_sweep(tmp_path, (64, 128, 256), simulator="warp", scene="free-fall", fails=256)
    for run in range(3):
        for level, slower, more in (("default", 1.0, {}), ("slow", 4.0, {}), ("bad", 1.0, {"status": "INVALID"})):
            write_recording(
                tmp_path, grid(2), run=run, determinism=level, elapsed_s=slower + run / 100, gpu_bytes=(0, 10**9),
                switches={"mode": level}, reason="because", **more,
            )  # fmt: skip
    found = tables_of(evaluate_files(sorted(tmp_path.glob("*.mcap"))))
    ((simulator, said),) = rows_of(found["capability-free-fall"]).items()
    assert (simulator, said["N_env^max"].text) == ("warp", "128")
    limit = said["what limits N; contacts; timed steps"]
    assert limit.text == "memory"
    assert any("failed at 256" in note for note in limit.notes)
    (prices,) = (table for key, table in found.items() if key.startswith("prices"))
    rows = rows_of(prices)
    speeds = {name.split("[")[1][:-1]: row["throughput / that of the default"] for name, row in rows.items()}
    assert (speeds["default"].text, speeds["slow"].text, speeds["bad"].text) == ("1", "x 0.252", "-")
    mark = speeds["bad"].notes[0]
    assert any(line.startswith(mark) and "INVALID" in line for line in prices.legend)
    assert speeds["slow"].notes[0] == "mode=slow"


def test_formats_are_files(evaluation: Evaluation) -> None:
    """Write each table in each format, and nothing for Parquet, which has tables of its own."""
    document = report(Source(evaluation, False, ""))
    files = table_files(document, [Format.CSV, Format.MARKDOWN, Format.PARQUET])
    assert {Path(name).suffix for name in files} == {".csv", ".md"}
    rows = list(csv.DictReader(io.StringIO(files["throughput.csv"].decode(), newline="")))
    assert {r["group"].split(";")[0][:5] for r in rows} == {"one", "'=cmd"}


def test_long_texts_are_paragraphs() -> None:
    """Break columns of sentences in LaTeX, and align the others to the right."""
    text = as_latex(table("k", "c", ["a", "b", "c"], [["x", "1", "word " * 20]]))
    assert r"\begin{tabular}{lrp{5cm}}" in text


def test_the_command(small: Path, tmp_path: Path, gsb_eval: Command) -> None:
    """Write what is asked for, and say how many files and where; --tables alone goes on to write Parquet."""
    done = gsb_eval(small, "--sample-time", 1, "--tables", tmp_path / "out", "--format", "md,tex", code=0)
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert f"tables: {len(names)} files in {tmp_path / 'out'}" in " ".join(done.stdout.split())
    assert {
        "throughput.md",
        "throughput.tex",
        "variability.tex",
        "validity.md",
    } <= names
    assert not any(name.endswith(".parquet") for name in names)
    assert "opened row" not in "".join((tmp_path / "out" / name).read_text() for name in names)  # rows of pages alone


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--tables", "x", "--format", "csv,docx"], "no format of tables: docx"), (["--format", "csv"], "give both")],
)
def test_wrong_use(arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse formats that are not known, and a format without a place."""
    try:
        code = main([str(tmp_path / "a.mcap"), *arguments])
    except SystemExit as end:
        code = end.code  # type: ignore[assignment]
    assert code == 2
    assert said in capsys.readouterr().err
