"""Two recordings, or environments of one: what is common is read once, step by step, and held against each other; and
sentences on what could not be compared."""

from __future__ import annotations

import numpy as np

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.common import CommonField, Selection, common_fields, one_env, step_ratio
from gpusimbench.evaluator.diff.first import compare_program, first_divergence
from gpusimbench.evaluator.diff.numbers import pairing
from gpusimbench.evaluator.diff.program_parts import ProgramDifference
from gpusimbench.evaluator.diff.result import Basis, ComparedStates, Difference
from gpusimbench.evaluator.diff.settings import differing_settings, is_other_package
from gpusimbench.evaluator.diff.splits import Agreement, CommonHashes, common_hashes, step_range, timed_hashes
from gpusimbench.evaluator.diff.states import BodyOrder, CommonStates
from gpusimbench.evaluator.diff.walk import walk_hashes, walk_states
from gpusimbench.evaluator.metrics.identity import unchanging
from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import NothingComparable, UsageError
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

_FIELDS = 8  # named; of the others, how many


def compare(a: Recording, b: Recording, *, envs: tuple[int, int] | None = None) -> Difference:
    """The same environments of two recordings.

    envs  one environment of a and one of b; None: every environment that both have, by its number

    Raises NothingComparable where they have nothing in common, UsageError for an environment that is not there,
    DamagedRecording where a file is not what it says.
    """
    if envs is not None:
        return _compare(one_env(a, envs[0]), one_env(b, envs[1]))
    both = range(min(a.configuration.n_env, b.configuration.n_env))
    return _compare(Selection(a, both), Selection(b, both))


def compare_envs(recording: Recording, first: int, second: int) -> Difference:
    """Two environments of one recording; raises as `compare` does."""
    if first == second:
        raise UsageError(f"give two different environments, not {first} twice")
    return _compare(one_env(recording, first), one_env(recording, second))


def compare_all_envs(recording: Recording) -> Difference:
    """Environment 0 of a recording with all of its others, and all with each other; raises as `compare` does."""
    n_env = recording.configuration.n_env
    if n_env < 2:
        raise NothingComparable(f"{recording.path} has one environment, and nothing to compare it with")
    return _compare(one_env(recording, 0), Selection(recording, range(1, n_env)))


def _compare(a: Selection, b: Selection) -> Difference:
    ratio = step_ratio(a.recording.configuration.dt, b.recording.configuration.dt)
    if ratio is None:
        raise NothingComparable(_no_times(a, b))
    fields, left_out = common_fields(a, b)
    states = CommonStates(a, b, [pairing(field, a, b) for field in fields], ratio)
    found = common_hashes(a, b, fields, ratio, states=bool(len(states)))
    hashes = known(found)
    if hashes is None and not len(states):
        raise NothingComparable(_nothing_common(a, b, fields, why_missing(found)))
    no_classes = _why_no_classes(a, b, fields)
    walked = walk_states(states, a, b, hashes=hashes, classes=hashes is None and not no_classes)
    hashed = walk_hashes(hashes, classes=not no_classes) if hashes else None
    of_timed = timed_hashes(a, b, fields, ratio, hashes)
    timed = walk_hashes(of_timed, classes=not no_classes) if of_timed else None
    agreement = hashed or walked.agreement
    first = first_divergence(a, b, ratio, states, walked.agreement, hashed, timed)
    bitwise = all(field.basis is Basis.BITS for field in fields)
    same_envs = _same_up_to_order(a, b, agreement, timed)
    bodies = None
    if first is not None and not same_envs and not no_classes and len(states):
        bodies = BodyOrder(states, a, b)
        bodies.look()
    one_recording = a.recording is b.recording
    settings = () if one_recording else differing_settings(a.recording, b.recording)
    program = None
    if not one_recording and ratio == 1 and a.envs == b.envs:
        program = compare_program(a.recording, b.recording, walked.fields, first)
    return Difference(
        a=a.side(),
        b=b.side(),
        one_recording=one_recording,
        compared=ComparedStates(
            fields=walked.fields,
            n_env=agreement.pairs,
            state_steps=step_range(states.steps_a.tolist()) if len(states) else None,
            hash_steps=step_range(hashes.steps_a.tolist()) if hashes else None,
            hash_phase=hashes.phase if hashes else "",
            timed_steps=step_range(of_timed.steps_a.tolist()) if of_timed else None,
            unseen_steps=sum(side.unseen(states.steps_a) for side in (hashes, of_timed) if side),
            hash_steps_missing=why_missing(found),
            left_out=(*left_out, *_uncommon_states(a, b, states), *_uncommon_arrays(a, b, program)),
        ),
        bitwise=bitwise,
        bit_identical=bitwise and first is None and (program is None or program.first is None),
        same_up_to_env_order=same_envs,
        same_up_to_body_order=None if bodies is None else bodies.in_env or bodies.any_env,
        bodies_of_other_envs=bodies is not None and bodies.any_env and not bodies.in_env,
        first=first,
        max_ulp=max((f.max_ulp for f in walked.fields if f.max_ulp is not None), default=None),
        growth=walked.growth or Missing(_why_no_growth(fields, states=bool(len(states)))),
        splits=agreement.splits(no_classes, by_hashes=hashes is not None),
        settings=settings,
        other_packages=sum(is_other_package(one, a.recording, b.recording) for one in settings),
        copies=not one_recording and a.recording.provenance.run_id == b.recording.provenance.run_id,
        notes=(*_notes(a, b, fields, hashes), *_on_timed(timed)),
        program=program,
        described=a.recording.simulation is not None and b.recording.simulation is not None,
    )


