"""One recording: what it says of itself, and its streams as arrays."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.actions import (
    ActionContents,
    action_names,
    check_actions,
    described_generator,
    read_actions,
)
from gpusimbench.evaluator.read.described import Described, Factors, factors_of
from gpusimbench.evaluator.read.digests import Updates, digest_states, read_program
from gpusimbench.evaluator.read.evidence import (
    ActionStream,
    HardwareTrace,
    Overflows,
    StepCounts,
    read_action_streams,
    read_counts,
    read_hardware,
    read_overflows,
)
from gpusimbench.evaluator.read.failing import Failing, LastStates, read_failing, read_last_states
from gpusimbench.evaluator.read.messages import MAX_END_BYTES, Messages
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.read.streams import (
    Event,
    Fingerprints,
    MemoryTrace,
    StepTiming,
    read_dropouts,
    read_events,
    read_fingerprints,
    read_memory,
    read_timing,
)
from gpusimbench.schemas import checks, topics
from gpusimbench.schemas.commands.progress import moved
from gpusimbench.schemas.digest import ContentDigest, content_hash
from gpusimbench.schemas.errors import DamagedRecording, damage_in
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.mcap.declarations import Channel
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import enum_values
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION, Provenance, Simulation
from gpusimbench.schemas.source import Source
from gpusimbench.schemas.treatment import VARIED
from gpusimbench.schemas.view.geometry import GEOMETRY, Look, look_of

_CRC_SHARE = 0.2  # of the time that a file takes to be read and verified
_KEPT_BYTES = 16 << 20  # of the state hashes of a phase, which are read several times


class Recording(Described):
    """A recording, opened for reading; `verify` checks its content hash."""

    def __init__(self, path: str | Place, source: Source | None = None) -> None:
        self.path = place(path)
        self._container = Container(self.path, source)
        self._messages = Messages(self._container)
        self._json = checks.Budget()
        self._arrays: dict[tuple[str, str], StateArray] = {}
        self._hashes: dict[str, Fingerprints | None] = {}
        text = self._container.attachment(PROVENANCE)
        if text is None:
            raise DamagedRecording(
                f"{self.path}: cut short before its provenance was written; nothing can be said of it"
            )
        self.provenance = self._parse(Provenance.from_json, text)
        text = self._container.attachment(SIMULATION)
        self.simulation = self._parse(Simulation.from_json, text) if text is not None else None
        self._check_origins()
        self._end = self._read_end()
        if self._end is None:
            self.status, self.reason = "incomplete", "no end record: the run's process died or the file was cut short"
        else:
            names = {number: name for name, number in enum_values("gsb.v1.RunStatus").items()}
            self.status = names.get(self._end.status, "unknown").removeprefix("RUN_STATUS_").lower()
            self.reason = self._end.reason
            if self.status not in ("complete", "failed", "invalid"):
                raise DamagedRecording(f"{self.path}: the end record has no status")
        self.cause = "" if self._end is None else _cause(self._end.cause)
        self.content_hash = self._end.content_hash if self._end is not None else ""

    def __repr__(self) -> str:
        c = self.configuration
        return f"<Recording {c.simulator} {c.scene} n_env={c.n_env} run={c.run_index} {self.status}>"

    def state(self, group: str, field: str) -> StateArray:
        """A state field, shape [step, env, item, width], read when indexed; KeyError names the recorded ones."""
        if (group, field) in self._arrays:
            return self._arrays[group, field]
        for described in self.fields:
            if (described.group, described.field) == (group, field):
                array = StateArray(self._container, self.configuration, described)
                if self._end is not None and len(array) and array.steps[-1] != self._end.last_step:
                    raise DamagedRecording(
                        f"{self.path}: states of {described.name} end at step {array.steps[-1]}, the end record says "
                        f"{self._end.last_step}"
                    )
                self._arrays[group, field] = array
                return array
        known = ", ".join(f.name for f in self.fields) or "none"
        raise KeyError(f"{self.path} has no state {group}/{field}; it has: {known}")

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the recorded action streams."""
        return action_names(self._messages)

    def actions(self, name: str) -> NDArray[np.floating]:
        """An action stream, shape [step, env, action]; row i leads from the state of step i to the next.

        KeyError names the recorded ones.
        """
        return read_actions(self._messages, name, **self._capture)

    def check_actions(self, name: str) -> None:
        """Check an action stream as `actions` does, a block at a time."""
        check_actions(self._messages, name, **self._capture)

    @property
    def _capture(self) -> dict[str, Any]:
        c = self.configuration
        return {"n_env": c.n_env, "first_step": c.first_step, "cut_short": self.status == "incomplete"}

    @cached_property
    def timing(self) -> dict[str, StepTiming]:
        """Clocks by phase: "build", "compile_timed", "warmup", "timed", "compile_capture"."""
        return read_timing(self._messages)

    @cached_property
    def memory(self) -> dict[str, MemoryTrace]:
        """Memory readings by source: "host", "gpu0/device", "gpu0/process", "gpu0/allocator", ..."""
        return read_memory(self._messages)

    @cached_property
    def hardware(self) -> dict[str, HardwareTrace]:
        """Clock rates, power, temperature and load by where they are of: "host", "gpu0", ..."""
        return read_hardware(self._messages)

    @cached_property
    def counts(self) -> dict[str, dict[str, StepCounts]]:
        """Counters by phase ("timed", "capture") and name ("contacts", ...)."""
        return read_counts(self._messages)

    @cached_property
    def overflows(self) -> dict[str, Overflows]:
        """Buffers and limits that were run into, by phase; a phase that tells nothing is left out."""
        return read_overflows(self._messages, n_env=self.configuration.n_env)

    @cached_property
    def action_streams(self) -> dict[str, ActionStream]:
        """The actions that were applied, by phase."""
        return read_action_streams(self._messages, n_env=self.configuration.n_env)

    @property
    def acted(self) -> bool:
        """Whether actions were applied; those of a phase without states are known by their generator alone."""
        return bool(self.action_names or self.action_streams)

    def fingerprints(self, phase: str) -> Fingerprints | None:
        """State hashes of a phase ("capture", "timed"); None where it has none."""
        if phase in self._hashes:
            return self._hashes[phase]
        cut_short = self.status == "incomplete"
        found = read_fingerprints(self._messages, phase, n_env=self.configuration.n_env, cut_short=cut_short)
        if found is None or found.hashes.nbytes <= _KEPT_BYTES:
            self._hashes[phase] = found
        return found

    @cached_property
    def program(self) -> dict[str, Updates]:
        """Hashes of arrays that a program has beside its simulator, by name ("policy", "gradient", ...)."""
        return read_program(self._messages)

    @cached_property
    def failing(self) -> Failing | None:
        """The environments that failed, where the states of these alone were kept; None where all were."""
        return read_failing(self._messages, n_env=self.configuration.n_env)

    def last_states(self, env: int) -> LastStates:
        """States around the failure of an environment that `failing` lists; KeyError names those that it lists."""
        listed = {failure.env: failure for failure in self.failing.failures} if self.failing else {}
        if env not in listed:
            known = ", ".join(map(str, sorted(listed))) or "none"
            raise KeyError(f"{self.path} has no last states of environment {env}; it has those of: {known}")
        return read_last_states(self._messages, self.fields, listed[env])

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """Phases, notes and gates, in order."""
        return read_events(self._messages)

    @cached_property
    def dropouts(self) -> tuple[str, ...]:
        """One sentence for each stretch of data that the recorder says was lost."""
        return read_dropouts(self._messages)

    @cached_property
    def scene(self) -> dict[str, Any]:
        """The engine-neutral description of the scene; empty where there is none."""
        text = self._container.attachment(SCENE)
        if text is None:
            return {}
        with damage_in(self.path):
            return checks.load(SCENE, text, self._json)

    @cached_property
    def varied(self) -> dict[str, Factors]:
        """The factors of parameters that differ from environment to environment, by quantity ("mass", ...); empty where
        none do."""
        with damage_in(self.path):
            return factors_of(self.configuration, self.attachment(VARIED))

    @cached_property
    def geometry(self) -> dict[str, Any] | None:
        """geometry.json as it is, of a model file; None where there is none."""
        text = self._container.attachment(GEOMETRY)
        with damage_in(self.path):
            return checks.load(GEOMETRY, text, self._json) if text is not None else None

    @cached_property
    def look(self) -> Look:
        """What is drawn of its bodies and links, by the geometry that is attached, or by its scene."""
        try:
            return look_of(self.scene, self.geometry)
        except DamagedRecording as error:
            raise DamagedRecording(f"{self.path}: {str(error).removeprefix(f'{self.path}: ')}") from None

    def attachment(self, name: str) -> bytes | None:
        """An attachment's bytes, None where there is none of that name."""
        return self._container.attachment(name)

    def attachment_names(self) -> list[str]:
        """Names of all attachments."""
        return self._container.attachment_names()

    def check_digests(self) -> None:
        """Read everything and check it: CRCs of the file, digests of its content, the content hash.

        Raises DamagedRecording that names the first thing that does not match. A recording without an end record has no
        digests; only its CRCs are checked. `evaluator.runs.validation.verify` asks for more: that parts agree.
        """
        self._container.verify(lambda size: moved(_CRC_SHARE * size))
        if self._end is None:
            return
        claimed = dict(self._end.digests)
        with self._container.verified():
            found = self._recompute().digests()
        for name in sorted(claimed.keys() | found.keys()):
            if claimed.get(name) != found.get(name):
                what = "is missing" if name not in found else "was added" if name not in claimed else "was changed"
                raise DamagedRecording(f"{self.path}: {name} {what} since the recording was made")
        if content_hash(claimed, self.status, self.reason) != self.content_hash:
            raise DamagedRecording(f"{self.path}: the end record was changed since the recording was made")

    def check_metadata(self) -> None:
        """Hold what channels say of states against simulation.json: other programs take units and frames from there."""
        for channel in self._container.channels.values():
            if topic := topics.parse_state(channel.topic):
                self._check_metadata(topic, channel)

    def _recompute(self) -> ContentDigest:
        digest = ContentDigest()
        for name in self._container.attachment_names():
            digest.attachment(name, self._container.attachment(name) or b"")
        stated = {(p.group, p.field) for p in map(topics.parse_state, self._container.channels) if p}
        arrays = [self.state(f.group, f.field) for f in self.fields if (f.group, f.field) in stated]
        hashes = self.fingerprints("capture") if len(arrays) == len(self.fields) else None
        for steps, computed in digest_states(digest, arrays, self.configuration.n_env, hashed=hashes is not None):
            if hashes is not None:
                self._check_hashes(hashes, steps, computed)
        actions = ActionContents(self._container)
        for topic, channel in self._container.channels.items():
            if described_generator(topic, channel.metadata) is not None:
                actions.digest(topic, digest)
            elif topics.has_digest(topic):
                for contents in self._container.batches(topic):
                    digest.messages(topic, contents)
        return digest

    def _check_metadata(self, topic: topics.StateTopic, channel: Channel) -> None:
        for field in self.fields:
            if (field.group, field.field) == (topic.group, topic.field):
                told = {key: value for key, value in field.to_metadata().items() if key in channel.metadata}
                if wrong := [key for key, value in told.items() if channel.metadata[key] != value]:
                    raise DamagedRecording(f"{self.path}: {channel.topic} and {SIMULATION} disagree on {wrong[0]}")

    def _check_origins(self) -> None:
        origins = self.simulation.env_origins if self.simulation else ()
        if origins and len(origins) != self.configuration.n_env:
            n_env = self.configuration.n_env
            raise DamagedRecording(f"{self.path}: {len(origins)} env origins for {n_env} environments")

    def _check_hashes(self, hashes: Fingerprints, steps: NDArray[np.int64], computed: NDArray[np.uint64]) -> None:
        # what the bitwise counts rest on, held against the states that are there
        _, at_recorded, at_computed = np.intersect1d(hashes.steps, steps, return_indices=True)
        wrong = (hashes.hashes[at_recorded] != computed[at_computed]).any(axis=1)
        if wrong.any() or len(at_computed) < len(steps):
            step = steps[at_computed[np.argmax(wrong)]] if wrong.any() else steps[0]
            raise DamagedRecording(f"{self.path}: the state hashes at step {step} are not those of the states")

    def _read_end(self) -> Any:
        if topics.RUN_END not in self._container.channels:
            return None
        contents = list(self._container.in_sequence(topics.RUN_END))
        if not contents:
            return None
        if len(contents) > 1:
            raise DamagedRecording(f"{self.path}: the run ends {len(contents)} times")
        if not self._container.finished:
            return None  # the end was written, but the file was cut short behind it
        if len(contents[-1]) > MAX_END_BYTES:
            raise DamagedRecording(
                f"{self.path}: the end record has {len(contents[-1])} bytes; at most {MAX_END_BYTES} are read"
            )
        return self._messages.parse("gsb.v1.RunEnd", contents[-1])

    def _parse(self, parse: Any, text: bytes) -> Any:
        with damage_in(self.path):
            return parse(text, self._json)


def _cause(number: int) -> str:
    names = {value: name for name, value in enum_values("gsb.v1.Cause").items()}
    name = names.get(number, f"CAUSE_{number}").removeprefix("CAUSE_")  # a number of a later version is shown as it is
    return "" if name == "UNSPECIFIED" else name.replace("_", " ").lower()
