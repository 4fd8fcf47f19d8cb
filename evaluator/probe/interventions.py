"""Questions about what is done to environments on the way: a NaN, a reset, a state that is saved, restored or set."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import Arms
from gpusimbench.evaluator.probe.finding import Asked, first_of, same_slots, told
from gpusimbench.evaluator.probe.pairs import Pairs, held
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.treatment import KINDS, Intervention


def left_alone(kind: str, others: str) -> Callable[[Arms], Asked | Missing]:
    """The question of environments that are left alone, beside others that are treated so, in words."""

    def ask(arms: Arms) -> Asked | Missing:
        beside = _beside(arms, kind)
        if isinstance(beside, Missing):
            return beside
        base, recording, done = beside
        envs = sorted({*range(arms.n_env)} - {*done.treated(arms.n_env)})
        if not envs:
            return Missing("needs two environments")
        return told(held(Pairs(base, recording, same_slots(envs))), f"{len(envs)} environments beside {others}")

    return ask


def goes_on(kind: str, what: str) -> Callable[[Arms], Asked | Missing]:
    """The question of all environments, that go on after they were treated so, in words with {step} and {more}."""

    def ask(arms: Arms) -> Asked | Missing:
        beside = _beside(arms, kind)
        if isinstance(beside, Missing):
            return beside
        base, recording, done = beside
        said = what.format(step=done.step, more=done.more)
        return told(held(Pairs(base, recording, same_slots(range(arms.n_env)))), said)

    return ask


def fresh(arms: Arms) -> Asked | Missing:
    """Environments that are reset with those of a run that has just begun."""
    treated = _treated(arms, "reset")
    if isinstance(treated, Missing):
        return treated
    if not arms.plain:
        return Missing("needs a run whose environments begin as a reset leaves them")
    recording, done = treated
    envs = done.treated(arms.n_env)
    pairs = Pairs(recording, arms.plain[0], same_slots(envs), ahead=done.step, first=1)
    return told(held(pairs), f"{len(envs)} environments after a reset at step {done.step}, and fresh ones")


def process(arms: Arms) -> Asked | Missing:
    """A run and one that continues its snapshot in a process of its own."""
    if arms.continued is None:
        failed = next((why for how, why in arms.failed.items() if " snapshot" in how), "")
        needed = "needs a run with --snapshot STEP, and its --replay FILE --from STEP"
        return Missing(f"its run is {failed}" if failed else needed)
    base, later = arms.continued
    step = later.configuration.first_step
    pairs = Pairs(base, later, same_slots(range(base.configuration.n_env)))
    return told(held(pairs), f"a snapshot of step {step}, restored in another process, and the run that saved it")


def _treated(arms: Arms, kind: str) -> tuple[Recording, Intervention] | Missing:
    found = arms.treated.get(kind)
    if found is None:
        why = next((why for how, why in arms.failed.items() if f" {kind}@" in how), "")
        return Missing(f"its run is {why}" if why else f"needs a run with --intervene {KINDS[kind].form}")
    return found, Intervention.parse(found.configuration.intervention)


def _beside(arms: Arms, kind: str) -> tuple[Recording, Recording, Intervention] | Missing:
    """A run that was left alone, and one that was not."""
    base, treated = first_of(arms.varied), _treated(arms, kind)
    if isinstance(base, Missing):
        return base
    return treated if isinstance(treated, Missing) else (base, *treated)
