"""Redraws the tables of docs/how-to/cube-toss.md from recordings of the measured tosses, which are not in this project.

usage: python docs/make_tosses.py FOLDER            errors, a run of each simulator
       python docs/make_tosses.py --front FOLDER    throughput against error, timed runs among them

FOLDER holds what the commands of the page record: the reference, and runs of each simulator. A table names the
SHA-256 of the measured set and the content hash of each recording, so that whoever makes them again can compare.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.numbers import figure, interval, plural
from gpusimbench.evaluator.report.leaders import speaks_against
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import (
    TOSS_DEPTH,
    TOSS_END_POSITION,
    TOSS_FACE,
    TOSS_POSITION,
    TOSS_ROTATION,
)
from gpusimbench.evaluator.results.toss_ranking import Ranked, beaten_by, ranked
from gpusimbench.evaluator.runs.labels import labels, options_given

PAGE = Path(__file__).resolve().parent / "how-to" / "cube-toss.md"
BEGIN, END = "<!-- tosses: made by a script -->", "<!-- end of tosses -->"
_SAMPLE_TIME = 441 / 148
_SHOWN = (TOSS_POSITION, TOSS_ROTATION, TOSS_END_POSITION, TOSS_FACE, TOSS_DEPTH)
_FRONT = (TOSS_POSITION, TOSS_ROTATION, TOSS_DEPTH)
_HASH = 12


def table(folder: Path, *, front: bool = False) -> str:
    """A table, and what it was made of, as Markdown. front: with throughputs, the most accurate first."""
    evaluation = evaluate_files(sorted(folder.rglob("*.mcap")), sample_time=_SAMPLE_TIME)
    reference = evaluation.reference
    if reference is None or reference.tosses is None:
        raise SystemExit(f"{folder} has no recording of tosses: {evaluation.reference_note}")
    floor = reference.tosses.floor
    order = ranked(evaluation.results)
    if front:
        lines = _front(order, evaluation.results)
    else:
        titles = ["simulator", *(metric.titled for metric in _SHOWN), "more than the first [cm]", "recording"]
        lines = [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}"]
        lines += [f"| {' | '.join(_row(one))} |" for one in order]
    degrees = 180 / 3.141592653589793 * floor.rotation
    lines += [
        "",
        f"{reference.tosses.name()}, SHA-256 `{reference.tosses.known.sha256[:_HASH]}...`. "
        f"The measurement itself leaves {100 * floor.position:.2f} cm and {degrees:.2f} deg.",
    ]
    return "\n".join(lines)


def _front(order: list[Ranked], results: Sequence[GroupResult]) -> list[str]:
    against = {one.result.label: speaks_against(one.timed or one.result, results) for one in order}
    better = beaten_by([one for one in order if not against[one.result.label]])
    runs = [run for one in order for run in one.result.group.recordings]
    names = labels([one.result.group.key for one in order], options_given(runs))
    by_label = {one.result.label: name for one, name in zip(order, names, strict=True)}
    devices = {one.timed.group.key.device: one.timed.group.key.n_env for one in order if one.timed}
    ((device, n_env),) = devices.items()
    titles = [
        "simulator",
        f"env-steps/s, {n_env:,} envs",
        "simulated s/s",
        *(m.titled for m in _FRONT),
        "on the front",
        "recording",
    ]
    lines = [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}"]
    for one in sorted(order, key=lambda one: -one.pace):
        if not one.timed:
            continue
        label, runs_timed = one.result.label, len(one.timed.group.complete)
        if against[label]:
            verdict = f"not ranked: {against[label]}"
        else:
            why = f"no: {by_label.get(better[label])} is faster and not measurably less accurate"
            verdict = why if better[label] else "**yes**"
        cells = [by_label[label], f"{one.fps:,.0f} ({plural(runs_timed, 'run')})", f"{one.pace:,.0f}"]
        cells += [f"{figure(known(one.result.metrics[m.name].value) or 0.0, m.unit)} "
                  f"{interval(one.result.metrics[m.name])}" for m in _FRONT]  # fmt: skip
        lines.append(f"| {' | '.join([*cells, verdict, f'`{one.result.group.recordings[0].content_hash[:_HASH]}`'])} |")
    return [*lines, "", f"On {device}."]


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
    *options, folder = sys.argv[1:] or [""]
    if options not in ([], ["--front"]) or not folder:
        raise SystemExit(__doc__)
    begin, end = (text.replace("tosses", "front") for text in (BEGIN, END)) if options else (BEGIN, END)
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(begin)
    _, tail = rest.split(end)
    PAGE.write_text(f"{head}{begin}\n{table(Path(folder), front=bool(options))}\n{end}{tail}", encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
