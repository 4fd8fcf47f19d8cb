"""States of a run to blocks: full-rate fingerprints, strided rows, canonical digests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recorder.capture.sink import Sink
from recorder.interruption import shielded
from schemas import topics
from schemas.blocks import encode_fingerprints, encode_state
from schemas.configuration import sim_time_ns
from schemas.fields import StateField
from schemas.fingerprint import ALGORITHM, fingerprint

STEPS_PER_BLOCK = 50
_ENV_BLOCK_MIN = 64
_ENV_BLOCKS = 64
_BLOCK_BYTES = 4 << 20


def env_block(n_env: int) -> int:
    """Environments per block: few topics for many environments, one block for few."""
    return max(_ENV_BLOCK_MIN, -(-n_env // _ENV_BLOCKS))


def steps_per_block(n_env: int, fields: Sequence[StateField]) -> int:
    """Rows per block, so that the largest message stays at about 4 MB."""
    row = max(len(f.items) * f.width * np.dtype(f.dtype).itemsize for f in fields) * min(n_env, env_block(n_env))
    return max(1, min(STEPS_PER_BLOCK, _BLOCK_BYTES // row))


def declare_fingerprints(sink: Sink, phase: str) -> None:
    """The channel of a phase's state hashes."""
    sink.channel(
        topics.fingerprint(phase),
        "gsb.v1.FingerprintBlock",
        {"algorithm": ALGORITHM, "shape": "step,env", "covers": "all state fields of an env in recording order"},
    )


def write_fingerprints(
    sink: Sink, phase: str, hashes: NDArray[np.uint64], *, first_step: int, stride: int, dt: float
) -> None:
    """State hashes [step, env] of a phase."""
    data = encode_fingerprints(hashes, first_step=first_step, stride=stride)
    sink.write(topics.fingerprint(phase), data, sim_ns=sim_time_ns(first_step, dt))


class StateWriter:
    """Writes the states of the capture phase.

    Rows are fed at full rate; every `stride`-th is stored, and every one is hashed.

    last_step           last step that was fed; -1 before the first
    last_recorded_step  last step whose state is in the file; rows held back for a full block are not yet
    """

    def __init__(self, sink: Sink, fields: Sequence[StateField], *, n_env: int, dt: float, stride: int) -> None:
        self._sink = sink
        self._fields = tuple(fields)
        self._n_env = n_env
        self._dt = dt
        self._stride = stride
        self._envs = env_block(n_env)
        self._rows = steps_per_block(n_env, fields)
        self._held: list[list[NDArray[np.floating]]] = [[] for _ in fields]
        self._held_rows = 0
        self._held_first = 0
        self.last_step = -1
        self.last_recorded_step = -1
        for field in self._fields:
            for start in range(0, n_env, self._envs):
                metadata = {**field.to_metadata(), "stride": str(stride), "dt": repr(dt), "n_env": str(n_env)}
                sink.channel(topics.state(field.group, field.field, start), "gsb.v1.StateBlock", metadata)
        declare_fingerprints(sink, "capture")

    @property
    def steps_per_block(self) -> int:
        """Rows per block; the capture asks the simulator for as many steps at a time."""
        return self._rows

    def feed(self, arrays: Sequence[NDArray[np.floating]]) -> str | None:
        """The states after the next steps, arrays [step, env, item, width]; returns what is not finite, if anything."""
        first = self.last_step + 1
        count = arrays[0].shape[0]
        hashes = fingerprint(arrays)
        keep = slice(-first % self._stride, None, self._stride)
        kept = [array[keep] for array in arrays]
        with shielded():  # hashes and rows stay in step, so that what was fed can be written after an interruption
            write_fingerprints(self._sink, "capture", hashes, first_step=first, stride=1, dt=self._dt)
            if len(kept[0]):
                if not self._held_rows:
                    self._held_first = first + keep.start
                for held, rows in zip(self._held, kept, strict=True):
                    held.append(rows)
                self._held_rows += len(kept[0])
            self.last_step += count
            if self._held_rows >= self._rows or first == 0:
                self.flush()
        return self._not_finite(arrays, first)

    def flush(self) -> None:
        """Write the rows that are held back for a full block."""
        if not self._held_rows:
            return
        with shielded():
            held, self._held = self._held, [[] for _ in self._fields]
            rows, self._held_rows = self._held_rows, 0
            for field, pieces in zip(self._fields, held, strict=True):
                self._write(field, np.concatenate(pieces))
            self.last_recorded_step = self._held_first + (rows - 1) * self._stride

    def _write(self, field: StateField, array: NDArray[np.floating]) -> None:
        self._sink.digest.state(field, self._n_env, array)
        time = sim_time_ns(self._held_first, self._dt)
        for start in range(0, self._n_env, self._envs):
            data = encode_state(
                array[:, start : start + self._envs],
                first_step=self._held_first,
                stride=self._stride,
                env_start=start,
                sim_time_ns=time,
            )
            self._sink.write(topics.state(field.group, field.field, start), data, sim_ns=time, digest=False)

    def _not_finite(self, arrays: Sequence[NDArray[np.floating]], first: int) -> str | None:
        found = []
        for field, array in zip(self._fields, arrays, strict=True):
            bad = ~np.isfinite(array)
            if bad.any():
                row, env, item, _ = (int(i) for i in np.argwhere(bad)[0])
                found.append((first + row, env, f"{field.name} of {field.items[item]}"))
        if not found:
            return None
        step, env, what = min(found)
        return f"a state is not finite: step {step}, env {env}, {what}"
