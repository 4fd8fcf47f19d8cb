"""The table of docs/metrics.md, drawn from the declarations of the metrics.

python -m docs.make_metrics            writes it into the page
python -m docs.make_metrics --print    prints it
"""

from __future__ import annotations

import argparse
from pathlib import Path

from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.metrics import METRICS

PAGE = Path(__file__).resolve().parent / "metrics.md"
BEGIN, END = "<!-- metrics: drawn by docs/make_metrics.py -->", "<!-- end of metrics -->"


def table() -> str:
    """All metrics in the order of the outputs, as a Markdown table."""
    rows = [f"| `{m.name}` | {m.title} | {m.unit} | {m.direction.value} | {_said(m)} |" for m in METRICS.values()]
    return "\n".join(["| name | title | unit | better | what |", "| --- | --- | --- | --- | --- |", *rows])


def _said(metric: Metric) -> str:
    source = "*published*: " if metric.published else ""
    interval = f". 95 % interval: {metric.has_interval}" if metric.has_interval else ""
    return f"{source}{metric.docs}{interval}"


def drawn(page: str) -> str:
    """The page with the table between its two marks."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n\n{table()}\n\n{END}{tail}"


def main() -> None:
    """Write or print the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--print", action="store_true")
    if p.parse_args().print:
        print(table())
    else:
        PAGE.write_text(drawn(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
