"""A metric is one declaration: every output takes it from there."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pytest

from gpusimbench.evaluator.cli.compare import main as gsb_compare
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.evaluator.render.table_files import table_files
from gpusimbench.evaluator.report.document import render_html, report
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.parquet import METRICS as METRICS_TABLE
from gpusimbench.evaluator.report.parquet import frames
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.metric import BYTES, Axis, Direction, Metric, Table, each
from gpusimbench.evaluator.results.metrics import METRICS, of_table
from gpusimbench.evaluator.results.result import GroupResult
from tests.pages import print_all
from tests.scripts import drawn, script
from tests.synthetic import write_recording

STEPS = Metric(
    "captured_steps", "steps of the capture", "steps", Direction.HIGHER,
    "number of steps that the capture phase was asked for; mean over runs",
    method="steps that were asked for", values=each(lambda run: float(run.configuration.steps)),
    axis=Axis.BUILD,
)  # fmt: skip


@pytest.fixture
def with_steps(monkeypatch: pytest.MonkeyPatch) -> Metric:
    """One more metric than there are."""
    monkeypatch.setitem(METRICS, STEPS.name, STEPS)
    return STEPS


@pytest.fixture
def recordings(tmp_path: Path) -> list[Path]:
    """Three runs of one configuration."""
    return [write_recording(tmp_path, None, run=run, elapsed_s=1.0) for run in range(3)]


def test_one_declaration_is_in_all_outputs(with_steps: Metric, recordings: list[Path]) -> None:
    """Show it in the terminal, JSON, HTML, Parquet, CSV, and in the documentation."""
    evaluation = evaluate_files(recordings)
    (result,) = evaluation.results
    expected = known(result.metrics[with_steps.name].value)
    assert expected
    shown = io.StringIO()
    print_all(evaluation, shown)
    assert with_steps.titled in shown.getvalue()
    record = to_json(evaluation)["groups"][0]["metrics"][with_steps.name]
    assert (record["value"], record["unit"], record["direction"], record["n"]) == (expected, "steps", "higher", 3)
    assert record["method"] == "steps that were asked for, mean over runs"
    page = render_html(evaluation, published=False, command="gsb-eval")
    assert re.search(rf'<th class=num scope=col title="[^"]*">{re.escape(with_steps.titled)}</th>', page)
    assert f"<code>{with_steps.name}</code>" in page
    table = script("make_metrics").table()
    assert f"| `{with_steps.name}` | {with_steps.title} | steps | higher | runs | {with_steps.docs}" in table
    files = table_files(report(Source(evaluation, False, "")), [Format.CSV])
    text = next(file.decode() for name, file in files.items() if name.startswith("costs."))
    titles, row = list(csv.reader(text.splitlines()))[:2]
    assert float(row[titles.index(with_steps.titled)]) == expected
    pytest.importorskip("polars")
    rows = frames(evaluation)[METRICS_TABLE].to_dicts()
    assert [one["value"] for one in rows if one["metric"] == with_steps.name] == [expected]


def test_one_declaration_is_compared(
    with_steps: Metric, recordings: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Compare it between two sets of runs, on its axis."""
    (tmp_path / "head").mkdir()
    head = [write_recording(tmp_path / "head", None, run=run, elapsed_s=1.0) for run in range(3)]
    gsb_compare(["--base", *map(str, recordings), "--head", *map(str, head), "--json", "-", "--no-cache"])
    (compared,) = json.loads(capsys.readouterr().out)["compared"]
    (found,) = (one for one in compared["findings"] if one["name"] == with_steps.name)
    assert (found["axis"], found["title"], found["change"]) == ("build", with_steps.title, "same")


def test_the_page_is_what_the_declarations_draw() -> None:
    """Keep the table of docs/metrics.md as docs/make_metrics.py draws it."""
    metrics = script("make_metrics")
    assert drawn(metrics.PAGE, "metrics") == metrics.table(), "run make figures"


def test_declarations_are_whole() -> None:
    """Give each metric what its outputs need, and a name and a title that no other has."""
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.title
        assert metric.docs
        assert metric.values or metric.of_group
        assert metric.per_unit == BYTES.get(metric.unit, 1.0)
    assert len({metric.title for metric in METRICS.values()}) == len(METRICS)


def test_a_metric_is_a_column_of_its_own_table_alone() -> None:
    """Give each table its own metrics, in the order of the declarations, and a metric without a table none."""
    tables = {table: [metric.name for metric in of_table(table)] for table in Table}
    assert tables[Table.THROUGHPUT][0] == "fps"
    assert tables[Table.VARIABILITY][0] == "w1_parallel"
    shown = [name for names in tables.values() for name in names]
    assert sorted(shown) == sorted(name for name, metric in METRICS.items() if metric.table)


def test_every_metric_has_an_estimate(recordings: list[Path]) -> None:
    """Give a value or a reason for each, in the order of the declarations."""
    result: GroupResult = evaluate_files(recordings).results[0]
    assert list(result.metrics) == list(METRICS)
    for estimate in result.metrics.values():
        assert not isinstance(estimate.value, Missing) or estimate.value.reason
        assert isinstance(estimate.value, Missing) is (estimate.exactness == "none")
