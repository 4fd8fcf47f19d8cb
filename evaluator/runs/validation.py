"""What a recording has to say so that its numbers can be used: the one list of it that all commands go by.

`gsb-check`, `gsb-info` and `gsb-share` name everything in the list that does not hold (`evaluator.check.integrity`),
`verify` stops at the first: so no command takes a file that another command calls damaged.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.failing import KINDS, ONLY_FAILING, LastStates
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of, radii_of, supports_of
from gpusimbench.evaluator.runs.physics.measure import check_described
from gpusimbench.evaluator.runs.positions import check_format, outcome_of, positional
from gpusimbench.schemas import checks
from gpusimbench.schemas.commands.progress import each, sizes
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, DamagedRecording, damage_in
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.model_files import COMPRESSED, MODEL, plain
from gpusimbench.schemas.view.motion import Motion

LONGEST_S = 1e9
"""Of a time that a scene names [s]."""


def demands(recording: Recording) -> Iterator[Callable[[], object]]:
    """Calls, each of which reads or compares one part of a recording; an error of NUMBERS_OF_A_STRANGER or a GsbError
    says that the part is damaged.

    No call reads states or actions: their bytes have digests, and reading them costs what they are large.
    """
    yield lambda: recording.timing
    yield lambda: recording.memory
    yield lambda: recording.hardware
    yield lambda: recording.counts
    yield lambda: recording.overflows
    yield lambda: recording.action_streams
    yield lambda: recording.events
    yield lambda: recording.dropouts
    yield lambda: recording.fingerprints("capture")
    yield lambda: recording.fingerprints("timed")
    yield lambda: _updated(recording)
    yield lambda: _failed(recording)
    for field in recording.fields:
        yield lambda field=field: recording.state(field.group, field.field)  # type: ignore[misc]
        if field.field == "position":
            yield lambda field=field: check_format(recording, field)  # type: ignore[misc]
    yield lambda: _same_rows(recording)
    yield lambda: _hashed(recording)
    yield recording.check_metadata
    yield lambda: _described(recording)
    yield lambda: _model(recording)
    yield lambda: board_of(recording)
    yield lambda: supports_of(recording)
    for field in positional(recording.fields):
        yield lambda field=field: radii_of(recording, field)  # type: ignore[misc]
    yield lambda: outcome_of(recording)
    yield lambda: check_described(recording)
    yield lambda: _drawn(recording)
    if recording.usable:
        yield lambda: timed_of(recording)
        yield lambda: check_overflow(recording)


def verify(recording: Recording) -> None:
    """Read everything and check it: CRCs, digests, the content hash, and that no part contradicts another.

    A recording without an end record has no digests; only its CRCs are checked. Raises DamagedRecording that names the
    first thing that is wrong.
    """
    recording.check_digests()
    if recording.content_hash:
        validate(recording)


def verified(files: Sequence[Place]) -> list[Recording]:
    """Open recordings, and verify each; DamagedRecording for the first that is not whole."""
    found = []
    for path in each(files, "verifying recordings", sizes(files)):
        recording = Recording(path)
        verify(recording)
        found.append(recording)
    return found


def validate(recording: Recording) -> None:
    """DamagedRecording with the first demand that a recording does not meet."""
    for demand in demands(recording):
        try:
            demand()
        except NUMBERS_OF_A_STRANGER as error:
            raise DamagedRecording(f"{recording.path}: {str(error) or type(error).__name__}") from None


def _hashed(recording: Recording) -> None:
    # a hash is of all fields; where there are hashes, each recorded state of a whole run has one
    hashes = recording.fingerprints("capture")
    arrays = [recording.state(field.group, field.field) for field in recording.fields]
    if hashes is None or recording.status == "incomplete" or not arrays or not all(map(len, arrays)):
        return
    bare = np.setdiff1d(arrays[0].steps, hashes.steps)
    if len(bare):
        raise DamagedRecording(f"{recording.path}: the state of step {bare[0]} has no state hash, and others have")


def _updated(recording: Recording) -> None:
    # no update follows more states than there are
    most = recording.configuration.captured_steps + 1
    for name, updates in recording.program.items():
        if updates.states[-1] > most:
            raise DamagedRecording(
                f"{recording.path}: update {len(updates.states) - 1} of {name} follows {updates.states[-1]} states, "
                f"and there are {most}"
            )


def _failed(recording: Recording) -> None:
    # the failures that are listed are those that the states show
    failing = recording.failing
    c = recording.configuration
    if failing is None:
        if c.keep and recording.status in ("complete", "invalid") and "capture" in c.phases:
            entered = any(event.phase == "capture" for event in recording.events)
            if entered or recording.status == "complete":
                raise DamagedRecording(f"{recording.path}: nothing says which environments failed ({ONLY_FAILING})")
        return
    if failing.total and recording.status == "complete":
        raise DamagedRecording(f"{recording.path}: the run is complete, and {failing.total} environments failed")
    for failure in failing.failures:
        last = recording.last_states(failure.env)
        states = last.states
        _hashed_alike(recording, failure.env, last)
        if failure.kind != KINDS[0]:
            continue
        finite = [
            np.isfinite(states[field.name][failure.step - failure.first_step, item, place])
            for field in recording.fields
            for item, named in enumerate(field.items)
            for place, component in enumerate(field.components)
            if (field.name, named, component) == (failure.field, failure.item, failure.component)
        ]
        if not finite or all(finite):
            raise DamagedRecording(
                f"{recording.path}: environment {failure.env} is said to be not finite at step {failure.step}, and its "
                "states there are"
            )


def _hashed_alike(recording: Recording, env: int, last: LastStates) -> None:
    # where the states of an environment reach back to the first step, or up to the last, they have hashes
    hashes = recording.fingerprints("capture")
    if hashes is None:
        return
    common, at_hashes, at_states = np.intersect1d(hashes.steps, last.steps, return_indices=True)
    rows = [np.ascontiguousarray(last.states[field.name][at_states]) for field in recording.fields]
    wrong = fingerprint(rows) != hashes.hashes[at_hashes, env]
    if wrong.any():
        raise DamagedRecording(
            f"{recording.path}: the hash of environment {env} at step {common[wrong][0]} is not that of its state"
        )


def _described(recording: Recording) -> None:
    scene = recording.scene
    with damage_in(f"{recording.path}: scene.json"):
        for name in ("name", "board", "summary"):
            checks.text(scene, name, default="")
        for name in ("dt", "sample_time"):
            if name in scene:
                checks.number(scene, name, 0, LONGEST_S)
        if "gravity" in scene:
            checks.vector(scene["gravity"], 3, "gravity")
        for name in ("parameters", "robot", "actions"):
            checks.mapping(scene, name)


def _model(recording: Recording) -> None:
    # digests are of attachments as they lie: they do not show that an archive is the one that the run was asked for
    model = recording.configuration.model
    for name in (MODEL, COMPRESSED) if model else ():
        data = recording.attachment(name)
        with damage_in(recording.path):
            other = data is not None and hashlib.sha256(plain(name, data)).hexdigest() != model
        if other:
            raise DamagedRecording(f"{recording.path}: {name} is not the model whose SHA-256 the configuration names")


def _drawn(recording: Recording) -> None:
    try:
        Motion(recording.fields, recording.look)
    except DamagedRecording as error:
        raise DamagedRecording(f"{recording.path}: {str(error).removeprefix(f'{recording.path}: ')}") from None


def _same_rows(recording: Recording) -> None:
    # of a run that was cut short, some fields may have a row more than others
    rows = {len(recording.state(field.group, field.field)) for field in recording.fields}
    if recording.status != "incomplete" and len(rows) > 1:
        raise DamagedRecording(f"{recording.path}: the state fields have different numbers of rows")


NOT_TIMED = Missing("the timed phase was left out")


def timed_of(recording: Recording) -> tuple[int, float] | Missing:
    """Steps of the timed phase, all windows together, and how long they took [s].

    DamagedRecording where the clocks are of other steps.
    """
    timing = recording.timing.get("timed")
    if timing is None:
        return NOT_TIMED
    c = recording.configuration
    times = timing.times_of(c.timed_steps)
    if times is None:
        raise DamagedRecording(
            f"{recording.path}: {len(timing.start_ns)} intervals of {timing.steps_per_interval} steps were timed, "
            f"not the {c.timed_steps} steps that were asked for"
        )
    return times * c.timed_steps, timing.elapsed_s


def check_overflow(recording: Recording) -> None:
    """DamagedRecording where a complete run dropped work.

    The recorder calls such a run invalid; a file that does not was made, or changed, by something else.
    """
    described = recording.simulation.overflow_bits if recording.simulation else ()
    for phase, overflows in recording.overflows.items():
        if fatal := overflows.fatal(described):
            raise DamagedRecording(
                f"{recording.path}: the run says that it is complete, but {fatal[0]} overflowed by step {fatal[1]} of "
                f"the {phase} phase"
            )
