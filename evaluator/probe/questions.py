"""The questions of a probe, and what arms answer to each. A new question is one declaration.

Each asks whether something matters that should not. "Yes" is the answer that one hopes for: nothing differs, bit for
bit. Where runs that were asked for the same differ anyway, a difference tells nothing of its cause, and the answer is
open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from gpusimbench.evaluator.metrics.levels import EqualityLevel
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import Arms, arms_of
from gpusimbench.evaluator.probe.asking import (
    ask_captured,
    ask_devices,
    ask_envs,
    ask_fresh,
    ask_neighbours,
    ask_numbers,
    ask_process,
    ask_runs,
    ask_slots,
    goes_on,
    image_goes_on,
    left_alone,
)
from gpusimbench.evaluator.probe.finding import Answer, Asked, Finding
from gpusimbench.evaluator.probe.pairs import Found
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.fields import ENV


class Probed(NamedTuple):
    """The arms of one configuration, and what they answer, a finding a question."""

    arms: Arms
    findings: list[Finding]


@dataclass(frozen=True)
class Question:
    """A question.

    title   that "yes" answers as one hopes for
    ask     compares; Missing where the arms that it needs are not there
    attributable  a difference has to be told apart from that between runs
    gate    whether "no" is a defect: what decides an engine's next step is its own choice
    asked_of_few  left out of the answers where it was not asked: most probes are of one device
    """

    key: str
    title: str
    ask: Callable[[Arms], Asked | Missing]
    attributable: bool = True
    gate: bool = True
    asked_of_few: bool = False


def probed(recordings: Sequence[Recording]) -> tuple[Probed, ...]:
    """The answers of each configuration among some recordings."""
    return tuple(Probed(arms, answers(arms)) for arms in arms_of(recordings))


def why_nothing_asked(recordings: Sequence[Recording]) -> str:
    """Why recordings answer no question."""
    if any(field.group == ENV for recording in recordings for field in recording.fields):
        return (
            "of recordings of tasks, gsb-probe asks only whether runs repeat, and no two of these recordings have the "
            "same configuration; gsb-diff A B compares the environments that two recordings have in common, "
            "gsb-episodes compares success rates"
        )
    failed = [recording for recording in recordings if recording.status not in ("complete", "incomplete")]
    if recordings and len(failed) == len(recordings):
        return f"no run ended well: {failed[0].path} is {failed[0].status}: {failed[0].reason}"
    return "nothing to compare: gsb-probe needs runs of one configuration, or recordings that differ in one thing alone"


def answers(arms: Arms) -> list[Finding]:
    """What the arms answer to each question."""
    noise = ask_runs(arms)
    varies = "" if isinstance(noise, Missing) or noise.found.first_step is None else _varies(noise.found)
    unknown = noise.reason if isinstance(noise, Missing) else ""
    found = [(question, _answer(question, arms, varies, unknown)) for question in QUESTIONS]
    return [one for question, one in found if not (question.asked_of_few and one.answer is Answer.NOT_ASKED)]


def _answer(question: Question, arms: Arms, varies: str, unknown: str) -> Finding:
    asked = question.ask(arms)
    if isinstance(asked, Missing):
        return Finding(question.key, question.title, Answer.NOT_ASKED, reason=asked.reason)
    finding = Finding(question.key, question.title, Answer.YES, *asked)
    if asked.found.level is EqualityLevel.BIT_IDENTICAL:
        return finding
    if question.attributable and varies:
        return replace(finding, answer=Answer.OPEN, reason=varies)
    if question.attributable and unknown:
        return replace(finding, answer=Answer.OPEN, reason=f"runs were not compared: {unknown}")
    return replace(finding, answer=Answer.NO)


def _varies(noise: Found) -> str:
    return f"runs that were asked for the same differ too, from step {noise.first_step} on"


QUESTIONS = (
    Question("runs", "repeats itself from run to run", ask_runs, attributable=False),
    Question("envs", "identical environments stay identical", ask_envs, attributable=False),
    Question("capture", "capturing states changes nothing", ask_captured),
    Question("number", "independent of the number of environments", ask_numbers),
    Question("slot", "independent of the slot", ask_slots),
    Question("neighbours", "independent of the neighbours' states", ask_neighbours),
    Question("poison", "a NaN in one environment harms no other", left_alone("poison", "one that is not finite")),
    Question("bystanders", "a reset leaves other environments alone", left_alone("reset", "others that are reset")),
    Question("fresh", "a reset environment is as good as a fresh one", ask_fresh),
    Question(
        "restored", "a restored state goes on as before",
        goes_on("excursion", "saved at step {step}, {more} further steps, restored"),
    ),
    Question("process", "a snapshot goes on in another process as before", ask_process),
    Question("mirrored", "a mirrored state goes on as the mirrored one", image_goes_on("mirror", "y", "x"), gate=False),
    Question("turned", "a turned state goes on as the turned one", image_goes_on("mirror", "xy"), gate=False),
    Question("relabelled", "identical bodies are interchangeable", image_goes_on("relabel", "reverse"), gate=False),
    Question("device", "independent of the device", ask_devices, gate=False, asked_of_few=True),
    Question(
        "set", "positions and velocities are the whole state",
        goes_on("set", "set at step {step} to the state that they had"), gate=False,
    ),
)  # fmt: skip
"""In the order of the report."""
