"""What the questions of a probe compare: arms that differ in one thing alone, environment by environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from textwrap import shorten

import numpy as np

from gpusimbench.evaluator.metrics.levels import EqualityLevel
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import Arms
from gpusimbench.evaluator.probe.finding import Asked, decided_alone, first_of, same_slots, worst_of
from gpusimbench.evaluator.probe.pairs import Found, Pairs, compare_pairs
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.streams import of_both_phases
from gpusimbench.evaluator.statistics.regimes import upper_bound_of_none
from gpusimbench.schemas.initial import INITIAL_KINDS, Initial
from gpusimbench.schemas.symmetry import symmetry_of
from gpusimbench.schemas.text import bound, plural
from gpusimbench.schemas.treatment import KINDS, Intervention

_WHY = 60  # characters of why an arm is missing


def left_alone(kind: str, others: str) -> Callable[[Arms], Asked | Missing]:
    """The question of environments that are left alone, beside others that are treated so, in words."""

    def ask(arms: Arms, base: Recording, recording: Recording, done: Intervention) -> Asked | Missing:
        envs = sorted({*range(arms.n_env)} - {*done.treated(arms.n_env)})
        if not envs:
            return Missing("needs two environments")
        return decided_alone(
            compare_pairs(Pairs(base, recording, same_slots(envs))), f"{len(envs)} environments beside {others}"
        )

    return _of_beside(kind, ask)


def goes_on(kind: str, what: str) -> Callable[[Arms], Asked | Missing]:
    """The question of all environments, that go on after they were treated so, in words with {step} and {more}."""

    def ask(arms: Arms, base: Recording, recording: Recording, done: Intervention) -> Asked | Missing:
        said = what.format(step=done.step, more=done.more)
        return decided_alone(compare_pairs(Pairs(base, recording, same_slots(range(arms.n_env)))), said)

    return _of_beside(kind, ask)


def ask_fresh(arms: Arms) -> Asked | Missing:
    """Environments that are reset with those of a run that has just begun."""
    treated = _treated(arms, "reset")
    if isinstance(treated, Missing):
        return treated
    if not arms.plain:
        return Missing("needs a run whose environments begin as a reset leaves them")
    recording, done = treated
    envs = done.treated(arms.n_env)
    pairs = Pairs(recording, arms.plain[0], same_slots(envs), ahead=done.step, first=1)
    return decided_alone(
        compare_pairs(pairs), f"{len(envs)} environments after a reset at step {done.step}, and fresh ones"
    )


def ask_process(arms: Arms) -> Asked | Missing:
    """A run and one that continues its snapshot in a process of its own."""
    if arms.continued is None:
        failed = next((why for how, why in arms.failed.items() if " snapshot" in how), "")
        needed = "needs a run with --snapshot STEP, and its --replay FILE --from STEP"
        return Missing(f"its run is {failed}" if failed else needed)
    base, later = arms.continued
    step = later.configuration.first_step
    pairs = Pairs(base, later, same_slots(range(base.configuration.n_env)))
    return decided_alone(
        compare_pairs(pairs), f"a snapshot of step {step}, restored in another process, and the run that saved it"
    )


def _treated(arms: Arms, kind: str) -> tuple[Recording, Intervention] | Missing:
    found = arms.treated.get(kind)
    if found is None:
        why = next((why for how, why in arms.failed.items() if f" {kind}@" in how), "")
        return Missing(f"its run is {why}" if why else f"needs a run with --intervene {KINDS[kind].form}")
    return found, Intervention.parse(found.configuration.intervention)


def _of_beside(
    kind: str, ask: Callable[[Arms, Recording, Recording, Intervention], Asked | Missing]
) -> Callable[[Arms], Asked | Missing]:
    """The question that is asked of a run that was left alone and one that was treated so, where there are both."""

    def asked(arms: Arms) -> Asked | Missing:
        beside = _beside(arms, kind)
        return beside if isinstance(beside, Missing) else ask(arms, *beside)

    return asked


def _beside(arms: Arms, kind: str) -> tuple[Recording, Recording, Intervention] | Missing:
    """A run that was left alone, and one that was not."""
    base, treated = first_of(arms.varied), _treated(arms, kind)
    if isinstance(base, Missing):
        return base
    return treated if isinstance(treated, Missing) else (base, *treated)


def _begun_otherwise(
    arms: Arms, kind: str, values: Sequence[str] = ()
) -> tuple[Recording, Recording, Initial] | Missing:
    """A run that began with the usual states, and one that began with others of this kind.

    values  of the kind, of which it has one, the usual one first; empty: any
    """
    base = first_of(arms.varied)
    if isinstance(base, Missing):
        return base

    def such(begins: str) -> bool:
        return f",{kind}:" in begins and (not values or begins.rpartition(":")[2] in values)

    found = next(((run, initial) for run, initial in arms.otherwise.items() if such(str(initial))), None)
    if found is None:
        why = next((why for how, why in arms.failed.items() if any(map(such, how.split()))), "")
        form = f"random:SPREAD,{kind}:{values[0]}" if values else INITIAL_KINDS[kind].form
        return Missing(f"its run is {why}" if why else f"needs a run with --initial {form}")
    return base, *found


def ask_runs(arms: Arms) -> Asked | Missing:
    """Runs of the same treatment, environment by environment, of every treatment that has several."""
    if not arms.repeated:
        return Missing("needs two runs of the same configuration")
    found = [
        compare_pairs(Pairs(runs[0], other, same_slots(range(runs[0].configuration.n_env))))
        for runs in arms.repeated
        for other in runs[1:]
    ]
    count = sum(map(len, arms.repeated))
    asked = worst_of(
        found, f"{count} runs of {plural(len(arms.repeated), 'configuration')}, each with others of the same"
    )
    if isinstance(asked, Missing) or asked.found.level is not EqualityLevel.BIT_IDENTICAL:
        return asked
    agreed = sum(not isinstance(one, Missing) for one in found)
    below = upper_bound_of_none(agreed)
    return asked._replace(detail=f"one more run differs with a probability below {bound(below)} (95 % confidence)")


def ask_envs(arms: Arms) -> Asked | Missing:
    """Environment 0 with all others of a run in which all begin alike."""
    if not arms.plain:
        return Missing("needs a run whose environments begin alike")
    if arms.n_env < 2:
        return Missing("needs two environments")
    run = arms.plain[0]
    if why := run.apart_by_design:
        return Missing(why)
    found = compare_pairs(Pairs(run, run, tuple((0, env) for env in range(1, arms.n_env))))
    return decided_alone(found, f"environment 0 and the {arms.n_env - 1} others of a run")


def ask_numbers(arms: Arms) -> Asked | Missing:
    """Environments of the usual run with those of the same slot and state among more, or fewer, environments."""
    base = first_of(arms.varied)
    if isinstance(base, Missing):
        return base
    if not arms.by_number:
        return Missing("needs runs of other numbers of environments")
    numbers = sorted(arms.by_number)
    found = [compare_pairs(Pairs(base, arms.by_number[n], same_slots(range(min(n, arms.n_env))))) for n in numbers]
    known = [(n, one) for n, one in zip(numbers, found, strict=True) if not isinstance(one, Missing)]
    differ = [n for n, one in known if one.first_step is not None]
    listed = ", ".join(map(str, numbers))
    parts = [f"differs for {', '.join(map(str, differ))} environments"] if differ else []
    others = {how: why for how, why in arms.failed.items() if _other_number(how, arms.n_env)}
    parts += [
        f"not with {how.partition(' ')[0]}: {shorten(why, _WHY, placeholder=' ...')}" for how, why in others.items()
    ]
    return worst_of(found, f"{arms.n_env} environments and {listed} of the same {_what_varies(arms)}", "; ".join(parts))


def _other_number(how: str, n_env: int) -> bool:
    # of a treatment in words, as in Arms.failed: another number of environments, and nothing done to them
    return not how.startswith(f"{n_env} envs") and "@" not in how


def ask_slots(arms: Arms) -> Asked | Missing:
    """Whether the same initial states give the same results in other slots."""
    both = _begun_otherwise(arms, "shift")
    if isinstance(both, Missing):
        return both
    base, shifted, initial = both
    pairs = tuple(((env + initial.shift) % arms.n_env, env) for env in range(arms.n_env))
    return decided_alone(
        compare_pairs(Pairs(base, shifted, pairs)), f"the same {_what_varies(arms)}, {initial.shift} slots further"
    )


def ask_neighbours(arms: Arms) -> Asked | Missing:
    """One environment among others that begin otherwise."""
    both = _begun_otherwise(arms, "but")
    if isinstance(both, Missing):
        return both
    base, others, initial = both
    assert initial.but is not None
    compared = f"environment {initial.but} among neighbours of other {_what_varies(arms)}"
    return decided_alone(compare_pairs(Pairs(base, others, same_slots([initial.but]))), compared)


def image_goes_on(kind: str, *values: str) -> Callable[[Arms], Asked | Missing]:
    """The question of all environments, that begin in images of their initial states by a symmetry of the scene.

    kind    of schemas.initial.INITIAL_KINDS
    values  of the kind that ask this, that of gsb-probe first
    """

    def ask(arms: Arms) -> Asked | Missing:
        base, both = first_of(arms.varied), _begun_otherwise(arms, kind, values)
        if isinstance(base, Missing):
            return base
        initial = Initial(1.0).of_kind(kind, values[0]) if isinstance(both, Missing) else both[2]
        symmetry = symmetry_of(initial, base.scene, arms.key.told["vary"])
        assert symmetry is not None
        if symmetry.why_not:
            return Missing(f"the scene {symmetry.why_not}")
        if isinstance(both, Missing):
            return both
        pairs = Pairs(base, both[1], same_slots(range(arms.n_env)), symmetry=symmetry)
        return decided_alone(compare_pairs(pairs), f"the same {_what_varies(arms)}, {symmetry.words}")

    return ask


def ask_captured(arms: Arms) -> Asked | Missing:
    """The timed phase, in which nobody looks at states, with the capture: by hashes."""
    for run in (*arms.plain, *arms.varied):
        phases = run.fingerprints("timed"), run.fingerprints("capture")
        steps, timed, captured = of_both_phases(*phases, run.configuration.intervention)
        begun = steps > 0
        steps, timed, captured = steps[begun], timed[begun], captured[begun]
        if not steps.size:
            continue
        differ = captured != timed
        apart = np.flatnonzero(differ.any(axis=1))
        first = int(steps[apart[0]]) if apart.size else None
        level = EqualityLevel.BIT_IDENTICAL if first is None else EqualityLevel.DIFFERENT
        files = (run.path, run.path)
        found = Found(
            level, run.configuration.n_env, int(differ.any(axis=0).sum()), len(steps), first, None, 0, 0.0, 0, (), "m",
            files,
        )  # fmt: skip
        return Asked(found, f"timed and captured states, at step {', '.join(map(str, steps.tolist()))}")
    return Missing("needs a run with both phases, timed and capture, that passed the same steps")


def ask_devices(arms: Arms) -> Asked | Missing:
    """Runs of the same treatment on other devices; only those of devices on which runs repeat themselves."""
    found: list[Found | Missing] = []
    devices: dict[str, None] = {}
    differ: dict[str, None] = {}
    for other in arms.others:
        noise = ask_runs(other)
        if not isinstance(noise, Missing) and noise.found.first_step is not None:
            continue
        for how in arms.runs.keys() & other.runs.keys():
            run, twin = arms.runs[how], other.runs[how]
            one = compare_pairs(Pairs(run, twin, same_slots(range(run.configuration.n_env))))
            if isinstance(one, Missing):
                continue
            found.append(one)
            devices[other.key.device] = None
            if one.first_step is not None:
                differ[how] = None
    if not found:
        return Missing("needs the same runs on another device")
    said = f"{plural(len(found), 'run')} and the same on {', '.join(devices)}"
    return worst_of(found, said, f"differs with {', '.join(sorted(differ))}" if differ else "")


def _what_varies(arms: Arms) -> str:
    """What differs between environments, and goes with them into other slots."""
    return "initial states and parameters" if arms.key.told["vary"] else "initial states"
