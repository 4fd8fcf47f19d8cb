"""What an adapter said and did: in one build of the conformance scene, and in a run that was recorded; positions
relative to the origins of their environments, and what float32 leaves of them far from zero."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.verdict import NotApplicable, fail
from gpusimbench.recorder.process.launch import Result
from gpusimbench.recorder.scenes.base import Body, Scene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.flight import Watch
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.messages import message_class

FRAMES = ("world", "env")
"""Of positions: with the origin of the environment in them, or without."""

SUBSTEPS = 16
"""Substeps of a step, in each of which a position is rounded: PhysX's TGS has one for each iteration of positions."""

_SAME = 1e-4  # [m], beyond rounding: bodies that are displaced by one vector


def origins_of(description: Description, n_env: int) -> NDArray[np.float64]:
    """Origins of the environments [env, 3] [m]; zeros where none are recorded."""
    return np.array(description.env_origins, dtype=np.float64) if description.env_origins else np.zeros((n_env, 3))


def local(description: Description, field: StateField, array: NDArray[np.floating]) -> NDArray[np.floating]:
    """Positions [..., env, item, 3] relative to the origins of their environments [m]; no copy where they are so."""
    origins = np.array(description.env_origins, dtype=np.float64) if description.env_origins else None
    return Watch((field,), origins=origins).local(field, array)


def rounding(description: Description, n_env: int) -> NDArray[np.float64]:
    """The distance between neighbouring numbers at the largest coordinate of each origin [env] [m]; 0 at zero.

    Engines hold positions in the world's frame in the precision that the description gives: no place is told better.
    """
    largest = np.abs(origins_of(description, n_env)).max(axis=1)
    spacings = [np.spacing(largest.astype(f.dtype)) for f in description.fields if f.field == "position"]
    return np.where(largest > 0, np.max(spacings, axis=0, initial=0.0), 0.0)


def drift(description: Description, n_env: int, n_step: int) -> NDArray[np.float64]:
    """How far bodies of each env may go astray because their positions are rounded in every substep [env] [m]."""
    return rounding(description, n_env) / 2 * (n_step * SUBSTEPS + 1)


def expect_origins(description: Description, error: dict[str, NDArray[np.float64]]) -> None:
    """AssertionError where all bodies of an environment are displaced by one and the same vector: a wrong origin.

    error  by body: first position relative to the origin minus the scene's [env, 3] [m]
    """
    errors = np.array(list(error.values()))  # [body, env, 3]
    if len(errors) < 2 or not np.isfinite(errors).all():
        return
    middle, tolerance = errors.mean(axis=0), _SAME + 2 * rounding(description, errors.shape[1])
    together = np.abs(errors - middle).max(axis=(0, 2)) <= tolerance
    displaced = np.abs(middle).max(axis=1) > tolerance
    if not (wrong := np.flatnonzero(together & displaced)).size:
        return
    env = int(wrong[0])
    said = origins_of(description, errors.shape[1])[env]
    frames = {field.frame for field in description.fields if field.field == "position"}
    if frames == {"env"}:
        fail(
            f"all positions of env {env} are {_vector(middle[env])} m from the scene's; their frame is 'env', which "
            f"has no origin in it (env_origins: {_vector(said)}): subtract the origin, or declare frame 'world'"
        )
    fail(
        f"all positions of env {env} are {_vector(middle[env])} m from the scene's: env_origins say that its origin is "
        f"{_vector(said)}, and the bodies stand as if it were {_vector(said + middle[env])}"
    )


def _vector(values: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{round(value, 4) + 0.0:.6g}' for value in values.tolist())})"


@dataclass(frozen=True)
class Trajectory:
    """States of all steps, and what was said on the way.

    described   state() after build: arrays [env, item, width] as the adapter gave them
    compiled    the same after compile
    states      one array [step, env, item, width] per field; row 0 is `compiled`
    kept        what the first call of states returned, looked at after the last
    blocks      steps that each call of states made
    evidence    what evidence() returned after each of these calls
    gates       that fired
    allocator   what allocator_bytes() returned at the end
    """

    scene: Scene
    n_env: int
    dt: float
    description: Description
    described: States
    compiled: States
    states: States
    kept: States
    blocks: tuple[int, ...]
    evidence: tuple[Evidence | None, ...]
    gates: tuple[str, ...]
    allocator: tuple[int, int] | None

    @property
    def time(self) -> NDArray[np.floating]:
        """Simulated time of each row [s], shape [step, 1, 1], to go with `of`."""
        rows = sum(self.blocks) + 1
        return (self.dt * np.arange(rows))[:, None, None]

    def body(self, name: str) -> Body:
        """The scene's body of that name."""
        return next(body for body in self.scene.moving() if body.name == name)

    def of(self, name: str, field: str) -> NDArray[np.floating]:
        """One field of one body, [step, env, component], in the scene's frame; NotApplicable where it is not recorded.

        Positions are relative to the env's origin.
        """
        for layout, array in zip(self.description.fields, self.states, strict=False):
            if layout.field == field and name in layout.items:
                item = layout.items.index(name)
                part = array[..., item : item + 1, :]
                return (local(self.description, layout, part) if field == "position" else part)[..., 0, :]
        raise NotApplicable(f"the adapter does not record {field} of {name}")

    @property
    def rounding(self) -> NDArray[np.float64]:
        """What the origin of each environment leaves of a position, to go with `of`: [env, 1] [m]; 0 at zero."""
        return rounding(self.description, self.n_env)[:, None]

    @property
    def drift(self) -> NDArray[np.float64]:
        """How far a body may go astray in all steps because positions are rounded, [env, 1] [m]."""
        return drift(self.description, self.n_env, sum(self.blocks))[:, None]

    def count(self, name: str) -> NDArray[np.integer]:
        """One counter at every step but the initial state, [step, env]; NotApplicable where it is not counted."""
        if name not in {counter.name for counter in self.description.counters}:
            raise NotApplicable(f"the adapter does not count {name}")
        rows = [e.counts[name] for e in self.evidence if e is not None and name in e.counts]
        if not rows:
            raise AssertionError(f"counter '{name}' is declared, and evidence() never had it")
        return np.concatenate(rows)


@dataclass(frozen=True)
class RecordedRun:
    """A run that was recorded.

    configuration  what was asked
    status         complete, invalid, failed or incomplete; `reason` says why
    messages       by topic, in order: serialised messages
    schemas        name of each topic's message type
    attachments    by name
    """

    configuration: RunConfiguration
    status: str
    reason: str
    messages: dict[str, list[bytes]] = field(default_factory=dict)
    schemas: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)

    def decoded(self, topic: str) -> list[Any]:
        """The messages of a topic, parsed."""
        return [message_class(self.schemas[topic]).FromString(data) for data in self.messages.get(topic, ())]


def read(configuration: RunConfiguration, result: Result) -> RecordedRun:
    """All of a recording, by the mcap library alone; empty where there is none under its final name."""
    run = RecordedRun(configuration, result.status, result.reason, defaultdict(list))
    if result.path is None or result.status == "incomplete":
        return run
    with result.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        for channel in summary.channels.values():
            run.schemas[channel.topic] = summary.schemas[channel.schema_id].name
        for _, channel, message in reader.iter_messages(log_time_order=False):
            run.messages[channel.topic].append(message.data)
        for attachment in reader.iter_attachments():
            run.attachments[attachment.name] = attachment.data
    return run
