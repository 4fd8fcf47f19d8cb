"""Tables of the report as CSV, Markdown and LaTeX."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.cli.eval import main
from gpusimbench.evaluator.render.numbers import mean_sd
from gpusimbench.evaluator.report.paper.tables import tables, text_tables
from gpusimbench.evaluator.report.paper.text_table import Format, TextTable, as_csv, as_latex, as_markdown
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.evaluation import Evaluation
from tests.conftest import Command
from tests.synthetic import grid, write_recording, write_sweep

HOSTILE = "=cmd|'/C calc'!A0 | [x](http://x) & \\input{a} % <b>"
TEXTS = st.lists(st.tuples(st.text(), st.text()), min_size=1, max_size=4)


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Two simulators with states, one of a hostile name; a sweep that fails."""
    folder = tmp_path_factory.mktemp("tables")
    rng = np.random.default_rng(3)
    for number, name in enumerate(("one", HOSTILE)):
        for run in range(2):
            final = rng.uniform(0.0, 0.3, size=(3, 27, 3)) if number else grid(3)
            write_recording(folder, final, run=run, simulator=name, name=f"{number}-{run}.mcap", elapsed_s=1.0 + run)
    write_sweep(folder, (1, 4, 16), simulator="one", scene="free-fall", fails=16)
    return evaluate_files(sorted(folder.glob("*.mcap")))


def test_tables_say_what_was_evaluated(evaluation: Evaluation) -> None:
    """Give a row to each group, point, check and need, with the values that the page shows."""
    found = {table.key: table for table in tables(evaluation, published=True)}
    assert {"variability", "throughput", "scaling-largest", "scaling-points", "physics"} <= set(found)
    assert {"published-variability", "published-free-fall", "published-franka"} <= set(found)
    assert all(len(row) == len(table.titles) for table in found.values() for row in table.rows)
    assert all(len(set(table.titles)) == len(table.titles) for table in found.values())
    groups = {r.label: r for r in evaluation.results}
    for row in found["throughput"].rows:
        said = dict(zip(found["throughput"].titles, row, strict=True))
        assert said["throughput [env-steps/s]"] == mean_sd(groups[said["group"]].metrics["fps"])
    assert [row[2] for row in found["scaling-points"].rows] == ["1", "4", "16"]
    assert "failed" in found["scaling-points"].rows[2][-1]
    assert not any(table.key.startswith("published") for table in tables(evaluation, published=False))


def test_what_the_page_alone_had(tmp_path: Path) -> None:
    """Give rows to the capability table and to the price list, with what limits and why there is no price."""
    write_sweep(tmp_path, (64, 128, 256), simulator="warp", scene="free-fall", fails=256)
    for run in range(3):
        for level, slower, more in (("default", 1.0, {}), ("slow", 4.0, {}), ("bad", 1.0, {"status": "INVALID"})):
            write_recording(
                tmp_path, grid(2), run=run, determinism=level, elapsed_s=slower + run / 100, gpu_bytes=(0, 10**9),
                switches={"mode": level}, reason="because", **more,
            )  # fmt: skip
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    found = {table.key: table for table in tables(evaluation, published=False)}
    ((simulator, scene, n_max, *_, limit, _, _),) = found["capability"].rows
    assert (simulator, scene, n_max) == ("warp", "free-fall", "128")
    assert limit.startswith("memory: failed at 256")
    rows = [dict(zip(found["prices"].titles, row, strict=True)) for row in found["prices"].rows]
    said = {row["level"]: (row["throughput of the default's"][:5], row["why no price"]) for row in rows}
    assert said["default"] == ("1", "-")
    assert said["slow"] == ("0.252", "-")
    assert said["bad"][0] == "-"
    assert "INVALID" in said["bad"][1]
    assert rows[-1]["in force beside the default"] == "mode=slow"


def test_formats_are_files(evaluation: Evaluation) -> None:
    """Write each table in each format, and nothing for Parquet, which has tables of its own."""
    files = text_tables(evaluation, [Format.CSV, Format.MARKDOWN, Format.PARQUET], published=False)
    assert {Path(name).suffix for name in files} == {".csv", ".md"}
    rows = list(csv.DictReader(io.StringIO(files["throughput.csv"].decode(), newline="")))
    assert {r["group"].split(" [")[0][:5] for r in rows} == {"one", "'=cmd"}


@given(TEXTS)
def test_markdown_has_as_many_cells(rows: list[tuple[str, str]]) -> None:
    """Let no text end a cell or a row, or become markup."""
    text = as_markdown(TextTable("k", "caption", ("a", "b"), rows))
    lines = text.split("\n\nTable: ")[0].splitlines()
    assert len(lines) == 2 + len(rows)
    assert all(len(re.findall(r"(?<!\\)\|", re.sub(r"\\\\", "", line))) == 3 for line in lines)
    assert not re.search(r"(?<!\\)[<`\[]", re.sub(r"\\\\", "", text))


@given(TEXTS)
def test_latex_has_as_many_cells(rows: list[tuple[str, str]]) -> None:
    """Let no text end a cell or a row, open a group, or belong to the end of the line before."""
    text = as_latex(TextTable("k", "caption", ("a", "b"), rows))
    body = text.split("\\midrule\n")[1].split("    \\bottomrule")[0]
    lines = body.splitlines()
    assert len(lines) == len(rows)
    for line in lines:
        assert line.startswith("    {}")
        assert line.endswith(r" \\")
        assert len(re.findall(r"(?<!\\)&", line)) == 1
    assert text.count(r"\begin{") == text.count(r"\end{") == 2
    plain = re.sub(r"\\[{}]", "", text)
    assert plain.count("{") == plain.count("}")


def test_hostile_names(evaluation: Evaluation) -> None:
    """Escape what a simulator calls itself in every format."""
    table = next(t for t in tables(evaluation, published=False) if t.key == "throughput")
    assert "\n'=cmd" in as_csv(table)
    assert r"\[x\](http://x)" in as_markdown(table)
    assert r"\textbackslash{}input\{a\} \% \textless{}b" in as_latex(table)


def test_long_texts_are_paragraphs() -> None:
    """Break columns of sentences in LaTeX, and align numbers to the right."""
    text = as_latex(TextTable("k", "c", ("a", "b", "c"), [("x", "1", "word " * 20)]))
    assert r"\begin{tabular}{lrp{5cm}}" in text


def test_the_command(small: Path, tmp_path: Path, gsb_eval: Command) -> None:
    """Write what is asked for and name each file; --tables alone goes on to write Parquet."""
    done = gsb_eval(small, "--sample-time", 1, "--tables", tmp_path / "out", "--format", "md,tex")
    assert done.returncode == 0, done.stderr
    names = {line.rpartition("/")[2] for line in done.stdout.splitlines() if line.startswith("table: ")}
    assert names == {p.name for p in (tmp_path / "out").iterdir()}
    assert {"throughput.md", "throughput.tex", "variability.tex", "physics.md"} <= names
    assert not any(name.endswith(".parquet") for name in names)


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
