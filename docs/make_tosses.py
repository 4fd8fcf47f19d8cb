"""Redraws the table of docs/how-to/cube-toss.md from recordings of the measured tosses, which are not in this project.

usage: python docs/make_tosses.py FOLDER

FOLDER holds what the commands of the page record: the reference, and a run of each simulator. The table names the
SHA-256 of the measured set and the content hash of each recording, so that whoever makes them again can compare.
"""

from __future__ import annotations

import sys
from pathlib import Path

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.numbers import figure, interval
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.toss_metrics import (
    TOSS_DEPTH,
    TOSS_END_POSITION,
    TOSS_FACE,
    TOSS_POSITION,
    TOSS_ROTATION,
)
from gpusimbench.evaluator.results.toss_ranking import Ranked, ranked

PAGE = Path(__file__).resolve().parent / "how-to" / "cube-toss.md"
BEGIN, END = "<!-- tosses: docs/make_tosses.py -->", "<!-- end of tosses -->"
_SAMPLE_TIME = 441 / 148
_SHOWN = (TOSS_POSITION, TOSS_ROTATION, TOSS_END_POSITION, TOSS_FACE, TOSS_DEPTH)
_HASH = 12


def table(folder: Path) -> str:
    """The table, and what it was made of, as Markdown."""
    evaluation = evaluate_files(sorted(folder.rglob("*.mcap")), sample_time=_SAMPLE_TIME)
    reference = evaluation.reference
    if reference is None or reference.tosses is None:
        raise SystemExit(f"{folder} has no recording of tosses: {evaluation.reference_note}")
    floor = reference.tosses.floor
    titles = ["simulator", *(metric.titled for metric in _SHOWN), "more than the first [cm]", "recording"]
    lines = [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}"]
    lines += [f"| {' | '.join(_row(one))} |" for one in ranked(evaluation.results)]
    degrees = 180 / 3.141592653589793 * floor.rotation
    lines += [
        "",
        f"{reference.tosses.name()}, SHA-256 `{reference.tosses.known.sha256[:_HASH]}...`. "
        f"The measurement itself leaves {100 * floor.position:.2f} cm and {degrees:.2f} deg.",
    ]
    return "\n".join(lines)


def _row(one: Ranked) -> list[str]:
    result = one.result
    recording = result.group.recordings[0]
    cells = [f"{result.label} {result.group.key.version}"]
    for metric in _SHOWN:
        estimate = result.metrics[metric.name]
        cells.append(f"{figure(known(estimate.value) or 0.0, metric.unit)} {interval(estimate)}")
    if one.against is None or one.adjusted is None or one.against.ci95 is None:
        cells.append("-")
    else:
        low, high = one.against.ci95
        p = "p < 0.001" if one.adjusted < 0.001 else f"p = {one.adjusted:.2g}"
        cells.append(f"{one.against.mean:.2f} [{low:.2f}, {high:.2f}], {p}")
    return [*cells, f"`{recording.content_hash[:_HASH]}`"]


def main() -> None:
    """Write the table into the page."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    _, tail = rest.split(END)
    PAGE.write_text(f"{head}{BEGIN}\n{table(Path(sys.argv[1]))}\n{END}{tail}", encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
