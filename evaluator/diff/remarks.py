"""Sentences on what could not be compared, and on what a reader must know beside."""

from __future__ import annotations

import numpy as np

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.common import CommonField
from gpusimbench.evaluator.diff.program_parts import ProgramDifference
from gpusimbench.evaluator.diff.result import Basis
from gpusimbench.evaluator.diff.selection import Selection
from gpusimbench.evaluator.diff.splits import Agreement, CommonHashes
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.evaluator.metrics.identity import unchanging
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

Fields = tuple[CommonField, ...]

_FIELDS = 8  # named; of the others, how many


def no_times(a: Selection, b: Selection) -> str:
    """Why there is nothing to compare where time steps have no common multiple."""
    dt_a, dt_b = (side.recording.configuration.dt for side in (a, b))
    return f"steps of {dt_a:g} s and {dt_b:g} s have no simulated times in common"


def no_classes(a: Selection, b: Selection, fields: Fields) -> str:
    """Why an environment can be held against its own counterpart alone; empty where it can be against any."""
    if any(field.basis is Basis.FLOAT32 for field in fields):
        return "one recording is float32, the other float64"
    for field in fields:
        origins = np.concatenate([a.offsets(field.a), b.offsets(field.b)])
        if (origins != origins[0]).any():
            return "the environments have different origins, which are part of their positions"
    return ""


def nothing(a: Selection, b: Selection, fields: Fields, no_hashes: str) -> str:
    """Why there is nothing to compare where neither states nor hashes are common."""
    if not fields:
        return f"{a.recording.path} and {b.recording.path} have no state field in common"
    return (
        f"{a.recording.path} and {b.recording.path} have no recorded state of a common step, and their hashes cannot "
        f"be compared: {no_hashes}"
    )


def no_growth(fields: Fields, *, states: bool) -> str:
    """Why distances cannot be told; `states` says whether any common state was recorded."""
    if not any(field.is_position for field in fields):
        joints = states and any(field.a.field == "qpos" for field in fields)
        more = " (of joints, the table of fields has the largest differences)" if joints else ""
        return f"no positions of bodies were recorded by both{more}"
    return "no states of a common step were recorded"


def uncommon(a: Selection, b: Selection, states: CommonStates) -> list[str]:
    """Environments and steps that one side has alone."""
    found = []
    n_a, n_b = (side.recording.configuration.n_env for side in (a, b))
    if n_a != n_b and len(a.envs) == len(b.envs) > 1:
        found.append(f"environments from {min(n_a, n_b)} on: a has {n_a}, b has {n_b}")
    for number, name in enumerate("ab"):
        fields = gathered((states.ends(index)[number], how.field.name) for index, how in enumerate(states.fields))
        for ends, names in fields.items():
            if ends.own is None or ends.own == ends.common:
                continue
            of_which = "" if len(names) == len(states.fields) else f" of {words.names(names, _FIELDS)}"
            since = "" if ends.common is None else f" after its step {ends.common}"
            found.append(f"states of {name}{of_which}{since}, up to {ends.own}")
    return found


def arrays(a: Selection, b: Selection, program: ProgramDifference | None) -> list[str]:
    """Arrays of the program that one side hashed alone, or that cannot be compared."""
    if program is not None:
        sides = (("a", program.only_a), ("b", program.only_b))
        return [f"hashes of {name}: only in {side}" for side, names in sides for name in names]
    if a.recording is not b.recording and (a.recording.program or b.recording.program):
        why = "these are of other environments" if a.envs != b.envs else "the time steps differ"
        return [f"hashes of arrays of the program: {why}"]
    return []


def notes(a: Selection, b: Selection, fields: Fields, hashes: CommonHashes | None) -> tuple[str, ...]:
    """Sentences that a reader must see beside the difference."""
    found = []
    for side in dict.fromkeys((a.recording, b.recording)):
        if side.status in ("failed", "invalid"):
            found.append(f"{side.path} is {side.status}: {side.reason}")
        if why := side.unconfirmed:
            found.append(f"{side.path} is {why}")
    if a.recording is b.recording and a.recording.action_streams and not a.recording.action_names:
        found.append("actions were applied; environments that are given other actions differ by design")
    elif a.recording is b.recording and a.recording.apart_by_design:
        found.append(a.recording.apart_by_design)
    if hashes is not None and hashes.phase != "capture":
        found.append(f"the hashes are those of the {hashes.phase} phase: of the steps that it began and ended with")
    if still := [name for name, side in (("a", a), ("b", b)) if _is_still(side)]:
        found.append(
            f"nothing moves in {' and '.join(still)}: every captured state is that of the start, so that agreement "
            "says nothing of how bodies move. Record another start or controls, such as --initial random:0.1"
        )
    if any(field.basis is Basis.LOCAL for field in fields):
        found.append(
            "origins differ, so positions cannot be compared by bits: origins are subtracted in float64, and "
            "differences below the spacing of the recorded numbers at that distance from the world's origin count as "
            "equal"
        )
    if any(field.basis is Basis.FLOAT32 for field in fields):
        found.append(
            "one recording is float32, the other float64: not comparable by bits; differences below the spacing of "
            "float32 count as equal, and distances in ULPs are those of float32"
        )
    return tuple(found)


def _is_still(side: Selection) -> bool:
    found = side.recording.fingerprints("capture")
    return found is not None and unchanging(found.hashes[:, list(side.envs)])


def timed(agreement: Agreement | None) -> tuple[str, ...]:
    """What the hashes of the timed phase say, which are compared beside those of the capture, where they differ."""
    if agreement is None or agreement.first is None:
        return ()
    first, of = agreement.first, f"{plural(agreement.pairs, 'pair')} of envs"
    return (
        f"state hashes of the timed phase differ: first at its step {agreement.first_step()}, {first.count} of {of}",
    )
