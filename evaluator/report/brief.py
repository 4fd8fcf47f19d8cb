"""What gsb-eval prints by default: the verdict first, one group in at most 15 lines, several in a line each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.probe.arms import name_of
from gpusimbench.evaluator.probe.finding import verdict_of
from gpusimbench.evaluator.render.document import EMPTY, NONE, Block, Cell, Document, Facts, Text, Tone, facts, table
from gpusimbench.evaluator.render.numbers import estimate
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.leaders import Fastest, fastest, not_ranked
from gpusimbench.evaluator.report.sections.convergence import sentence
from gpusimbench.evaluator.report.sections.episodes import counts_of, mean_of
from gpusimbench.evaluator.report.sections.mechanics import laws_sentence
from gpusimbench.evaluator.report.sections.scaling import sentence as sweep_sentence
from gpusimbench.evaluator.report.verdicts import (
    NOT_COMPARED,
    QUESTIONS,
    TIMED,
    TO_REFERENCE,
    Question,
    another_run,
    meaning_of_cm,
    usual,
)
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.results.fidelity import DEMANDED, CheckVerdict
from gpusimbench.evaluator.results.group_metrics import W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_RUNS, identical
from gpusimbench.evaluator.results.joint_metrics import BETWEEN_ENVS, BETWEEN_RUNS
from gpusimbench.evaluator.results.joint_metrics import TO_REFERENCE as JOINTS_TO_REFERENCE
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import TOSS_LOCAL_POSITION
from gpusimbench.evaluator.runs.groups import shown_ending
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.physics.facts import NEWEST
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import cut, few, first, plural

_SHORT = "* "
"""Before a throughput that was timed for less than the protocol asks; numbers stay in line."""

_NOTES, _EPISODES, _QUESTIONS, _PASSED, _LABEL, _REASON = 2, 8, 3, 4, 120, 240
_PLACE = ("scene", "device")
"""What names a table where there are several."""

_TASKS = "Success rate and return with intervals: gsb-episodes{}. First difference of two recordings: gsb-diff A B."
_ACROSS = ", by number of environments with --across n_env"

MORE = "Everything: gsb-eval --all. A report with figures: gsb-eval --html DIR."


def brief(evaluation: Evaluation) -> Document:
    """The document of a terminal's first page."""
    results = evaluation.results
    body: list[Block] = [_one(results[0])] if len(results) == 1 else [*_several(evaluation)]
    if any(result.timed.unreliable for result in usual(results)):
        body.append(Text(f"{_SHORT}{timed.TOO_SHORT}", Tone.WARNING))
    body += [Text(laws_sentence(result.laws)) for result in usual(results) if result.laws]
    if numbers := {result.group.key.n_env for result in results if counts_of(result)}:
        body.append(Text(_TASKS.format(_ACROSS if len(numbers) > 1 else ""), Tone.QUIET))
    return Document(
        _verdict(evaluation),
        (*body, *_troubles(evaluation), Text(MORE, Tone.QUIET)),
    )


def _verdict(evaluation: Evaluation) -> str:
    results = evaluation.results
    if len(results) == 1:
        return f"{results[0].label}: {_says(results[0])}"
    claims = [identical(r.metrics[DISTINCT_RUNS.name]).holds for r in results]
    said = [words.repeating(claims)] if set(claims) - {None} else []
    invalid = sum(any(run.status == "invalid" for run in r.group.recordings) for r in results)
    if invalid:
        said.append(f"{plural(invalid, 'group')} with INVALID runs")
    misplaced = sum(bool(faults(r).misplaced) for r in results)
    if misplaced:
        said.append(f"{plural(misplaced, 'group')} with misplaced contacts")
    return f"{plural(len(results), 'group')}: " + "; ".join(said or [_why_none(results)])


