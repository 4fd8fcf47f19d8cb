"""What users ask of a simulator first, and the answers as cells: does it repeat itself, is it valid, is it sound?"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import Cell, Column, Tone
from gpusimbench.evaluator.render.numbers import distance, figure, interval
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.results.canonical import Law, Unmeasured
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.group_metrics import REGIME, W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_ENVS, DISTINCT_RUNS, ENDS, identical
from gpusimbench.evaluator.results.joint_metrics import BETWEEN_ENVS, BETWEEN_RUNS
from gpusimbench.evaluator.results.joint_metrics import TO_REFERENCE as JOINTS_TO_REFERENCE
from gpusimbench.evaluator.results.metric import Metric
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import TOSS_FACE, TOSS_LOCAL_POSITION, TOSS_POSITION, TOSS_ROTATION
from gpusimbench.evaluator.runs.labels import parts_of
from gpusimbench.evaluator.runs.physics.facts import NEWEST
from gpusimbench.schemas.text import cut, few, plural
from gpusimbench.schemas.treatment import Intervention

Results = Sequence[GroupResult]

_DEFAULT = "default"
_UNMEASURED = 3  # laws that a note names
NOT_COMPARED = "not compared"
"""The answer where nothing could be compared."""
TIMED = "timed"
"""After an answer: no states were captured, and those that the timed phase hashed were compared."""
_MEANING = f"{TIMED}: at the {ENDS}, where no states were captured"


@dataclass(frozen=True)
class Question:
    """A question to some groups of one simulator, and how it is answered.

    title    as a column's heading
    meaning  when the answer is yes
    answer   for one group, or for several at once
    brief    the title where there is little room; empty: the same
    """

    title: str
    meaning: str
    answer: Callable[[Results], Cell]
    brief: str = ""

    @property
    def column(self) -> Column:
        """A column of answers."""
        return Column(self.title, self.meaning)


def usual(results: Results) -> list[GroupResult]:
    """Without groups of runs that were made to answer a question of gsb-probe, and nothing else; all, if all are."""
    return [r for r in results if not for_probe(r)] or list(results)


def for_probe(result: GroupResult) -> bool:
    """Whether the runs of a group answer a question of gsb-probe, and nothing else."""
    key = result.group.key
    # states that a user gave are no probe's, nor are those that a scene with laws in closed form draws
    initial = key.told["initial"]
    own = initial and not initial.startswith("states:") and not judged(result)
    done = Intervention.of(key.told["intervention"])
    changed = done and done.kind.probed
    return bool(changed or (own and isinstance(result.metrics[FPS.name].value, Missing)))


def judged(result: GroupResult) -> list[Law]:
    """The laws in closed form of a group that have a verdict."""
    return [law for law in result.laws if isinstance(law, Law) and law.held is not None]


def kept(results: Results) -> Cell:
    """Whether the laws in closed form hold; the notes say of how many, and what was not measured in which groups."""
    found = [law for result in results for law in judged(result)]
    if not found:
        return Cell(NOT_COMPARED, tone=Tone.QUIET)
    broken = sum(not law.held for law in found)
    left = (*_unjudged(results), *_unmeasured(results))
    if broken:
        notes = (f"{broken} of {plural(len(found), 'law')} broken", *left)
        return Cell("no", notes=notes, tone=Tone.BAD, link="canonical")
    laws = plural(sum(isinstance(law, Law) or bool(law.key) for result in results for law in result.laws), "law")
    held = f"{len(found)} of {laws}" if left else f"all {laws}"
    return Cell("yes", notes=(held, *left), tone=Tone.WARNING if left else Tone.GOOD, link="canonical")


def _unjudged(results: Results) -> Iterator[str]:
    if number := sum(isinstance(law, Law) and law.held is None for result in results for law in result.laws):
        yield f"{number} without a verdict"


def _unmeasured(results: Results) -> Iterator[str]:
    """The laws that could not be measured, each with the number of groups of its scene where that is so."""
    groups = Counter(r.group.key.scene for r in results)
    missing = Counter(
        title for r in results for title in {(law.scene, law.title) for law in r.laws if isinstance(law, Unmeasured)}
    )
    said = [
        title if number == groups[scene] else f"{title} in {number} of {plural(groups[scene], 'group')}"
        for (scene, title), number in missing.items()
    ]
    if said:
        yield f"not measured: {few(said, _UNMEASURED, by='; ')}"


def repeats(results: Results) -> Cell:
    """Whether all runs of a group have the same bits."""
    return _identity(results, DISTINCT_RUNS, (W1_RUN_TO_RUN, *BETWEEN_RUNS), "runs")


def alike(results: Results) -> Cell:
    """Whether all environments of a run have the same bits."""
    return _identity(results, DISTINCT_ENVS, (W1_PARALLEL, *BETWEEN_ENVS), "envs")


def meaning_of_cm(shown: Iterable[str], results: Results) -> str:
    """What the centimetres of these answers are; empty where none has a W1: those of sliding joints are no W1."""
    if not any(known(r.metrics[metric.name].value) for r in results for metric in (W1_PARALLEL, W1_RUN_TO_RUN)):
        return ""
    there = any(re.fullmatch(r"no, .* cm", said) for said in shown)
    return "cm: W1, the mean distance by which bodies must be moved to turn one outcome into another" if there else ""


def valid(results: Results) -> Cell:
    """Whether the steps did all of their work, as far as the engine tells."""
    runs = [run for r in results for run in r.group.recordings]
    invalid = sum(run.status == "invalid" for run in runs)
    counted = [r.validity.misplaced for r in results if r.validity.misplaced]
    number = sum(one.n_run for one in counted)
    misplaced = (f"{number} of {plural(sum(one.of for one in counted), 'run')}: misplaced contacts",) if number else ()
    if invalid:
        return Cell("no", notes=(f"{invalid} of {len(runs)} INVALID", *misplaced), tone=Tone.BAD)
    other = sum(not run.usable for run in runs)
    failed = (f"{other} of {plural(len(runs), 'run')} failed",) if other else ()
    if misplaced:
        return Cell("no", notes=(*misplaced, *failed), tone=Tone.BAD)
    if other == len(runs):
        return Cell("not known", notes=failed, tone=Tone.QUIET)
    if all(r.validity.overflow is None for r in results):
        why = "overflow is not reported" if len(results) == 1 else "not reported"
        return Cell("not known", notes=(why, *failed), tone=Tone.QUIET)
    if any(r.group.complete and r.validity.overflow is None for r in results):
        failed = ("partly not reported", *failed)
    return Cell("yes", notes=failed, tone=Tone.WARNING if failed else Tone.GOOD)


def sound(results: Results) -> Cell:
    """Whether states keep to mechanics."""
    checked = [r for r in results if r.fidelity.checkable]
    broken = [r for r in checked if r.fidelity.of(CheckVerdict.BROKEN)]
    if not checked:
        return Cell("not checked", tone=Tone.QUIET)
    if not broken:
        held, not_made = sum(r.fidelity.held for r in checked), sum(r.fidelity.not_checkable for r in checked)
        return Cell("yes", notes=(f"{plural(held, 'check')} held, {not_made} not checkable",), tone=Tone.GOOD)
    names = dict.fromkeys(row.check.title for r in broken for row in r.fidelity.of(CheckVerdict.BROKEN))
    if len(results) == 1:
        return Cell("no", notes=(f"broken: {'; '.join(names)}",), tone=Tone.BAD)
    return Cell("no", notes=(f"broken in {len(broken)} of {plural(len(checked), 'group')}",), tone=Tone.BAD)


def real(results: Results) -> Cell:
    """How far positions are from the reference: the smallest and the largest distance of the groups [cm].

    Against measured tosses it is the error of position, which compares each toss with its own simulation; of runs that
    are set to measured states on the way, the smallest local error. Without positions, it is that of joints [rad], or
    of joints that slide [cm].
    """
    tossed = [r.metrics[TOSS_POSITION.name] for r in results if known(r.metrics[TOSS_POSITION.name].value) is not None]
    if len(results) == 1 and tossed:
        others = [results[0].metrics[metric.name] for metric in (TOSS_ROTATION, TOSS_FACE)]
        said = (f"{m.metric.title} {figure(v, m.unit)} {m.unit}" for m in others if (v := known(m.value)) is not None)
        error = known(tossed[0].value) or 0.0
        notes = (f"of {tossed[0].n} tosses", *said)
        return Cell(f"{distance(error)} cm", error, tossed[0].ci95 or None, interval(tossed[0]), notes)
    local = [r.metrics[TOSS_LOCAL_POSITION.name] for r in results]
    local = [found for found in local if known(found.value) is not None]
    if local and not tossed:
        error, rows = min((known(found.value) or 0.0, found.of(OverTosses).rows) for found in local)
        return Cell(f"{distance(error)} cm after {plural(rows or 0, 'row')}", error)
    found = tossed or [r.metrics[W1_REAL.name] for r in results]
    values = sorted(value for one in found if (value := known(one.value)) is not None)
    if not values:
        return _joints_to_reference(results)
    span = distance(values[0]) if values[0] == values[-1] else f"{distance(values[0])} to {distance(values[-1])}"
    return Cell(f"{span} cm", values[0])


def _joints_to_reference(results: Results) -> Cell:
    for metric in JOINTS_TO_REFERENCE:
        values = sorted(value for r in results if (value := known(r.metrics[metric.name].value)) is not None)
        if values:
            span = " to ".join(dict.fromkeys(figure(value, metric.unit) for value in (values[0], values[-1])))
            return Cell(f"{span} {metric.unit}", values[0])
    return Cell(NOT_COMPARED, tone=Tone.QUIET)


QUESTIONS = (
    Question(
        "repeats itself",
        "yes: all runs of a configuration have the same bits at every step; no: largest W1 between runs, or "
        f"distance in joint space; {_MEANING}",
        repeats,
        "repeats",
    ),
    Question(
        "envs alike",
        "yes: all environments of a run have the same bits at every step; no: largest W1 between envs, or "
        f"distance in joint space; {_MEANING}",
        alike,
    ),
    Question(
        "valid",
        "yes: no run dropped contacts or constraints, or has contacts outside of their bodies, as far as the engine "
        "reports it",
        valid,
    ),
    Question(
        f"mechanics, {NEWEST.value}",
        f"yes: every check of mechanics that could be made holds, by the tolerances of {NEWEST.value}",
        sound,
        NEWEST.value,
    ),
)
"""Asked of every simulator."""

LAWS = Question("laws in closed form", "yes: what is known exactly of a motion comes out, where there is a law", kept)

TO_REFERENCE = Question(
    "distance to the reference",
    "W1 to the reference, or distance in joint space, at the sample time, best to worst",
    real,
    "distance",
)


def _identity(results: Results, counted: Metric, apart: Sequence[Metric], what: str) -> Cell:
    """Yes or no by bits at the default level, with how many and how far apart; then the levels at which it is yes.

    apart  distances, of which the first that any group has is shown
    """
    usual = [r for r in results if r.group.key.determinism == _DEFAULT] or list(results)
    claims = [(r, identical(r.metrics[counted.name])) for r in usual]
    compared = [(r, claim.holds) for r, claim in claims if claim.holds is not None]
    notes = _levels([r for r in results if r not in usual], counted)
    if not compared:
        reasons = {claim.why_not for _, claim in claims}
        why = reasons.pop() if len(reasons) == 1 else ""
        return Cell(NOT_COMPARED, notes=(*([cut(why, 80)] if why else []), *notes), tone=Tone.QUIET)
    differ = [r for r, holds in compared if not holds]
    n = compared[0][0].metrics[counted.name].n
    timed = [said for r, _ in compared if (said := words.timed_steps(r.metrics[counted.name]))]
    mark = f", {TIMED}" if len(timed) == len(compared) else ""
    at = list(dict.fromkeys(timed)) if mark else [f"{len(timed)} of them at steps of the timed phase"] if timed else []
    if not differ:
        how = f"all {n} {what}" if len(compared) == 1 else f"all {len(compared)} groups"
        if left := sum(bool(r.group.complete) for r, claim in claims if claim.holds is None):
            how = f"{how}, {plural(left, 'group')} not compared"
        return Cell(f"yes{mark}", notes=(how, *at, *notes), tone=Tone.GOOD)
    # a distance of zero is left out: W1 is in the plane, and what differs may be heights or orientations
    said = next((f"no, {far:.3g} {m.unit}" for m in apart if (far := _farthest(differ, m))), f"no{mark}")
    if len(compared) > 1:
        where = _option_of([r for r, holds in compared if holds], differ)
        return Cell(said, notes=(f"{len(differ)} of {len(compared)} groups", *at, *where, *notes), tone=Tone.BAD)
    value = known(differ[0].metrics[counted.name].value) or 0.0
    return Cell(said, notes=(f"{value:.0f} distinct of {n}", *at, *notes), tone=Tone.BAD)


def _option_of(holding: Results, differing: Results) -> list[str]:
    """The first option in their labels that all groups with a "yes" share and no other group has, in a line."""
    held, others = ([parts_of(r.label)[1] for r in some] for some in (holding, differing))
    shared = [part for part in held[0] if "=" in part and all(part in parts for parts in held)] if held else []
    return [f"yes with {option}" for option in shared if not any(option in parts for parts in others)][:1]


def _farthest(results: Results, metric: Metric) -> float | None:
    values = [found for r in results if (found := known(r.metrics[metric.name].value)) is not None]
    return max(values, default=None)


def _levels(results: Results, counted: Metric) -> list[str]:
    """At which levels of determinism beside the default all groups are bit-identical, in a line."""
    held = [
        level
        for level in dict.fromkeys(r.group.key.determinism for r in results)
        if all(identical(r.metrics[counted.name]).yes for r in results if r.group.key.determinism == level)
    ]
    if not held:
        return []
    return [f"yes at {held[0]}" if len(held) == 1 else f"yes at {len(held)} levels"]


def another_run(result: GroupResult) -> str:
    """Where all runs agree: what is not excluded of one more; empty where they do not."""
    again = words.resampled(result.metrics[REGIME.name])
    return words.another(again) if again and again.agreement else ""
