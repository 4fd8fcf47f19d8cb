"""Redraws the table of docs/metrics.md from the declarations of the metrics."""

from __future__ import annotations

from pathlib import Path

from page_blocks import redraw

from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.metrics import METRICS

PAGE = Path(__file__).resolve().parent / "metrics.md"


def table() -> str:
    """All metrics in the order of the outputs, as a Markdown table."""
    rows = [f"| `{m.name}` | {m.title} | {m.unit} | {m.direction.value} | {_said(m)} |" for m in METRICS.values()]
    return "\n".join(["| name | title | unit | better | what |", "| --- | --- | --- | --- | --- |", *rows])


def _said(metric: Metric) -> str:
    source = "*published*: " if metric.published else ""
    interval = f". 95 % interval: {metric.has_interval}" if metric.has_interval else ""
    return f"{source}{metric.docs}{interval}"


def main() -> None:
    """Write the table into the page."""
    redraw(PAGE, {"metrics": table()})


if __name__ == "__main__":
    main()