def _why_none(results: Sequence[GroupResult]) -> str:
    """Why it is not known of any group whether it repeats itself."""
    several = [r for r in results if len(r.group.complete) > 1]
    if not any(r.group.complete for r in results):
        return "no run is complete"
    why = dict.fromkeys(identical(r.metrics[DISTINCT_RUNS.name]).why_not for r in several)
    return f"runs were not compared: {'; '.join(why)}" if several else "no group has several runs to compare"


def _says(result: GroupResult) -> str:
    holds = identical(result.metrics[DISTINCT_RUNS.name])
    n = result.metrics[DISTINCT_RUNS.name].n
    if holds.holds is None:
        return f"whether it repeats itself is not known: {holds.why_not}"
    at = words.timed_steps(result.metrics[DISTINCT_RUNS.name])
    return (f"all {n} runs are bit-identical" if holds.holds else f"{n} runs, and not all are bit-identical") + (
        f" {at}" if at else ""
    )


def _one(result: GroupResult) -> Facts:
    answers = [(q.title, _joined(q.answer([result]))) for q in QUESTIONS]
    if any(
        known(result.metrics[metric.name].value) is not None
        for metric in (W1_REAL, TOSS_LOCAL_POSITION, *JOINTS_TO_REFERENCE)
    ):
        answers.append((TO_REFERENCE.title, _joined(TO_REFERENCE.answer([result]))))
    figures = [
        (metric.titled, _line(_fps(result) if metric is FPS else estimate(result.metrics[metric.name])))
        for metric in METRICS.values()
        if metric.axis in (Axis.THROUGHPUT, Axis.MEMORY, Axis.BUILD)
        and not isinstance(result.metrics[metric.name].value, Missing)
    ]
    apart = [
        (metric.titled, _line(estimate(result.metrics[metric.name])))
        for metric in (W1_PARALLEL, W1_RUN_TO_RUN, *BETWEEN_ENVS, *BETWEEN_RUNS)
        if known(result.metrics[metric.name].value)
    ]
    one_more = another_run(result)
    key, runs = result.group.key, plural(len(result.group.complete), "complete run")
    return facts(
        ("recorded", f"{key.scene}, {plural(key.n_env, 'env')}, {runs}, {key.device or 'no device'}"),
        *answers,
        *([("one run more", one_more)] if one_more else []),
        *([("episodes", said)] if (said := _episodes(result)) else []),
        *apart,
        *figures[:4],
    )


