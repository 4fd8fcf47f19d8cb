"""Redraws tables of docs/toss-results.md from recordings of the measured tosses, which are not in this project.

usage: python docs/make_tosses.py FOLDER

FOLDER holds what the commands of docs/how-to/cube-toss.md record: the reference, a run of each simulator, and what
gsb-fit --json wrote. A table is redrawn where FOLDER has something for it. It names the SHA-256 of the measured set;
that of whole tosses also names the content hash of each recording, so that whoever makes them again can compare.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from page_blocks import redraw

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.numbers import bounds, figure, interval
from gpusimbench.evaluator.report.leaders import speaks_against_pair
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import (
    TOSS_DEPTH,
    TOSS_END_POSITION,
    TOSS_FACE,
    TOSS_LOCAL_POSITION,
    TOSS_LOCAL_ROTATION,
    TOSS_POSITION,
    TOSS_ROTATION,
    Ranked,
    beaten_by,
    configuration,
    ranked,
)
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses
from gpusimbench.evaluator.statistics.families import holm
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.tosses import ODD

PAGE = Path(__file__).resolve().parent / "toss-results.md"
_SAMPLE_TIME = 441 / 148
_SHOWN = (TOSS_POSITION, TOSS_ROTATION, TOSS_END_POSITION, TOSS_FACE, TOSS_DEPTH)
_FRONT = (TOSS_POSITION, TOSS_ROTATION, TOSS_DEPTH)
_HASH = 12
_RATE_S = 1 / 148


def table(evaluation: Evaluation) -> str:
    """The errors of whole tosses, and what they were made of, as Markdown; empty where no run has any, and where runs
    were timed."""
    order = ranked(evaluation.results)
    if not order or any(one.timed for one in order):
        return ""
    titles = ["simulator", *(metric.titled for metric in _SHOWN), "more than the first [cm]", "recording"]
    tosses = _tosses(evaluation)
    degrees = 180 / 3.141592653589793 * tosses.floor.rotation
    left = f"The measurement itself leaves {100 * tosses.floor.position:.2f} cm and {degrees:.2f} deg."
    return _drawn(titles, [_row(one) for one in order], f"{_named(tosses)} {left}")


def front_table(evaluation: Evaluation) -> str:
    """Throughputs against errors, the fastest first, as Markdown; empty where none was timed."""
    timed = [r for r in evaluation.results if known(r.metrics[FPS.name].value)]
    if not timed:
        return ""
    # the number of environments that most were timed at ranks them; other numbers have columns of their own
    often = Counter(r.group.key.n_env for r in timed)
    n_env, *others = (n for n, _ in often.most_common())
    order = ranked([r for r in evaluation.results if r not in timed or r.group.key.n_env == n_env])
    rates = {(configuration(r), r.group.key.n_env): r.metrics[FPS.name].value for r in timed}
    (device,) = {r.group.key.device for r in timed}
    against = {one.result.label: speaks_against_pair(one, evaluation.results) for one in order}
    better = beaten_by([one for one in order if not against[one.result.label]])
    runs = [run for one in order for run in one.result.group.recordings]
    named = labels([one.result.group.key for one in order], options_given(runs))
    names = {one.result.label: name for one, name in zip(order, named, strict=True)}
    titles = ["simulator", f"env-steps/s, {n_env:,} envs", *(f"{n:,} envs" for n in others), "simulated s/s"]
    titles += [m.titled for m in _FRONT]
    rows = []
    for one in sorted(order, key=lambda one: -one.pace):
        if one.timed is None:
            continue
        label = one.result.label
        verdict = f"not ranked: {against[label]}" if against[label] else "**yes**"
        if beaten := better.get(label):
            verdict = f"no: {names[beaten]} is faster and not measurably less accurate"
        rate = f"{one.fps:,.0f} ({plural(len(one.timed.group.complete), 'run')})"
        estimates = [one.result.metrics[m.name] for m in _FRONT]
        shown = [f"{figure(known(e.value) or 0.0, e.unit)} {interval(e)}" for e in estimates]
        elsewhere = (rates.get((configuration(one.result), n)) for n in others)
        at_others = ["-" if value is None else f"{known(value):,.0f}" for value in elsewhere]
        rows.append([names[label], rate, *at_others, f"{one.pace:,.0f}", *shown, verdict])
    return _drawn([*titles, "on the front"], rows, f"{_named(_tosses(evaluation))} On {device}.")


def local_table(evaluation: Evaluation) -> str:
    """The local errors, a row a simulator and its settings, as Markdown; empty where no run has any."""
    found: dict[str, dict[int, GroupResult]] = {}
    for result in evaluation.results:
        rows = result.metrics[TOSS_LOCAL_POSITION.name].of(OverTosses).rows
        if rows is not None:
            key = result.group.key
            asked = ", ".join(result.group.recordings[0].configuration.option_words)
            per_row = round(_RATE_S / key.dt)
            name = f"{key.simulator}{f' [{asked}]' if asked else ''} {key.version}"
            found.setdefault(f"{name}, {per_row} steps a row" if per_row > 1 else name, {})[rows] = result
    if not found:
        return ""
    every = sorted({rows for by_rows in found.values() for rows in by_rows})
    metrics = (TOSS_LOCAL_POSITION, TOSS_LOCAL_ROTATION)
    columns = [(rows, metric) for metric in metrics for rows in every]
    what = {TOSS_LOCAL_POSITION.name: "position", TOSS_LOCAL_ROTATION.name: "rotation"}
    titles = [f"{what[m.name]} after {rows} row{'s' if rows > 1 else ''} [{m.unit}]" for rows, m in columns]

    def cells(by_rows: dict[int, GroupResult]) -> list[str]:
        shown = []
        for rows, metric in columns:
            estimate = by_rows[rows].metrics[metric.name] if rows in by_rows else None
            value = None if estimate is None else known(estimate.value)
            ends = None if estimate is None else estimate.ci95
            # three digits of either: in fewer, an end would be rounded to the other side of the value
            cell = f"{value:.3g}" if value is not None else "-"
            shown.append(f"{cell} {bounds(ends, '{:.3g}'.format)}" if value is not None and ends else cell)
        return shown

    def middle(by_rows: dict[int, GroupResult]) -> float:
        rows = sorted(by_rows)[len(by_rows) // 2]
        return known(by_rows[rows].metrics[TOSS_LOCAL_POSITION.name].value) or 0.0

    floors = []
    for rows, metric in columns:
        of = (r[rows].metrics[metric.name].of(OverTosses).tracking_floor for r in found.values() if rows in r)
        floor = next(of, None)
        floors.append("-" if floor is None else f"{floor:.2g}")
    body = [[name, *cells(by_rows)] for name, by_rows in sorted(found.items(), key=lambda item: middle(item[1]))]
    body.append(["*the measurement, in free flight*", *floors])
    return _drawn(["simulator", *titles], body, _named(_tosses(evaluation)))


def fits(files: list[Path]) -> str:
    """What gsb-fit --json wrote, a row a fit, as Markdown; empty where there is no file of it."""
    rows, below = [], ""
    read = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    judged = [one for found in read for one in found["compared"] if one["tosses"] == ODD]
    for one, p in zip(judged, holm([one["change"]["p_value"] for one in judged]), strict=True):
        one["change"]["p_value"] = p
    for found in read:
        by = {(one["quantity"], one["tosses"].split()[0]): one for one in found["compared"]}
        even, odd = by["position", "even"], by["position", "odd"]
        turned = by["rotation", "odd"]
        start, end = (", ".join(f"{k}={v}" for k, v in found[which].items()) for which in ("start", "fitted"))
        rows.append([
            found["simulator"], start, end, f"{even['before']:.3f} / {even['after']:.3f}",
            f"{odd['before']:.3f} / {odd['after']:.3f}", _change(odd),
            _change(turned),
        ])  # fmt: skip
        below = f"{found['source']}, SHA-256 `{found['sha256'][:_HASH]}...`. "
        below += "p: sign-flip permutation test, adjusted by Holm's method for all rows and both errors."
    titles = [
        "simulator", "start", "fitted", "position, even tosses, before / after [cm]",
        "position, odd tosses, before / after [cm]", "change on odd tosses [cm]", "of rotation [deg]",
    ]  # fmt: skip
    return _drawn(titles, rows, below) if rows else ""


def _change(one: dict[str, Any]) -> str:
    change = one["change"]
    low, high = change["ci95"]
    return f"{change['mean']:.3f} {bounds((low, high), '{:.3f}'.format)}, p = {change['p_value']:.2g}"


def _drawn(titles: list[str], rows: list[list[str]], below: str) -> str:
    lines = [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join([*lines, "", below])


def _tosses(evaluation: Evaluation) -> MeasuredTosses:
    reference = evaluation.reference
    if reference is None or reference.tosses is None:
        raise SystemExit(f"there is no recording of tosses: {evaluation.reference_note}")
    return reference.tosses


def _named(tosses: MeasuredTosses) -> str:
    return f"{tosses.name()}, SHA-256 `{tosses.known.sha256[:_HASH]}...`."


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
        cells.append(f"{one.against.mean:.2f} {bounds((low, high), '{:.2f}'.format)}, {p}")
    return [*cells, f"`{recording.content_hash[:_HASH]}`"]


def main() -> None:
    """Write the table into the page."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    evaluation = evaluate_files(sorted(Path(sys.argv[1]).rglob("*.mcap")), sample_time=_SAMPLE_TIME)
    drawn = {
        "tosses": table(evaluation),
        "front": front_table(evaluation),
        "local errors": local_table(evaluation),
        "fits": fits(sorted(Path(sys.argv[1]).glob("*.json"))),
    }
    redraw(PAGE, {name: shown for name, shown in drawn.items() if shown})
    print(PAGE)


if __name__ == "__main__":
    main()
