"""Facts of the work that was done: which steps were timed, what shows that they did it, and with which parameters."""

from __future__ import annotations

import numpy as np

from gpusimbench.evaluator.check import hardware
from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.check.rules.fact import (
    Fact,
    FactType,
    NotThere,
    configuration_of,
    recording_of,
    simulation_of,
)
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.provenance import MISPLACED_CONTACTS, Simulation
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.tosses import EVEN

FACTS_OF_A_TOSS = ("static_friction", "kinetic_friction", "mass", "size", "inertia")
"""Last words of the parameters that the closed division gives: friction, mass, edge, inertia."""


def counters(recording: Recording) -> tuple[str, ...]:
    """Counters that the timed phase has at its begin and at its end."""
    return tuple(name for name, counts in recording.counts.get("timed", {}).items() if len(counts.steps) > 1)


def counters_missing(recording: Recording) -> tuple[str, ...]:
    """Counters that the engine declares, and the timed phase does not have at its begin and at its end."""
    declared = recording.simulation.counters if recording.simulation else ()
    there = counters(recording)
    return tuple(counter.name for counter in declared if counter.name not in there)


def contacts(recording: Recording) -> float | None:
    """Contacts of an environment at the last timed step, on average; None where they are not counted."""
    found = recording.counts.get("timed", {}).get("contacts")
    return float(found.mean[-1]) if found is not None and len(found.mean) else None


def state_changes(recording: Recording) -> bool:
    """Whether the state of every environment at the end of the timed phase is another than at its begin.

    False also where the states have no hashes.
    """
    hashes = recording.fingerprints("timed")
    return hashes is not None and len(hashes.steps) > 1 and bool((hashes.hashes[0] != hashes.hashes[-1]).all())


def actions_change(recording: Recording) -> bool:
    """Whether the actions of the last timed step are others than those of the first; False where there are none."""
    stream = recording.action_streams.get("timed")
    return stream is not None and bool(stream.last_sha256) and stream.first_sha256 != stream.last_sha256


def actions_verified(recording: Recording) -> bool:
    """Whether the engine held, after the last timed step, the actions that it was given for that step."""
    stream = recording.action_streams.get("timed")
    return stream is not None and stream.verified


def moving(recording: Recording) -> float | None:
    """Joints and bodies of an environment that move, on average, at the beginning or end of the timed phase, whichever
    is less; None where they are not counted at both."""
    found = recording.counts.get("timed", {}).get("moving")
    return float(min(found.mean)) if found is not None and len(found.mean) > 1 else None


def misplaced_counted(recording: Recording) -> bool:
    """Whether contacts outside of their bodies are counted, in any phase."""
    return any(MISPLACED_CONTACTS in by_name for by_name in recording.counts.values())


def misplaced_contacts(recording: Recording) -> tuple[str, ...]:
    """Contacts outside of their bodies: a sentence for each phase that counted any."""
    n_env, found = recording.configuration.n_env, []
    for phase, by_name in recording.counts.items():
        counts = by_name.get(MISPLACED_CONTACTS)
        if counts is not None and counts.max.any():
            number = plural(round(counts.mean.sum() * n_env), "misplaced contact", spec=",")
            found.append(f"{number} in the {phase} phase, first at step {counts.steps[np.argmax(counts.max > 0)]}")
    return tuple(found)


def facts_not_honoured(simulation: Simulation) -> tuple[str, ...]:
    """Friction, mass, edge or inertia of a body that the engine has another value of, each with both values."""
    return tuple(
        f"{deviation.parameter} is {deviation.used}, not {deviation.wanted}"
        for deviation in simulation.deviations
        if deviation.parameter.rpartition(".")[2] in FACTS_OF_A_TOSS and not _same(deviation.used, deviation.wanted)
    )


def _same(used: str, wanted: str) -> bool:
    try:
        return float(used) == float(wanted)
    except ValueError:  # in words, such as "two coefficients"
        return used == wanted


def _steps_made(file: Integrity, phase: str, asked: int) -> int:
    recording = recording_of(file)
    if recording.status != "complete":
        return asked
    timing = recording.timing.get(phase)
    return min(asked, len(timing.start_ns) * timing.steps_per_interval) if timing else 0


