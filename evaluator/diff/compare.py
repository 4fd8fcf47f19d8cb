"""Two recordings, or environments of one: what is common is read once, step by step, and held against each other."""

from __future__ import annotations

from gpusimbench.evaluator.diff import remarks
from gpusimbench.evaluator.diff.common import common_fields, step_ratio
from gpusimbench.evaluator.diff.first import first_divergence
from gpusimbench.evaluator.diff.numbers import pairing
from gpusimbench.evaluator.diff.program import compare_program
from gpusimbench.evaluator.diff.result import Basis, ComparedStates, Difference
from gpusimbench.evaluator.diff.selection import Selection, one_env
from gpusimbench.evaluator.diff.settings import differing_settings, is_other_package
from gpusimbench.evaluator.diff.splits import Agreement, common_hashes, step_range, timed_hashes
from gpusimbench.evaluator.diff.states import BodyOrder, CommonStates
from gpusimbench.evaluator.diff.walk import walk_hashes, walk_states
from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import NothingComparable, UsageError


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
        raise NothingComparable(remarks.no_times(a, b))
    fields, left_out = common_fields(a, b)
    states = CommonStates(a, b, [pairing(field, a, b) for field in fields], ratio)
    found = common_hashes(a, b, fields, ratio, states=bool(len(states)))
    hashes = known(found)
    if hashes is None and not len(states):
        raise NothingComparable(remarks.nothing(a, b, fields, why_missing(found)))
    no_classes = remarks.no_classes(a, b, fields)
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
            left_out=(*left_out, *remarks.uncommon(a, b, states), *remarks.arrays(a, b, program)),
        ),
        bitwise=bitwise,
        bit_identical=bitwise and first is None and (program is None or program.first is None),
        same_up_to_env_order=same_envs,
        same_up_to_body_order=None if bodies is None else bodies.in_env or bodies.any_env,
        bodies_of_other_envs=bodies is not None and bodies.any_env and not bodies.in_env,
        first=first,
        max_ulp=max((f.max_ulp for f in walked.fields if f.max_ulp is not None), default=None),
        growth=walked.growth or Missing(remarks.no_growth(fields, states=bool(len(states)))),
        splits=agreement.splits(no_classes, by_hashes=hashes is not None),
        settings=settings,
        other_packages=sum(is_other_package(one, a.recording, b.recording) for one in settings),
        copies=not one_recording and a.recording.provenance.run_id == b.recording.provenance.run_id,
        notes=(*remarks.notes(a, b, fields, hashes), *remarks.timed(timed)),
        program=program,
        described=a.recording.simulation is not None and b.recording.simulation is not None,
    )


def _same_up_to_order(a: Selection, b: Selection, agreement: Agreement, timed: Agreement | None) -> bool | None:
    # an order is between two whole sets of environments
    whole = all(len(side.envs) == side.recording.configuration.n_env for side in (a, b))
    classes = agreement.classes
    return classes.same_up_to_order(timed.classes if timed else None) if whole and classes else None
