"""Errors of recorders that were found after recordings had been made with them.

An entry of KNOWN_ERRORS is all that an error needs: notes of gsb-eval and gsb-compare, gsb-check and gsb-info say it of
each recording that shows it, a wrong throughput has no value, and a wrong option is shown as it was in force. A
recording shows an error by what it states, never by its date or version: a checkout may be older than the day on which
it is used, and may have changes. So a correction of a recorder also changes something that its recordings state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from gpusimbench.evaluator.read.described import Described
from gpusimbench.schemas.provenance import Simulation
from gpusimbench.schemas.text import plural

PREFIX = "known error of the recorder: "
"""How a sentence on an error begins where nothing else says what it is of."""


@dataclass(frozen=True)
class KnownError:
    """One error of a recorder.

    simulator    whose adapter had it
    what         what is wrong in the recording, and by how much, in a clause
    more         where the documents say more
    shown        whether a recording of this simulator has it, by what was asked and what the simulator said of itself
    timed_steps  whether the time of timed steps is wrong: throughput and capture overhead have no value then
    in_force     options whose stated value is wrong, each with the value that was in force
    """

    simulator: str
    what: str
    more: str
    shown: Callable[[Described, Simulation], bool]
    timed_steps: bool = False
    in_force: tuple[tuple[str, Any], ...] = ()

    @property
    def said(self) -> str:
        """The error in words."""
        return f"{self.what} (see {self.more})"


def _searched_twice(_: Described, simulation: Simulation) -> bool:
    return "from the contacts that the step found" not in simulation.timing_covers


def _below_two_substeps(recording: Described, simulation: Simulation) -> bool:
    # the engine takes the larger of the value given and two substeps
    stated, substeps = (_number(simulation.options.get(name)) for name in ("constraint_timeconst", "substeps"))
    return bool(stated and substeps) and stated < 1.999 * recording.configuration.dt / substeps


def _without_friction_points(_: Described, simulation: Simulation) -> bool:
    named = {deviation.parameter for deviation in simulation.deviations}
    return simulation.options.get("backend") == "ovphysx" and "contact.friction" not in named


def _without_multiccd(_: Described, simulation: Simulation) -> bool:
    # the flag is the model's since the correction, so that it is no deviation
    return any(
        deviation.parameter == "option.disableflags"
        and "multiccd" in deviation.used
        and "multiccd" not in deviation.wanted
        for deviation in simulation.deviations
    )


_TOLERANCE = 1e-6  # the least of MuJoCo Warp's put_model, which MJX and Playground do not take from it


def _below_tolerance(_: Described, simulation: Simulation) -> bool:
    stated = _stated(simulation).get("tolerance")
    return isinstance(stated, float) and 0.0 <= stated < 0.999 * _TOLERANCE


def _below_tolerance_of_mujoco(recording: Described, simulation: Simulation) -> bool:
    return simulation.options.get("solver") == "mujoco" and _below_tolerance(recording, simulation)


def _smaller_tolerance(simulator: str, shown: Callable[[Described, Simulation], bool]) -> KnownError:
    return KnownError(
        simulator,
        "the stated tolerance is smaller than 1e-6, which was in force",
        "docs/simulators.md, warp",
        shown,
        in_force=(("tolerance", _TOLERANCE),),
    )


KNOWN_ERRORS = (
    KnownError(
        "brax",
        "each timed step searched for collisions twice, so throughput was too low: with 4,096 environments of 27 cubes "
        "on an H100, 0.61 of the right value",
        "docs/simulators.md, brax",
        _searched_twice,
        timed_steps=True,
    ),
    KnownError(
        "genesis",
        "the stated constraint_timeconst is smaller than the value in force, which was two substeps",
        "docs/simulators.md, genesis",
        _below_two_substeps,
    ),
    KnownError(
        "isaaclab",
        "the stated deviations lack that friction of PhysX acts at two points of each contact patch",
        "docs/simulators.md, isaaclab",
        _without_friction_points,
    ),
    KnownError(
        "newton",
        "the recorder turned the model's multiccd off, so two convex shapes, such as meshes, had 1 contact instead of "
        "several; contacts with planes, and of spheres and capsules with each other, are not affected",
        "docs/simulators.md, newton",
        _without_multiccd,
    ),
    _smaller_tolerance("newton", _below_tolerance_of_mujoco),
    _smaller_tolerance("warp", _below_tolerance),
)
"""All known errors."""


def known_errors(recording: Described) -> tuple[KnownError, ...]:
    """Those that a recording shows; none of a program's own recording, which no adapter made."""
    simulation = recording.simulation
    if simulation is None or recording.of_program:
        return ()
    simulator = recording.configuration.simulator
    return tuple(e for e in KNOWN_ERRORS if e.simulator == simulator and e.shown(recording, simulation))


def options_in_force(recording: Described) -> dict[str, Any]:
    """Options as the engine stepped with them: as a known error, a deviation `option.NAME` with a number, or else the
    engine's own record has them. Empty where the run ended before the engine said them."""
    if recording.simulation is None:
        return {}
    found = _stated(recording.simulation)
    for error in known_errors(recording):
        found.update(error.in_force)
    return found


def wrong_time(recording: Described) -> str:
    """Why the time of timed steps is wrong; empty where no known error says so."""
    return next((f"{PREFIX}{error.said}" for error in known_errors(recording) if error.timed_steps), "")


def notes(recordings: Sequence[Described]) -> list[str]:
    """A sentence for each error that some of the recordings show, with how many they are where not all do."""
    found: dict[str, int] = {}
    for recording in recordings:
        for error in known_errors(recording):
            found[f"{PREFIX}{error.said}"] = found.get(f"{PREFIX}{error.said}", 0) + 1
    built = sum(recording.simulation is not None for recording in recordings)
    return [
        said if count == built else f"{count} of {plural(len(recordings), 'run')}: {said}"
        for said, count in found.items()
    ]


def _stated(simulation: Simulation) -> dict[str, Any]:
    # some adapters record a number of the model, and what the engine makes of it as a deviation
    found = dict(simulation.options)
    for deviation in simulation.deviations:
        name = deviation.parameter.removeprefix("option.")
        if name != deviation.parameter and isinstance(found.get(name), float):
            with suppress(ValueError):
                found[name] = float(deviation.used)
    return found


def _number(value: Any) -> float:
    # options of a stranger's file may be anything; 0 stands for what is no number
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0 else 0.0