def _window(file: Integrity) -> str:
    c = configuration_of(file)
    return f"steps {c.warmup:,} to {c.warmup + c.timed_steps:,}"


def _timed_seconds(file: Integrity) -> float:
    timing = recording_of(file).timing.get("timed")
    if timing is None:
        raise NotThere("the timed phase has no clocks")
    return timing.elapsed_s


def _required(value: float | None, otherwise: str) -> float:
    if value is None:
        raise NotThere(otherwise)
    return value


def _fitted(file: Integrity) -> tuple[str, ...]:
    return tuple(f"{name} on {tosses}" for name, tosses in configuration_of(file).fitted.items())


WORK_FACTS: dict[str, Fact] = {
    "warmup_made": Fact(
        FactType.number,
        "steps of the warm-up that have clocks; of a run that is not complete, those that were asked for",
        lambda f: _steps_made(f, "warmup", configuration_of(f).warmup),
    ),
    "timed_steps_made": Fact(
        FactType.number,
        "steps of the timed phase that have clocks; of a run that is not complete, those that were asked for",
        lambda f: _steps_made(f, "timed", configuration_of(f).timed_steps),
    ),
    "timed_window": Fact(FactType.text, "timed steps of the scene, as they were asked for", _window),
    "timed_seconds": Fact(FactType.number, "duration of the timed phase [s]", _timed_seconds),
    "timed_counters": Fact(
        FactType.list,
        "what is counted at the beginning and the end of the timed phase",
        lambda f: counters(recording_of(f)),
    ),
    "timed_counters_missing": Fact(
        FactType.list,
        "what the engine counts, but not in the timed phase",
        lambda f: counters_missing(recording_of(f)),
    ),
    "timed_contacts": Fact(
        FactType.number,
        "contacts of an environment at the last timed step, on average",
        lambda f: _required(contacts(recording_of(f)), "contacts are not counted"),
    ),
    "timed_state_changes": Fact(
        FactType.flag,
        "every environment's state hash at the end of the timed phase differs from that at its begin",
        lambda f: state_changes(recording_of(f)),
    ),
    "timed_actions_change": Fact(
        FactType.flag,
        "the actions of the last timed step differ from those of the first",
        lambda f: actions_change(recording_of(f)),
    ),
    "timed_actions_verified": Fact(
        FactType.flag,
        "the engine held the actions of the last timed step, as it was given them",
        lambda f: actions_verified(recording_of(f)),
    ),
    "timed_moving": Fact(
        FactType.number,
        "joints and bodies of an environment that move, on average, at the beginning or the end of the timed phase, "
        "whichever is less",
        lambda f: _required(moving(recording_of(f)), "what moves is not counted"),
    ),
    "timed_unsampled_s": Fact(
        FactType.number,
        "longest time of the timed phase without a reading of the clocks of what the simulator steps on [s]",
        lambda f: _required(hardware.longest_gap_s(recording_of(f)), "the timed phase has no clocks"),
    ),
    "timed_throttled_share": Fact(
        FactType.number,
        "share of the timed phase's readings in which heat or power held the GPU's clocks down",
        lambda f: _required(
            hardware.timed_throttled_share(recording_of(f)), "no reading tells why clocks are not higher"
        ),
    ),
    "misplaced_contacts": Fact(
        FactType.list,
        "contacts outside of one of their two bodies, by phase",
        lambda f: misplaced_contacts(recording_of(f)),
    ),
    "given_start": Fact(
        FactType.flag,
        "environments begin in states that were given or drawn",
        lambda f: bool(configuration_of(f).initial),
    ),
    "fitted": Fact(FactType.list, "options that were fitted to tosses, and to which", _fitted),
    "fitted_on_judged": Fact(
        FactType.list,
        "options that were fitted to other tosses than even ones, and to which",
        lambda f: tuple(f"{name} on {data}" for name, data in configuration_of(f).fitted.items() if data != EVEN),
    ),
    "facts_not_honoured": Fact(
        FactType.list,
        "friction, mass, edge or inertia that the engine has another value of",
        lambda f: facts_not_honoured(simulation_of(f)),
    ),
}
"""By name."""
