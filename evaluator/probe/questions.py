"""The questions of a probe: what each compares, and what it answers. A new question is one declaration.

Each asks whether something matters that should not. "Yes" is the answer that one hopes for: nothing differs, bit for
bit. Where runs that were asked for the same differ anyway, a difference tells nothing of its cause, and the answer is
open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from textwrap import shorten
from typing import NamedTuple

import numpy as np

from gpusimbench.evaluator.metrics.levels import Level
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import Arms, arms_of
from gpusimbench.evaluator.probe.pairs import Found, Pairs, held
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.statistics.regimes import upper_bound_of_none
from gpusimbench.schemas.treatment import Initial, Intervention

_WHY = 60  # characters of why an arm is missing


class Answer(StrEnum):
    """Of a question."""

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
    why         why the answer is open or was not asked; empty elsewhere
    """

    key: str
    title: str
    answer: Answer
    found: Found | None = None
    compared: str = ""
    detail: str = ""
    why: str = ""


class Probed(NamedTuple):
    """The arms of one configuration, and what they answer, a finding a question."""

    arms: Arms
    findings: list[Finding]


class Asked(NamedTuple):
    """A comparison that decides, and its words; see Finding."""

    found: Found
    compared: str
    detail: str = ""


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


def answers(arms: Arms) -> list[Finding]:
    """What the arms answer to each question."""
    noise = _runs(arms)
    varies = "" if isinstance(noise, Missing) or noise.found.first_step is None else _varies(noise.found)
    unknown = noise.reason if isinstance(noise, Missing) else ""
    found = [(question, _answer(question, arms, varies, unknown)) for question in QUESTIONS]
    return [one for question, one in found if not (question.asked_of_few and one.answer is Answer.NOT_ASKED)]


def verdict_of(findings: Sequence[Finding]) -> str:
    """One sentence: how many answers are yes, and which are no."""
    asked = [one for one in findings if one.answer is not Answer.NOT_ASKED]
    yes = [one for one in asked if one.answer is Answer.YES]
    said = f"{len(yes)} of {len(asked)} answers are yes" if asked else "nothing was asked"
    parts = [said]
    for answer in (Answer.NO, Answer.OPEN):
        if titles := [one.title for one in findings if one.answer is answer]:
            parts.append(f"{answer.value}: {', '.join(titles)}")
    return "; ".join(parts)


def _answer(question: Question, arms: Arms, varies: str, unknown: str) -> Finding:
    asked = question.ask(arms)
    if isinstance(asked, Missing):
        return Finding(question.key, question.title, Answer.NOT_ASKED, why=asked.reason)
    finding = Finding(question.key, question.title, Answer.YES, *asked)
    if asked.found.level is Level.BIT_IDENTICAL:
        return finding
    if question.attributable and varies:
        return replace(finding, answer=Answer.OPEN, why=varies)
    if question.attributable and unknown:
        return replace(finding, answer=Answer.OPEN, why=f"runs were not compared: {unknown}")
    return replace(finding, answer=Answer.NO)


def _varies(noise: Found) -> str:
    return f"runs that were asked for the same differ too, from step {noise.first_step} on"


def _runs(arms: Arms) -> Asked | Missing:
    """Runs of the same treatment, environment by environment, of every treatment that has several."""
    if not arms.repeated:
        return Missing("needs two runs of the same configuration")
    found = [
        held(Pairs(runs[0], other, _same(range(runs[0].configuration.n_env))))
        for runs in arms.repeated
        for other in runs[1:]
    ]
    count = sum(map(len, arms.repeated))
    asked = _worst(found, f"{count} runs of {len(arms.repeated)} configurations, each with others of the same")
    if isinstance(asked, Missing) or asked.found.level is not Level.BIT_IDENTICAL:
        return asked
    agreed = sum(not isinstance(one, Missing) for one in found)
    below = upper_bound_of_none(agreed)
    return asked._replace(detail=f"one more run differs with a probability below {100 * below:.0f} % (95 % confidence)")


def _envs(arms: Arms) -> Asked | Missing:
    """Environment 0 with all others of a run in which all begin alike."""
    if arms.key.vary:
        return Missing(f"environments differ by --vary {arms.key.vary}")
    if not arms.plain:
        return Missing("needs a run whose environments begin alike")
    if arms.n_env < 2:
        return Missing("needs two environments")
    run = arms.plain[0]
    found = held(Pairs(run, run, tuple((0, env) for env in range(1, arms.n_env))))
    return _told(found, f"environment 0 and the {arms.n_env - 1} others of a run")


