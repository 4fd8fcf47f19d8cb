"""Redraws tables of README.md, docs/determinism.md, docs/probe-results.md and of the cards of recordings from GPUs.

usage: python docs/make_h200.py
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from page_blocks import redraw
from run_names import name_of_engine, name_of_run

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.probe.finding import Answer, Finding
from gpusimbench.evaluator.probe.questions import QUESTIONS, probed
from gpusimbench.evaluator.read.known_errors import PREFIX, known_errors
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Cell
from gpusimbench.evaluator.render.markdown import table_markdown
from gpusimbench.evaluator.render.numbers import distance, figure, mean_sd
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.sections.determinism_cost import of_family, ratio
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.words import EXCHANGED, exchanged, model
from gpusimbench.evaluator.results.details import DistinctEnvs
from gpusimbench.evaluator.results.determinism_cost import DEFAULT, price_list
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.identity_metrics import identical
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.sweeps import Sweep, SweepPoint
from gpusimbench.evaluator.runs.groups import GroupKey

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "recordings" / "h200"
OF_PROTOCOL = (ROOT / "recordings" / "h100", ROOT / "recordings" / "protocol-h200")
SWEPT = ROOT / "recordings" / "sweeps-h100"
PROBED = (ROOT / "recordings" / "probe", ROOT / "recordings" / "probe-h100")
_SCENE = "inclined-collision"
_NONE = "-"


def shipped() -> Evaluation:
    """The evaluation of the set of levels."""
    return evaluate_files(sorted(FOLDER.glob("*.mcap")))


def of_protocol(folder: Path) -> list[Path]:
    """Runs that were made by the protocol."""
    return [path for path in sorted(folder.glob("*.mcap")) if "dense" not in path.name]


def on_h200() -> Evaluation:
    """The evaluation of all that an H200 did in inclined-collision."""
    return evaluate_files([*sorted(FOLDER.glob(f"*{_SCENE}*.mcap")), *of_protocol(OF_PROTOCOL[1])])


def _who(result: GroupResult) -> str:
    recording = result.group.recordings[0]
    given = recording.configuration.options
    in_force = recording.simulation.options if recording.simulation else given
    return name_of_run(result.group.key.simulator, given, in_force)


def _of(result: GroupResult, name: str) -> str:
    metric = result.metrics[name]
    return _NONE if isinstance(metric.value, Missing) else f"{metric.value:.0f} of {metric.n}"


def _value(result: GroupResult, name: str) -> str:
    metric = result.metrics[name]
    return _NONE if isinstance(metric.value, Missing) else distance(metric.value)


def _outcome(result: GroupResult) -> str:
    endings = {f"{r.status}: {r.cause}" for r in result.group.recordings if not r.usable}
    sank = known(result.metrics["sank"].value)
    return "; ".join([*sorted(endings), *([f"{figure(sank, '')} of 27 cubes sank"] if sank else [])])


def _fell(result: GroupResult) -> str:
    left = known(result.metrics["left_board"].value)
    return _NONE if left is None else figure(left, "")


def verdicts(evaluation: Evaluation) -> str:
    """Who repeats itself and how far envs and runs are apart, and how fast it is, as two Markdown tables."""
    results = [r for r in evaluation.results if r.group.key.scene == _SCENE]
    results.sort(key=lambda r: (_who(r), r.group.key.determinism != DEFAULT))
    measured = [r for r in results if not isinstance(r.metrics["fps"].value, Missing)]
    remarks = timed.remarks(measured, named=lambda r: f"{_who(r)} ({r.group.key.determinism})")
    remarks += _known_errors(results)
    return "\n".join([*_sameness(results), "", *_speed(measured, results), "", *(f"* {line}" for line in remarks)])


def _known_errors(results: Sequence[GroupResult]) -> list[str]:
    found: dict[str, list[str]] = {}
    for result in results:
        for error in {error for run in result.group.recordings for error in known_errors(run)}:
            found.setdefault(error.said, []).append(f"{_who(result)} ({result.group.key.determinism})")
    return [f"{PREFIX}{said}: {', '.join(dict.fromkeys(of))}" for said, of in found.items()]


def _rows(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}", *(f"| {' | '.join(row)} |" for row in rows)]


def _named(result: GroupResult) -> tuple[str, str]:
    return f"{_who(result)} {result.group.key.version}".strip(), result.group.key.determinism


def _sameness(results: Sequence[GroupResult]) -> list[str]:
    titles = (
        "simulator", "determinism", "distinct envs", "envs differ from step", "distinct runs", "type",
        "cubes of 27 off the board", "W1 envs [cm]", "W1 envs, clamped", "W1 runs [cm]", "W1 runs, clamped", EXCHANGED,
        "what else",
    )  # fmt: skip
    rows = []
    for result in results:
        first = result.metrics["distinct_envs"].of(DistinctEnvs).first_difference_step
        rows.append((
            *_named(result),
            _of(result, "distinct_envs"),
            _NONE if first is None else str(first),
            _of(result, "distinct_runs"),
            _NONE if (kind := known(result.metrics["regime_published"].value)) is None else f"{kind:.0f}",
            _fell(result),
            _value(result, "w1_parallel"),
            _value(result, "w1_parallel_clamped"),
            _value(result, "w1_run_to_run"),
            _value(result, "w1_run_to_run_clamped"),
            exchanged(result.metrics["w1_run_to_run"]),
            _outcome(result),
        ))  # fmt: skip
    return _rows(titles, rows)


def _speed(measured: Sequence[GroupResult], results: Sequence[GroupResult]) -> list[str]:
    prices = _prices(results)
    columns = timed.columns(r.timed for r in measured)
    titles = ("simulator", "determinism", "env-steps/s", *(column.title for column in columns), "of default")
    rows = []
    for result in measured:
        fps = result.metrics["fps"]
        rows.append((
            *_named(result),
            f"{known(fps.value) or 0.0:,.0f}",
            *timed.cells(columns, result.timed),
            prices.get(result.label, _NONE),
        ))  # fmt: skip
    return _rows(titles, rows)


def _prices(results: Sequence[GroupResult]) -> dict[str, str]:
    """Throughput over that of the default, by label, of groups with such a price and of the defaults themselves."""
    found: dict[str, str] = {}
    for family in price_list(results):
        if family.base is not None:
            found[family.base.label] = "1"
        found |= {price.result.label: ratio(price.speed) for price in family.prices}
    return found


def switches(evaluation: Evaluation) -> str:
    """What levels of determinism change and cost, where several were recorded, as a Markdown table."""
    results = [r for r in evaluation.results if r.group.key.scene == _SCENE]
    prices = _prices(results)
    lines = [
        "| simulator | determinism | distinct envs | distinct runs | type | throughput, times default | timed steps "
        f"| seconds timed | open in {PROTOCOL} |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for family in price_list(results):
        for result in of_family(family):
            kind = known(result.metrics["regime_published"].value)
            cells = [
                _who(result),
                result.group.key.determinism,
                _of(result, "distinct_envs"),
                _of(result, "distinct_runs"),
                _outcome(result) if kind is None else f"{kind:.0f}",
                prices[result.label],
                timed.steps(result.timed),
                timed.seconds(result.timed),
                ", ".join(result.timed.unmet.findings) or "nothing",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _best(sweep: Sweep) -> SweepPoint:
    return max(sweep.points, key=lambda point: (known(point.result.metrics["fps"].value) or 0.0, point.n_env))


def _memory(sweep: Sweep) -> str:
    found = sweep.models.get(sweep.memory)
    return model(found) if found else _NONE


def _sweeps(evaluation: Evaluation) -> list[Sweep]:
    return sorted(evaluation.sweeps, key=lambda sweep: (sweep.key.scene, sweep.label))


def sweeps(evaluation: Evaluation) -> str:
    """How far each goes, as a Markdown table."""
    columns = timed.ALL
    titles = [
        "scene", "simulator", "N_env^max", "why no further", "most env-steps/s",
        *(column.title for column in columns), "device memory",
    ]  # fmt: skip
    lines = [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}"]
    for sweep in _sweeps(evaluation):
        n_max = _NONE if sweep.n_max is None else f"{sweep.n_max:,}"
        ends = sweep.ends.partition(": RuntimeError")[0]
        best = _best(sweep)
        cells = [
            sweep.key.scene, f"{sweep.label} {sweep.key.version}", n_max, ends,
            f"{known(best.result.metrics['fps'].value) or 0.0:,.0f} at {best.n_env:,}",
            *timed.cells(columns, best.result.timed), _memory(sweep),
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", f"* {timed.LEGEND}"])


def points(evaluation: Evaluation) -> str:
    """Throughput of each number of environments, and whether its runs repeat themselves, as a Markdown table."""
    titles = (
        "scene", "simulator", "N", "runs", "repeats itself", "env-steps/s", "relative SD", "timed steps",
        "seconds timed",
    )  # fmt: skip
    rows = []
    for sweep in _sweeps(evaluation):
        for point in sweep.points:
            fps = point.result.metrics["fps"]
            if (mean := known(fps.value)) is None:
                continue
            share = 100 * (fps.sd or 0.0) / mean
            rows.append((
                sweep.key.scene, sweep.label, f"{point.n_env:,}", str(fps.n), _repeats(point.result), mean_sd(fps),
                f"{share:.1f} %" if share >= 0.05 else f"{share:.1g} %",
                timed.steps(point.result.timed), timed.seconds(point.result.timed),
            ))  # fmt: skip
    return "\n".join(_rows(titles, rows))


def _repeats(result: GroupResult) -> str:
    # all answers of this table are by timed steps, which the text around it says
    count = result.metrics["distinct_runs"]
    claim = identical(count)
    return "yes" if claim.yes else _NONE if claim.holds is None else f"no, {count.value:.0f} distinct"


def answers(evaluation: Evaluation) -> str:
    """What the first screen of a report says of each simulator, as Markdown."""
    results = [r for r in evaluation.results if r.group.key.scene == _SCENE]
    source = Source(replace(evaluation, results=tuple(results)), published=False, command="")
    (table,) = (one for one in report(source).tables() if one.key == "simulators")
    rows = tuple(replace(row, cells=tuple(map(_without_counts, row.cells))) for row in table.rows)
    return table_markdown(replace(table, caption="", rows=rows))


def _without_counts(said: Cell) -> Cell:
    """A cell without the line that counts groups, which a reader of one table cannot know."""
    return replace(said, notes=tuple(note for note in said.notes if not re.search(r"\bgroups?\b", note)))


def invariance() -> str:
    """What the results of each probed configuration depend on, as a Markdown table."""
    asked = probed([Recording(path) for folder in PROBED for path in sorted(folder.glob("*.mcap"))])
    answered = {finding.key for one in asked for finding in one.findings if finding.answer is not Answer.NOT_ASKED}
    keys = [question.key for question in QUESTIONS if question.key in answered]
    rows = [[_probed_name(one.arms.key), _model(one.arms.key), *_answers(one.findings, keys)] for one in asked]
    titles = ["simulator, determinism level", "GPU", *keys]
    lines = [titles, ["---"] * len(titles), *sorted(rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _model(key: GroupKey) -> str:
    """H100 of "NVIDIA H100 80GB HBM3"."""
    return key.device.removeprefix("NVIDIA ").split()[0]


def _probed_name(key: GroupKey) -> str:
    return f"{name_of_engine(key.simulator, json.loads(key.options))}, {key.determinism}"


def _answers(findings: Sequence[Finding], keys: Sequence[str]) -> list[str]:
    found = {finding.key: _answer(finding) for finding in findings}
    return [found.get(key, _NONE) for key in keys]


def _answer(finding: Finding) -> str:
    if finding.answer is Answer.NOT_ASKED:
        return _NONE
    return f"**{finding.answer}**" if finding.answer is Answer.NO else str(finding.answer)


def blocks(evaluation: Evaluation) -> dict[Path, dict[str, str]]:
    """What the pages should show, by the names of their markers."""
    cards = {one / "README.md": {"verdicts": verdicts(evaluate_files(of_protocol(one)))} for one in OF_PROTOCOL}
    swept = evaluate_files(sorted(SWEPT.glob("*.mcap")))
    return cards | {
        FOLDER / "README.md": {"verdicts": verdicts(evaluation)},
        SWEPT / "README.md": {"sweeps": sweeps(swept), "points": points(swept)},
        ROOT / "README.md": {"h200": answers(on_h200())},
        ROOT / "docs" / "determinism.md": {"switches": switches(evaluation)},
        ROOT / "docs" / "probe-results.md": {"probe": invariance()},
    }


def main() -> None:
    """Write them."""
    for file, shown in blocks(shipped()).items():
        redraw(file, shown)
        print(file)


if __name__ == "__main__":
    main()
