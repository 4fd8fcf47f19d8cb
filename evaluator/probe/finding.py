"""What is found on a question of a probe, and how comparisons become it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.pairs import Found
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.text import few, plural


class Answer(StrEnum):
    """How a question is answered."""

    YES = "yes"
    NO = "no"
    OPEN = "open"
    NOT_ASKED = "not asked"


@dataclass(frozen=True)
class Finding:
    """What was found on a question.

    key, title  of the question
    answer      to the title
    found       the comparison that decided; None where none was made
    compared    what was held against what, in words
    detail      which of them differ, where there are several kinds; how sure an agreement of runs is
    reason      why the answer is open or was not asked; empty elsewhere
    """

    key: str
    title: str
    answer: Answer
    found: Found | None = None
    compared: str = ""
    detail: str = ""
    reason: str = ""


class Asked(NamedTuple):
    """A comparison that decides, and its words; see Finding."""

    found: Found
    compared: str
    detail: str = ""


def verdict_of(findings: Sequence[Finding], *, named: int = 0) -> str:
    """One sentence: how many answers are yes, and which are no.

    named  how many questions whose answer is yes are named; none where a table of all questions follows
    """
    asked = [one for one in findings if one.answer is not Answer.NOT_ASKED]
    yes = [one.title for one in asked if one.answer is Answer.YES]
    verb = "is" if 1 in (len(yes), len(asked)) else "are"
    said = (
        f"{len(yes)} of {plural(len(asked), 'answer')} {verb} yes"
        if asked
        else "no question of gsb-probe has the runs that it compares"
    )
    parts = [f"{said} ({few(yes, named)})" if yes and named else said]
    for answer in (Answer.NO, Answer.OPEN):
        if titles := [one.title for one in findings if one.answer is answer]:
            parts.append(f"{answer.value}: {', '.join(titles)}")
    return "; ".join(parts)


def first_of(runs: Sequence[Recording]) -> Recording | Missing:
    """The first of the runs whose environments begin differently."""
    return runs[0] if runs else Missing("needs a run whose environments begin differently")


def same_slots(envs: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Pairs of each environment with the one of the same slot."""
    return tuple((env, env) for env in envs)


def decided_alone(found: Found | Missing, compared: str) -> Asked | Missing:
    """A comparison that decides alone."""
    return found if isinstance(found, Missing) else Asked(found, compared)


def worst_of(found: Sequence[Found | Missing], compared: str, detail: str = "") -> Asked | Missing:
    """Several comparisons that decide together: the worst of them, with the pairs of all."""
    known = [one for one in found if not isinstance(one, Missing)]
    if not known:
        return next(one for one in found if isinstance(one, Missing))
    worst = max(known, key=lambda one: (one.level, one.max_distance, one.max_ulp))
    all_of_them = replace(
        worst,
        pairs=sum(one.pairs for one in known),
        differing=sum(one.differing for one in known),
        first_step=min((one.first_step for one in known if one.first_step is not None), default=None),
    )
    return Asked(all_of_them, compared, detail)
