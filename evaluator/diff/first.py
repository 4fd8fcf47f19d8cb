"""The first divergence: by recorded hashes where there are any, by recorded states otherwise."""

from __future__ import annotations

from fractions import Fraction

from gpusimbench.evaluator.diff.hashes import CommonHashes
from gpusimbench.evaluator.diff.locate import envs_of, state_difference
from gpusimbench.evaluator.diff.result import Divergence
from gpusimbench.evaluator.diff.selection import Selection
from gpusimbench.evaluator.diff.splits import Agreement
from gpusimbench.evaluator.diff.states import CommonStates


def first_divergence(
    a: Selection,
    b: Selection,
    ratio: Fraction,
    states: tuple[CommonStates, Agreement],
    hashes: tuple[CommonHashes, Agreement] | None,
) -> Divergence | None:
    """The first common step at which anything differs; None where nothing does.

    ratio   steps of b for a step of a
    states  and what reading them found
    hashes  likewise; they are there for steps whose states are not
    """
    common, seen = states
    found, by_hashes, phase = seen, False, "capture"
    if hashes is not None and hashes[1].first is not None:
        hashed = hashes[1]
        if seen.first is None or hashed.first_step() <= seen.first_step():
            found, by_hashes, phase = hashed, True, hashes[0].phase
    if found.first is None:
        return None
    step = found.first_step()
    step_b = int(step * ratio)
    known = [*seen.steps, *(hashes[1].steps if hashes else [])]
    env_a, env_b = envs_of(found.first.pair, a, b)
    return Divergence(
        phase=phase,
        step_a=step,
        step_b=step_b,
        time=step * a.recording.configuration.dt,
        after_step=max((s for s in known if s < step), default=None),
        env_a=env_a,
        env_b=env_b,
        envs=found.first.count,
        by_hashes=by_hashes,
        state=state_difference(common, seen.first.row, a, b) if seen.first else None,
        contacts_a=a.contacts(phase, step),
        contacts_b=b.contacts(phase, step_b),
    )


def first_of_timed(a: Selection, b: Selection, ratio: Fraction, seen: Agreement) -> Divergence | None:
    """The first common step of the timed phase at which hashes differ; None where none do.

    ratio  steps of b for a step of a
    seen   what reading these hashes found
    """
    if seen.first is None:
        return None
    step = seen.first_step()
    step_b = int(step * ratio)
    env_a, env_b = envs_of(seen.first.pair, a, b)
    return Divergence(
        phase="timed",
        step_a=step,
        step_b=step_b,
        time=step * a.recording.configuration.dt,
        after_step=max((s for s in seen.steps if s < step), default=None),
        env_a=env_a,
        env_b=env_b,
        envs=seen.first.count,
        by_hashes=True,
        state=None,
        contacts_a=a.contacts("timed", step),
        contacts_b=b.contacts("timed", step_b),
    )