def _episodes(result: GroupResult) -> str:
    runs = counts_of(result)
    ended = sum(run.ended for run in runs)
    if not runs:
        return ""
    if not ended:
        n_env = result.group.key.n_env
        steps = plural(max(run.steps for run in runs) // n_env, "recorded step", spec=",")
        again = f" in each of {len(runs)} runs" if len(runs) > 1 else ""
        return f"none ended within the {steps} of {plural(n_env, 'environment', spec=',')}{again}"
    length, total = (mean_of(runs, name) for name in ("mean_length", "mean_return"))
    returned = "" if total is None else f", mean return {total:.4g}"
    return f"{ended:,} ended in {plural(len(runs), 'run')}, mean length {length:.4g} steps{returned}"


def _several(evaluation: Evaluation) -> Iterator[Block]:
    results = usual(evaluation.results)
    questions = [*QUESTIONS, *([TO_REFERENCE] if evaluation.reference else [])]
    titles = ["", "envs x runs", *(q.brief or q.title for q in questions), FPS.unit]
    given = options_given(run for r in results for run in r.group.recordings)
    several = len({r.group.key.scene for r in results}) > 1
    named = labels([r.group.key for r in results], given, beside=("n_env", *(_PLACE if several else ())))
    tables: dict[str, list[list[Cell | str]]] = {}
    for result, name in zip(results, named, strict=True):
        key = result.group.key
        place = f"{key.scene} on {key.device or 'an unknown device'}" if several else ""
        tables.setdefault(place, []).append(
            [
                name,
                f"{key.n_env:,} x {len(result.group.complete)}",
                *(_text(q.answer([result])) for q in questions),
                _text(_fps(result)),
            ]
        )
    made = [table("groups", place, titles, rows) for place, rows in tables.items()]
    made = [one.without_empty_columns() for one in made] if several else made
    yield from made
    if said := _signs([row.cells for one in made for row in one.rows], results):
        yield Text(said, Tone.QUIET)
    if said := _not_compared(questions, results):
        yield Text(said, Tone.QUIET)
    if said := _behind_a_yes(results):
        yield Text(said, Tone.QUIET)
    yield from (Text(said, Tone.BAD) for said in first(list(_incomplete(results)), _NOTES, " with such runs"))
    told = [f"{result.label}: episodes: {said}" for result in results if (said := _episodes(result))]
    yield from map(Text, first(told, _EPISODES, " groups with episodes"))
    for result in results:
        speed = result.metrics[FPS.name]
        if (mean := known(speed.value)) is not None and (speeds := speed.of(Throughput).speeds):
            yield Text(f"{result.label}: {speeds.note(mean)}", Tone.WARNING)
    notes = gathered((note, result.label) for result in results for note in result.doubts)
    yield from (Text(f"{few(of, _PASSED)}: {note}", Tone.WARNING) for note, of in notes.items())
    if hidden := len(evaluation.results) - len(results):
        yield Text(f"{plural(hidden, 'group')} of runs that only gsb-probe needs: --all", Tone.QUIET)
    for asked in evaluation.probed:
        answers = verdict_of(asked.findings, named=_QUESTIONS)
        yield Text(f"questions of gsb-probe, {name_of(asked.arms)}: {answers}")
    for sweep in evaluation.sweeps:
        if sweep.long and sweep.measured:
            yield Text(sweep_sentence(sweep))
    for family in evaluation.convergences:
        yield Text(sentence(family))
    yield from (Text(_fastest(one, results)) for one in fastest(results) if one.first or one.faster)


def _incomplete(results: Sequence[GroupResult]) -> Iterator[str]:
    """Of each group with runs from which nothing is computed, how many these are and what ended the first."""
    for result in results:
        runs = result.group.recordings
        if ended := [run for run in runs if run.status != "complete"]:
            of_all = f"{len(ended)} of {plural(len(runs), 'run')} not complete"
            yield cut(f"{result.label}: {of_all}: {shown_ending(ended[0])}", _REASON)


def _signs(rows: Sequence[Sequence[Cell | str]], results: Sequence[GroupResult]) -> str:
    """What the signs in these rows of the table mean; empty where it has none."""
    shown = [cell.text if isinstance(cell, Cell) else cell for row in rows for cell in row]
    meanings = (
        (NONE in shown, f"{NONE}: not known or not reported"),
        (bool(centimetres := meaning_of_cm(shown, results)), centimetres),
        (any(said.endswith(" x 0") for said in shown), "x 0: no complete run"),
        (
            any(said.endswith(f", {TIMED}") for said in shown),
            f"{TIMED}: at the first and last step of the timed phase; no states were captured",
        ),
    )
    return "; ".join(meaning for there, meaning in meanings if there)


def _not_compared(questions: Sequence[Question], results: Sequence[GroupResult]) -> str:
    """Questions that are not compared in any row, each with a reason; empty if no such question has a known reason."""
    said = []
    for question in questions:
        answers = [question.answer([result]) for result in results]
        reasons = dict.fromkeys(note for answer in answers for note in answer.notes)
        if reasons and all(answer.text == NOT_COMPARED for answer in answers):
            said.append(f"{question.brief or question.title} ({few(list(reasons), 1)})")
    return f"not compared: {', '.join(said)}" if said else ""


def _behind_a_yes(results: Sequence[GroupResult]) -> str:
    """How many checks of mechanics a yes of the table stands for; empty where no group has one."""
    made = [r.fidelity for r in results if r.fidelity.checkable and not r.fidelity.of(CheckVerdict.BROKEN)]
    if not made:
        return ""
    low, high = min(f.held for f in made), max(f.held for f in made)
    held = f"{low}" if low == high else f"{low} to {high}"
    return f"{NEWEST.value}: a yes stands for {held} of {DEMANDED} checks; the others could not be made: --all"


def _fastest(found: Fastest, results: Sequence[GroupResult]) -> str:
    """Who is named, and who was faster: a reader finds the rows of both in the table above."""
    where = f"{found.scene} on {found.device or 'an unnamed device'}"
    said = f"Fastest valid simulator in {where}: "
    said += f"{found.first.result.label}, {found.first.said}" if found.first else "none"
    said += " (mechanics not checked)" if found.first and found.first.unchecked else ""
    if rival := found.rival:
        said += f"; not shown to be slower: {rival.result.label}, {rival.said}"
    passed = [f"{few([r.label for r in those], _PASSED)} ({why})" for why, those in not_ranked(found, results).items()]
    faster = "faster, but not ranked" if found.first else "not ranked"
    said += f"; {faster}: {'; '.join(passed)}" if passed else ""
    others = few([speed.result.label for speed in found.other_steps], _PASSED)
    return said + (f"; not compared, timed over other steps: {others}" if others else "")


def _troubles(evaluation: Evaluation) -> Iterator[Text]:
    for failure in evaluation.unreadable[:3]:
        yield Text(f"left out: {failure.error.advised}", Tone.BAD)
    if len(evaluation.unreadable) > 3:
        yield Text(f"left out: {len(evaluation.unreadable) - 3} more files that cannot be read", Tone.BAD)
    runs = [run for result in evaluation.results for run in result.group.recordings]
    unsure = {run.path.name: why for run in runs if (why := run.unconfirmed)}
    for name, why in list(unsure.items())[:1]:  # before the notes, of which only some are printed
        more = f", and {plural(len(unsure) - 1, 'file')} more" if len(unsure) > 1 else ""
        yield Text(f"note: {name} is {why}{more}", Tone.WARNING)
    own = evaluation.results[0].notes if len(evaluation.results) == 1 else ()
    notes = [*evaluation.notes, *(note for note in own if not note.endswith(tuple(unsure.values())))]
    for note in notes[:_NOTES]:
        yield Text(f"note: {note}", Tone.WARNING)
    if len(notes) > _NOTES:
        yield Text(f"{plural(len(notes) - _NOTES, 'more note')}: --all", Tone.WARNING)
    lines = timed.incomparable(evaluation.results)
    for line in lines[:1]:
        yield Text(line, Tone.WARNING)
    if len(lines) > 1:
        yield Text(f"{len(lines) - 1} more reasons why throughputs cannot be compared: --all", Tone.WARNING)
    if reference := evaluation.reference:
        distance = "W1 to" if reference.positions.size else "in joint space, to"
        what = "mean error of position against" if reference.tosses else distance
        yield Text(f"distance: {what} {cut(reference.label, _LABEL)}", Tone.QUIET)
    elif not evaluation.of_programs:
        yield Text(f"no distance to reality: {evaluation.reference_note}", Tone.QUIET)


def _joined(said: Cell) -> Cell:
    """A verdict and what stands below it on one line."""
    return Cell(": ".join([_with_interval(said), *(["; ".join(said.notes)] if said.notes else [])]), tone=said.tone)


def _line(said: Cell) -> Cell:
    return Cell(_with_interval(said), tone=said.tone)


def _with_interval(said: Cell) -> str:
    """The text with its interval by name: there is no heading here that tells what brackets are."""
    return f"{said.text}, 95 % interval {said.range}" if said.range else said.text


def _fps(result: GroupResult) -> Cell:
    """The throughput, with a sign where it was timed for less than the protocol asks."""
    said = estimate(result.metrics[FPS.name])
    return replace(said, text=f"{_SHORT}{said.text}") if result.timed.unreliable else said


def _text(said: Cell) -> Cell:
    return EMPTY if said.tone is Tone.QUIET else Cell(said.text, said.value, tone=said.tone)
