"""What the end record claims of the content, held against the content: everything that differs, by name."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.check.integrity.problem import Kind, Problems, without_path
from gpusimbench.evaluator.check.integrity.scan import Scan
from gpusimbench.evaluator.read.actions import ActionContents
from gpusimbench.evaluator.read.messages import MAX_END_BYTES, Messages
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.read.streams import Fingerprints, read_fingerprints
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.digest import ContentDigest, attachment_name, content_hash, state_name
from gpusimbench.schemas.errors import RecordingError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.provenance import Provenance, Simulation
from gpusimbench.schemas.text import few

_READ_BYTES = 64 << 20
_READ_ROWS = 50  # a block's rows, so that few are decoded twice
_SHOWN = 3
_STATE = "state "
"""What the names of the digests of states begin with."""


def read_end(scan: Scan, problems: Problems) -> Any:
    """The end record; None where there is not exactly one that can be read."""
    if len(scan.ends) != 1:
        what = "no end record: the run's process died, or the file was cut short"
        problems.add(Kind.end, f"the run ends {len(scan.ends)} times" if scan.ends else what)
        return None
    if len(scan.ends[0]) > MAX_END_BYTES:
        problems.add(Kind.end, f"the end record has {len(scan.ends[0])} bytes; at most {MAX_END_BYTES} are read")
        return None
    try:
        return message_class("gsb.v1.RunEnd").FromString(scan.ends[0])
    except Exception as error:  # protobuf's DecodeError differs between its backends
        problems.add(Kind.end, f"the end record cannot be parsed: {error}")
        return None


def check_content(
    path: Path, provenance: Provenance | None, simulation: Simulation | None, scan: Scan, end: Any, problems: Problems
) -> None:
    """Recompute every digest that can be; hold state hashes against the states.

    provenance, simulation  None where they cannot be read; what the states are is then not known
    end                     None where nothing claims a digest; the states that are there still have hashes
    """
    if end is None:
        _check_states_alone(path, provenance, simulation, problems)
        return
    claimed = dict(end.digests)
    found = {attachment_name(name): hashlib.sha256(data).hexdigest() for name, data in scan.attachments.items()}
    scan.doubtful.update(
        name for name in scan.attachments if found[attachment_name(name)] != claimed.get(attachment_name(name))
    )
    found |= scan.digest.digests()
    lost: dict[str, str] = {}
    try:
        container = Container(path)
    except RecordingError as error:
        reason = without_path(error, path)
        states = [name for name in claimed if name.startswith(_STATE)]
        moved = [s.topic for s in scan.streams.values() if s.generated or not s.in_order]
        lost = dict.fromkeys([*states, *moved], reason)
        problems.skip(reason, Kind.state_hash)
    else:
        found |= _reordered(container, scan, lost)
        if provenance is not None and simulation is not None:
            found |= _states(container, provenance.configuration, simulation.fields, lost, problems, ended=True)
        else:
            lost |= {name: "nothing says what they are" for name in claimed if name.startswith(_STATE)}
            if topics.fingerprint("capture") in scan.streams:
                problems.skip("nothing says what the states are that the hashes are of", Kind.state_hash)
    if named := sorted(lost):
        problems.add(Kind.digest, f"not checked, since it cannot be read: {few(named, _SHOWN)}: {lost[named[0]]}")
        if states := [name for name in named if name.startswith(_STATE)]:
            problems.skip(lost[states[0]], Kind.state_hash)
    for name in sorted((claimed.keys() | found.keys()) - lost.keys()):
        if claimed.get(name) != found.get(name):
            what = "is missing" if name not in found else "was added" if name not in claimed else "was changed"
            problems.add(Kind.digest, f"{name} {what} since the recording was made")
    names = {number: name for name, number in enum_values("gsb.v1.RunStatus").items()}
    status = names.get(end.status, "").removeprefix("RUN_STATUS_").lower()
    if content_hash(claimed, status, end.reason) != end.content_hash:
        problems.add(Kind.content_hash, "the end record was changed since the recording was made")


def _check_states_alone(
    path: Path, provenance: Provenance | None, simulation: Simulation | None, problems: Problems
) -> None:
    if provenance is None:
        problems.skip("nothing says what the states are", Kind.state_hash)
        return
    container = Container(path)
    lost: dict[str, str] = {}
    _states(container, provenance.configuration, simulation.fields if simulation else (), lost, problems, ended=False)
    for name, reason in lost.items():
        problems.add(Kind.stream, f"{name} cannot be read: {reason}")
        problems.skip(reason, Kind.state_hash)


def _reordered(container: Container, scan: Scan, lost: dict[str, str]) -> dict[str, str]:
    # another tool may have written messages in another order; a digest follows their numbers, and is of drawn actions
    found: dict[str, str] = {}
    actions = ActionContents(container)
    for topic, stream in scan.streams.items():
        if (stream.in_order and not stream.generated) or not topics.has_digest(topic):
            continue
        digest = ContentDigest()
        try:
            if stream.generated:
                actions.digest(topic, digest)
            else:
                for content in container.in_sequence(topic):
                    digest.message(topic, content)
        except RecordingError as error:
            lost[topic] = without_path(error, container.path).removeprefix(f"{topic}: ")
        else:
            found |= digest.digests()
    return found


def _states(
    container: Container, configuration: RunConfiguration, fields: Sequence[StateField], lost: dict[str, str],
    problems: Problems, *, ended: bool,
) -> dict[str, str]:  # fmt: skip
    # digests by name; what cannot be read is added to `lost`. `ended`: nothing was cut off
    stated = {(p.group, p.field) for p in map(topics.parse_state, container.channels) if p}
    arrays: dict[str, StateArray] = {}
    for field in fields:
        if (field.group, field.field) in stated:
            try:
                arrays[state_name(field)] = StateArray(container, configuration, field)
            except RecordingError as error:
                lost[state_name(field)] = without_path(error, container.path)
    if ended and len({len(array) for array in arrays.values()}) > 1:
        problems.add(Kind.stream, "the state fields have different numbers of rows")
        problems.skip("the state fields have different numbers of rows", Kind.state_hash)
    hashes = _hashes(container, configuration, problems)
    missing = [f.name for f in fields if state_name(f) not in lost and not len(arrays.get(state_name(f), ()))]
    if configuration.keep and len(missing) == len(fields):
        return {}  # hashes are of the first step and the last, and no states were kept
    if hashes is not None and missing:
        told = few(missing, _SHOWN)
        problems.skip(f"hashes are of all fields, and states of {told} are not there", Kind.state_hash)
    elif hashes is not None and not fields:
        problems.skip("nothing says what the states are that the hashes are of", Kind.state_hash)
    digests = {name: ContentDigest() for name in arrays}
    for rows in _ranges(list(arrays.values())):
        blocks, steps = [], []
        for name, array in arrays.items():
            if name in lost:
                continue
            try:
                block = array.read(rows, slice(None))
            except RecordingError as error:
                lost[name] = without_path(error, container.path)
                continue
            digests[name].state(array.field, configuration.n_env, block)
            blocks.append(block)
            steps.append(array.steps[rows])
        if hashes is not None and len(blocks) == len(fields):
            _compare(hashes, blocks, steps, problems)
    return {name: digest for name, d in digests.items() if name not in lost for digest in d.digests().values()}


def _hashes(container: Container, configuration: RunConfiguration, problems: Problems) -> Fingerprints | None:
    try:
        return read_fingerprints(Messages(container), "capture", n_env=configuration.n_env, cut_short=True)
    except RecordingError as error:  # told as a stream that cannot be read
        problems.skip(without_path(error, container.path), Kind.state_hash)
        return None


def _compare(hashes: Fingerprints, blocks: Sequence[Any], steps: Sequence[Any], problems: Problems) -> None:
    import numpy as np

    rows = min(map(len, steps))  # a run that was cut short may have a row more of some fields than of others
    common = steps[0][:rows]
    if any((other[:rows] != common).any() for other in steps):
        problems.skip("the state fields are of different steps", Kind.state_hash)
        return
    computed = fingerprint([block[:rows] for block in blocks])
    _, at_recorded, at_computed = np.intersect1d(hashes.steps, common, return_indices=True)
    wrong = (hashes.hashes[at_recorded] != computed[at_computed]).any(axis=1)
    for step in common[at_computed[wrong]]:
        problems.add(Kind.state_hash, f"at step {step}")


def _ranges(arrays: Sequence[StateArray]) -> Iterator[slice]:
    # rows that fit into memory together; the initial state is a block of its own
    if not arrays:
        return
    row = sum(math.prod(array.shape[1:]) * array.dtype.itemsize for array in arrays)
    count = max(1, min(_READ_ROWS, _READ_BYTES // max(row, 1)))
    last = max(len(array) for array in arrays)
    if last:
        yield slice(0, 1)
    for begin in range(1, last, count):
        yield slice(begin, begin + count)
