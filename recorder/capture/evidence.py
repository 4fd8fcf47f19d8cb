"""Evidence of a phase's steps to messages, the validity gates that it shows, and how much moves, counted by the
recorder itself of the states that an engine returns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import Counter

SLOWEST = 0.01
"""Speed from which a joint or a body moves [m/s, rad/s]. Of a Panda that follows random targets on MuJoCo C, 7.0 of 7
joints are faster, on average over 64 environments; of one that holds its first target, 0.1 after 11 s."""

MOVING = Counter(
    "moving", f"joints and bodies that move faster than {SLOWEST:g} m/s or {SLOWEST:g} rad/s, counted by gsb-record"
)

_VELOCITIES = ("qvel", "linear_velocity", "angular_velocity")


def moving(fields: Sequence[StateField], state: States) -> NDArray[np.int64] | None:
    """Joints and bodies of each environment of which any velocity is above SLOWEST, [env]; None without velocities.

    state  one array [env, item, width] per field; a speed that is not finite counts as moving
    """
    fast: dict[str, NDArray[np.bool_]] = {}
    for field, array in zip(fields, state, strict=True):
        if field.field in _VELOCITIES:
            found = ~(np.linalg.norm(array.astype(np.float64), axis=2) <= SLOWEST)
            fast[field.group] = fast[field.group] | found if field.group in fast else found
    if not fast:
        return None
    return np.asarray(np.sum([of.sum(axis=1) for of in fast.values()], axis=0, dtype=np.int64))


def with_motion(evidence: Evidence | None, fields: Sequence[StateField], state: States) -> Evidence | None:
    """What an engine counted of its last step, with what moves in the state after it."""
    count = moving(fields, state)
    if count is None:
        return evidence
    evidence = evidence or Evidence()
    return replace(evidence, counts={**evidence.counts, MOVING.name: count[None]})


_QUANTILE = 0.95


class EvidenceWriter:
    """Writes what one phase counted.

    stride    steps between two rows; with more than 1, overflow bits are those of all steps since the row before
    workers   threads that share the counters
    counters  what is counted; None: what the engine counts
    """

    def __init__(
        self,
        sink: Sink,
        description: Description,
        phase: str,
        *,
        dt: float,
        stride: int,
        workers: Workers | None = None,
        counters: Sequence[Counter] | None = None,
    ) -> None:
        self._sink = sink
        self._workers = workers or Workers(small=True)
        self._phase = phase
        self._dt = dt
        self._stride = stride
        self._buffers = description.buffers
        self._fatal = {bit.bit: bit.name for bit in description.overflow_bits if bit.fatal}
        counters = description.counters if counters is None else counters
        self._counters = {counter.name: counter for counter in counters}
        for counter in counters:
            metadata = {"meaning": counter.meaning, "over": "environments"}
            sink.channel(topics.count(phase, counter.name), "gsb.v1.StepCounts", metadata)
        self._fired: set[int] = set()
        self._has_overflow = bool(description.overflow_bits)
        if self._has_overflow:
            bits = ",".join(f"{bit.bit}={bit.name}" for bit in description.overflow_bits)
            sink.channel(topics.overflow(phase), "gsb.v1.Overflow", {"bits": bits})

    def feed(self, evidence: Evidence, *, first_step: int) -> list[str]:
        """Write rows, the first of them of `first_step`; returns the gates that fired anew, one sentence each."""
        return self.begin(evidence, first_step=first_step)()

    def begin(self, evidence: Evidence, *, first_step: int) -> Callable[[], list[str]]:
        """The same, by what is returned; other threads, where there are any, begin now."""

        def summary(counts: NDArray[np.integer]) -> bytes:
            message = message_class("gsb.v1.StepCounts")(
                first_step=first_step,
                stride=self._stride,
                mean=counts.mean(axis=1).tolist(),
                p95=nearest_rank(counts, _QUANTILE).tolist(),
                max=counts.max(axis=1).tolist(),
            )
            return bytes(message.SerializeToString())

        summaries = self._workers.later(summary, list(evidence.counts.values()))
        return lambda: self._write(evidence, summaries(), first_step=first_step)

    def _write(self, evidence: Evidence, summaries: Iterable[bytes], *, first_step: int) -> list[str]:
        time = sim_time_ns(first_step, self._dt)
        if unknown := evidence.counts.keys() - self._counters.keys():
            raise ValueError(f"evidence counts '{min(unknown)}', which the simulator's description does not name")
        for name, data in zip(evidence.counts, summaries, strict=True):
            self._sink.write(topics.count(self._phase, name), data, sim_ns=time)
        if evidence.overflow is None or not self._has_overflow:
            return []
        bits = evidence.overflow.astype(np.uint32, copy=False)
        message = message_class("gsb.v1.Overflow")(
            first_step=first_step,
            stride=self._stride,
            bits=np.bitwise_or.reduce(bits, axis=1).tolist(),
            envs=np.count_nonzero(bits, axis=1).tolist(),
        )
        self._sink.write(topics.overflow(self._phase), message.SerializeToString(), sim_ns=time)
        return self.overflowed(evidence, first_step=first_step)

    def overflowed(self, evidence: Evidence, *, first_step: int) -> list[str]:
        """The gates that fired anew in rows from `first_step` on, one sentence each; writes nothing."""
        if evidence.overflow is None or not evidence.overflow.any():
            return []
        bits = evidence.overflow.astype(np.uint32, copy=False)
        found = {
            bit: gate
            for bit, name in self._fatal.items()
            if bit not in self._fired and (gate := self._gate(bits & np.uint32(1 << bit), name, first_step))
        }
        self._fired |= found.keys()
        return list(found.values())

    def _gate(self, hit: NDArray[np.uint32], name: str, first_step: int) -> str:
        rows, envs = np.nonzero(hit)
        if not rows.size:
            return ""
        step = first_step + int(rows[0]) * self._stride
        when = f"first at step {step}" if self._stride == 1 else f"by step {step}"
        sizes = ", ".join(f"{b.name} {b.asked} per {b.per}" for b in self._buffers)
        return (
            f"buffer overflow {name} in {len(set(envs.tolist()))} of {hit.shape[1]} envs, {when}: the engine dropped "
            f"contacts or constraints{f' (buffers: {sizes})' if sizes else ''}"
        )


def nearest_rank(counts: NDArray[np.integer], quantile: float) -> NDArray[np.integer]:
    """The quantile of each row [row, env] by nearest rank: a number that occurs in it."""
    index = max(0, int(np.ceil(quantile * counts.shape[1])) - 1)
    return np.partition(counts, index, axis=1)[:, index]
