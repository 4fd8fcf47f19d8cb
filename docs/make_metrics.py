"""Redraws the table of docs/metrics.md from the declarations of the metrics."""

from __future__ import annotations

from pathlib import Path

from page_blocks import redraw

from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.metrics import METRICS

PAGE = Path(__file__).resolve().parent / "metrics.md"


_INTERVALS = {
    "delete-one-run jackknife": "runs",
    "delete-one-run jackknife of a mean over pairs": "pairs",
    "tosses resampled": "tosses",
    "": "",
}
"""What intervals are made of, by how `Metric.has_interval` says it; the page explains them."""


def table() -> str:
    """All metrics in the order of the outputs, as a Markdown table."""
    rows = [
        f"| `{m.name}` | {m.title} | {m.unit} | {m.direction.value} | {_INTERVALS[m.has_interval]} | {_said(m)} |"
        for m in METRICS.values()
    ]
    head = ["| name | title | unit | better | 95 % over | what |", "| --- | --- | --- | --- | --- | --- |"]
    return "\n".join([*head, *rows])


def _said(metric: Metric) -> str:
    return f"{'*published*: ' if metric.published else ''}{metric.docs}"


def main() -> None:
    """Write the table into the page."""
    redraw(PAGE, {"metrics": table()})


if __name__ == "__main__":
    main()