def _numbers(arms: Arms) -> Asked | Missing:
    """Environments of the usual run with those of the same slot and state among more, or fewer, environments."""
    base = _first(arms.varied)
    if isinstance(base, Missing):
        return base
    if not arms.by_number:
        return Missing("needs runs of other numbers of environments")
    numbers = sorted(arms.by_number)
    found = [held(Pairs(base, arms.by_number[n], _same(range(min(n, arms.n_env))))) for n in numbers]
    known = [(n, one) for n, one in zip(numbers, found, strict=True) if not isinstance(one, Missing)]
    differ = [n for n, one in known if one.first_step is not None]
    listed = ", ".join(map(str, numbers))
    parts = [f"differs for {', '.join(map(str, differ))} environments"] if differ else []
    others = {how: why for how, why in arms.failed.items() if _other_number(how, arms.n_env)}
    parts += [
        f"not with {how.partition(' ')[0]}: {shorten(why, _WHY, placeholder=' ...')}" for how, why in others.items()
    ]
    return _worst(found, f"{arms.n_env} environments and {listed} of the same {_begun(arms)}", "; ".join(parts))


def _other_number(how: str, n_env: int) -> bool:
    # of a treatment in words, as in Arms.failed: another number of environments, and nothing done to them
    return not how.startswith(f"{n_env} envs") and "@" not in how


def _slots(arms: Arms) -> Asked | Missing:
    """The same initial states in other slots."""
    base = _first(arms.varied)
    if isinstance(base, Missing):
        return base
    if arms.shifted is None:
        return Missing("needs a run whose initial states are in other slots")
    shift = Initial.parse(arms.shifted.configuration.initial).shift
    pairs = tuple(((env + shift) % arms.n_env, env) for env in range(arms.n_env))
    return _told(held(Pairs(base, arms.shifted, pairs)), f"the same {_begun(arms)}, {shift} slots further")


def _neighbours(arms: Arms) -> Asked | Missing:
    """One environment among others that begin otherwise."""
    base = _first(arms.varied)
    if isinstance(base, Missing):
        return base
    if arms.but is None:
        return Missing("needs a run in which all environments but one begin otherwise")
    kept = Initial.parse(arms.but.configuration.initial).but
    assert kept is not None
    other = f"environment {kept} among neighbours of other {_begun(arms)}"
    return _told(held(Pairs(base, arms.but, ((kept, kept),))), other)


def _poison(arms: Arms) -> Asked | Missing:
    """Environments beside one that is not finite."""
    beside = _beside(arms, "poison")
    if isinstance(beside, Missing):
        return beside
    base, recording, done = beside
    envs = [env for env in range(arms.n_env) if not done.treated(env)]
    return _told(held(Pairs(base, recording, _same(envs))), f"{len(envs)} environments beside one that is not finite")


def _bystanders(arms: Arms) -> Asked | Missing:
    """Environments that are left alone while others are reset."""
    beside = _beside(arms, "reset")
    if isinstance(beside, Missing):
        return beside
    base, recording, done = beside
    envs = [env for env in range(arms.n_env) if not done.treated(env)]
    if not envs:
        return Missing("needs two environments")
    return _told(held(Pairs(base, recording, _same(envs))), f"{len(envs)} environments beside others that are reset")


def _fresh(arms: Arms) -> Asked | Missing:
    """Environments that are reset with those of a run that has just begun."""
    treated = _treated(arms, "reset")
    if isinstance(treated, Missing):
        return treated
    if not arms.plain:
        return Missing("needs a run whose environments begin as a reset leaves them")
    recording, done = treated
    envs = [env for env in range(arms.n_env) if done.treated(env)]
    pairs = Pairs(recording, arms.plain[0], _same(envs), ahead=done.step, first=1)
    return _told(held(pairs), f"{len(envs)} environments after a reset at step {done.step}, and fresh ones")


def _restored(arms: Arms) -> Asked | Missing:
    """All environments after an excursion from which they were restored."""
    beside = _beside(arms, "excursion")
    if isinstance(beside, Missing):
        return beside
    base, recording, done = beside
    said = f"saved at step {done.step}, {done.more} further steps, restored"
    return _told(held(Pairs(base, recording, _same(range(arms.n_env)))), said)


def _process(arms: Arms) -> Asked | Missing:
    """A run and one that continues its snapshot in a process of its own."""
    if arms.continued is None:
        failed = next((why for how, why in arms.failed.items() if " snapshot" in how), "")
        needed = "needs a run with --snapshot STEP, and its --replay FILE --from STEP"
        return Missing(f"its run is {failed}" if failed else needed)
    base, later = arms.continued
    step = later.configuration.first_step
    pairs = Pairs(base, later, _same(range(base.configuration.n_env)))
    return _told(held(pairs), f"a snapshot of step {step}, restored in another process, and the run that saved it")


