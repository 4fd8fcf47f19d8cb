"""What shows that the timed steps of a recording did the scene's work, and that the engine simulated what was given."""

from __future__ import annotations

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.provenance import Simulation

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
    """Joints and bodies of an environment that move, on average, at the begin or the end of the timed phase, whichever
    is less; None where they are not counted at both."""
    found = recording.counts.get("timed", {}).get("moving")
    return float(min(found.mean)) if found is not None and len(found.mean) > 1 else None


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