def _same_up_to_order(a: Selection, b: Selection, agreement: Agreement, timed: Agreement | None) -> bool | None:
    # an order is between two whole sets of environments
    whole = all(len(side.envs) == side.recording.configuration.n_env for side in (a, b))
    classes = agreement.classes
    return classes.same_up_to_order(timed.classes if timed else None) if whole and classes else None


def _no_times(a: Selection, b: Selection) -> str:
    """Why there is nothing to compare where time steps have no common multiple."""
    dt_a, dt_b = (side.recording.configuration.dt for side in (a, b))
    return f"steps of {dt_a:g} s and {dt_b:g} s have no simulated times in common"


def _why_no_classes(a: Selection, b: Selection, fields: tuple[CommonField, ...]) -> str:
    """Why an environment can be held against its own counterpart alone; empty where it can be against any."""
    if any(field.basis is Basis.FLOAT32 for field in fields):
        return "one recording is float32, the other float64"
    for field in fields:
        origins = np.concatenate([a.offsets(field.a), b.offsets(field.b)])
        if (origins != origins[0]).any():
            return "the environments have different origins, which are part of their positions"
    return ""


def _nothing_common(a: Selection, b: Selection, fields: tuple[CommonField, ...], no_hashes: str) -> str:
    """Why there is nothing to compare where neither states nor hashes are common."""
    if not fields:
        return f"{a.recording.path} and {b.recording.path} have no state field in common"
    return (
        f"{a.recording.path} and {b.recording.path} have no recorded state of a common step, and their hashes cannot "
        f"be compared: {no_hashes}"
    )


def _why_no_growth(fields: tuple[CommonField, ...], *, states: bool) -> str:
    """Why distances cannot be told; `states` says whether any common state was recorded."""
    if not any(field.is_position for field in fields):
        joints = states and any(field.a.field == "qpos" for field in fields)
        more = " (of joints, the table of fields has the largest differences)" if joints else ""
        return f"no positions of bodies were recorded by both{more}"
    return "no states of a common step were recorded"


def _uncommon_states(a: Selection, b: Selection, states: CommonStates) -> list[str]:
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


def _uncommon_arrays(a: Selection, b: Selection, program: ProgramDifference | None) -> list[str]:
    """Arrays of the program that one side hashed alone, or that cannot be compared."""
    if program is not None:
        sides = (("a", program.only_a), ("b", program.only_b))
        return [f"hashes of {name}: only in {side}" for side, names in sides for name in names]
    if a.recording is not b.recording and (a.recording.program or b.recording.program):
        why = "these are of other environments" if a.envs != b.envs else "the time steps differ"
        return [f"hashes of arrays of the program: {why}"]
    return []


def _notes(a: Selection, b: Selection, fields: tuple[CommonField, ...], hashes: CommonHashes | None) -> tuple[str, ...]:
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


def _on_timed(agreement: Agreement | None) -> tuple[str, ...]:
    """What the hashes of the timed phase say, which are compared beside those of the capture, where they differ."""
    if agreement is None or agreement.first is None:
        return ()
    first, of = agreement.first, f"{plural(agreement.pairs, 'pair')} of envs"
    return (
        f"state hashes of the timed phase differ: first at its step {agreement.first_step()}, {first.count} of {of}",
    )