def _set(arms: Arms) -> Asked | Missing:
    """All environments after they were given the positions and velocities that they had."""
    beside = _beside(arms, "set")
    if isinstance(beside, Missing):
        return beside
    base, recording, done = beside
    return _told(
        held(Pairs(base, recording, _same(range(arms.n_env)))), f"set at step {done.step} to the state that they had"
    )


def _captured(arms: Arms) -> Asked | Missing:
    """The timed phase, in which nobody looks at states, with the capture: by hashes."""
    for run in (*arms.plain, *arms.varied):
        timed, captured = run.fingerprints("timed"), run.fingerprints("capture")
        if timed is None or captured is None:
            continue
        steps, at_a, at_b = np.intersect1d(captured.steps, timed.steps, return_indices=True)
        steps, at_a, at_b = (array[steps > 0] for array in (steps, at_a, at_b))
        if not steps.size:
            continue
        differ = captured.hashes[at_a] != timed.hashes[at_b]
        apart = np.flatnonzero(differ.any(axis=1))
        first = int(steps[apart[0]]) if apart.size else None
        level = Level.BIT_IDENTICAL if first is None else Level.DIFFERENT
        files = (run.path, run.path)
        found = Found(
            level, run.configuration.n_env, int(differ.any(axis=0).sum()), len(steps), first, None, 0, 0.0, 0, (), "m",
            files,
        )  # fmt: skip
        return Asked(found, f"timed and captured states, at step {', '.join(map(str, steps.tolist()))}")
    return Missing("needs a run with both phases, timed and capture, that passed the same steps")


def _device(arms: Arms) -> Asked | Missing:
    """Runs of the same treatment on other devices; only those of devices on which runs repeat themselves."""
    found: list[Found | Missing] = []
    devices: dict[str, None] = {}
    differ: dict[str, None] = {}
    for other in arms.others:
        noise = _runs(other)
        if not isinstance(noise, Missing) and noise.found.first_step is not None:
            continue
        for how in arms.runs.keys() & other.runs.keys():
            run, twin = arms.runs[how], other.runs[how]
            one = held(Pairs(run, twin, _same(range(run.configuration.n_env))))
            if isinstance(one, Missing):
                continue
            found.append(one)
            devices[other.key.device] = None
            if one.first_step is not None:
                differ[how] = None
    if not found:
        return Missing("needs the same runs on another device")
    said = f"{len(found)} {'run' if len(found) == 1 else 'runs'} and the same on {', '.join(devices)}"
    return _worst(found, said, f"differs with {', '.join(sorted(differ))}" if differ else "")


def _first(runs: Sequence[Recording]) -> Recording | Missing:
    return runs[0] if runs else Missing("needs a run whose environments begin differently")


def _begun(arms: Arms) -> str:
    """What differs between environments, and goes with them into other slots."""
    return "initial states and parameters" if arms.key.vary else "initial states"


def _treated(arms: Arms, kind: str) -> tuple[Recording, Intervention] | Missing:
    found = arms.treated.get(kind)
    if found is None:
        why = next((why for how, why in arms.failed.items() if f" {kind}@" in how), "")
        return Missing(f"its run is {why}" if why else f"needs a run with --intervene {kind}@STEP")
    return found, Intervention.parse(found.configuration.intervention)


def _beside(arms: Arms, kind: str) -> tuple[Recording, Recording, Intervention] | Missing:
    """A run that was left alone, and one that was not."""
    base, treated = _first(arms.varied), _treated(arms, kind)
    if isinstance(base, Missing):
        return base
    return treated if isinstance(treated, Missing) else (base, *treated)


def _same(envs: Sequence[int]) -> tuple[tuple[int, int], ...]:
    return tuple((env, env) for env in envs)


def _told(found: Found | Missing, compared: str) -> Asked | Missing:
    return found if isinstance(found, Missing) else Asked(found, compared)


def _worst(found: Sequence[Found | Missing], compared: str, detail: str = "") -> Asked | Missing:
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


QUESTIONS = (
    Question("runs", "repeats itself from run to run", _runs, attributable=False),
    Question("envs", "identical environments stay identical", _envs, attributable=False),
    Question("capture", "capturing states changes nothing", _captured),
    Question("number", "does not depend on the number of environments", _numbers),
    Question("slot", "does not depend on the slot", _slots),
    Question("neighbours", "does not depend on the neighbours' states", _neighbours),
    Question("poison", "a NaN in one environment harms no other", _poison),
    Question("bystanders", "a reset leaves other environments alone", _bystanders),
    Question("fresh", "a reset environment is as good as a fresh one", _fresh),
    Question("restored", "a restored state goes on as before", _restored),
    Question("process", "a snapshot goes on in another process as before", _process),
    Question("device", "does not depend on the device", _device, gate=False, asked_of_few=True),
    Question("set", "positions and velocities are the whole state", _set, gate=False),
)
"""In the order of the report."""
