"""The identity of a recording: SHA-256 over its decoded content, in an order that does not depend on its encoding.

Each stream and each attachment has a digest of its own:

    attachment <name>      the attachment's bytes
    state <group>/<field>  dtype, shape of a row and steps as one text line, then the array in [step, env, item, width]
                           order, little-endian
    <other topic>          every message in the order of its sequence number, each preceded by its length as uint64

The content hash is the SHA-256 of the lines "<name> <digest>\\n", sorted by name, with the run's status and reason as
two more of them. Splitting, compressing or re-chunking a file leaves it as it is.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.block_parts import little_endian, raw_bytes
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.writer import Buffer


def attachment_name(name: str) -> str:
    """Key of an attachment's digest."""
    return f"attachment {name}"


def state_name(field: StateField) -> str:
    """Key of a state field's digest."""
    return f"state {field.name}"


_JOINED_BYTES = 64 << 10
_GATHERED_BYTES = 1 << 20
_LENGTH = struct.Struct("<Q")


class ContentDigest:
    """Digests of the streams of one recording, fed in canonical order."""

    def __init__(self) -> None:
        self._hashes: dict[str, Any] = {}
        self._others: list[Callable[[], Mapping[str, str]]] = []

    def add(self, digests: Callable[[], Mapping[str, str]]) -> None:
        """Take the digests of some streams from elsewhere: a process that was fed them."""
        self._others.append(digests)

    def attachment(self, name: str, data: bytes) -> None:
        """Add an attachment."""
        self._hashes[attachment_name(name)] = hashlib.sha256(data)

    def state(self, field: StateField, n_env: int, array: NDArray[Any]) -> None:
        """Add the next rows [step, env, item, width] of a field, all environments.

        Rows that do not lie one behind the other are copied together, a megabyte at a time.
        """
        digest = self._hash_of(field, n_env)
        together = len(array) if array.flags.c_contiguous else max(1, _GATHERED_BYTES // max(1, array[:1].nbytes))
        for begin in range(0, len(array), max(1, together)):
            digest.update(raw_bytes(little_endian(array[begin : begin + together])))

    def state_columns(self, field: StateField, n_env: int, columns: Sequence[NDArray[Any]]) -> None:
        """The same, of rows that are cut into ranges of environments, in their order.

        Different fields may be fed by different threads.
        """
        digest = self._hash_of(field, n_env)
        arrays = [little_endian(column) for column in columns]
        if len(arrays) == 1:
            digest.update(raw_bytes(arrays[0]))
            return
        together = _JOINED_BYTES // max(1, sum(array[:1].nbytes for array in arrays))
        if together > 1:  # small rows are copied together, since each call costs more than they do
            for begin in range(0, max(map(len, arrays)), together):
                parts = [array[begin : begin + together] for array in arrays]
                digest.update(raw_bytes(np.concatenate(parts, axis=1, dtype=arrays[0].dtype)))
            return
        for row in zip(*arrays, strict=True):
            for part in row:
                digest.update(raw_bytes(part))

    def state_ranges(self, field: StateField, n_env: int, parts: Sequence[NDArray[Any]]) -> None:
        """The same, of arrays [range, step, env, item, width], each of them ranges of one size that follow each other.

        Rows are copied together into a megabyte, in two calls a megabyte: each call lets go of the interpreter's lock,
        and taking it again keeps a thread that launches kernels from going on. Parts of ranges are thousands of calls.
        """
        digest = self._hash_of(field, n_env)
        steps = parts[0].shape[1]
        row = sum(part[:, :1].nbytes for part in parts)
        envs = np.cumsum([0, *(part.shape[0] * part.shape[2] for part in parts)])
        together = max(1, min(steps, _GATHERED_BYTES // max(1, row)))
        gathered = np.empty((together, envs[-1], *parts[0].shape[3:]), dtype=parts[0].dtype.newbyteorder("<"))
        for begin in range(0, steps, together):
            rows = gathered[: min(together, steps - begin)]
            for part, first, stop in zip(parts, envs, envs[1:], strict=False):
                some = part[:, begin : begin + len(rows)].swapaxes(0, 1)
                np.copyto(rows[:, first:stop].reshape(some.shape), some)
            digest.update(raw_bytes(rows))

    def _hash_of(self, field: StateField, n_env: int) -> Any:
        name = state_name(field)
        if name not in self._hashes:
            line = f"{field.dtype} {n_env} {len(field.items)} {field.width}\n"
            self._hashes[name] = hashlib.sha256(line.encode())
        return self._hashes[name]

    def message(self, topic: str, *parts: Buffer) -> None:
        """Add the next message of any other topic: its bytes, or the parts that they consist of.

        Different topics may be fed by different threads.
        """
        digest = self._hashes.get(topic)
        if digest is None:
            digest = self._hashes.setdefault(topic, hashlib.sha256())
        digest.update(_LENGTH.pack(sum(map(len, parts))))
        for part in parts:
            digest.update(part)

    def messages(self, topic: str, contents: Iterable[Buffer]) -> None:
        """Add the next messages of a topic; small ones are copied together, since each call costs more than they do."""
        parts: list[Buffer] = []
        held = 0
        for content in contents:
            if held + len(content) > _JOINED_BYTES:
                self._update(topic, parts)
                parts, held = [], 0
            parts += (_LENGTH.pack(len(content)), content)
            held += len(content)
        self._update(topic, parts)

    def _update(self, topic: str, parts: list[Buffer]) -> None:
        digest = self._hashes.setdefault(topic, hashlib.sha256())
        for part in parts if len(parts) <= 2 else (b"".join(parts),):
            digest.update(part)

    def digests(self) -> dict[str, str]:
        """Hexadecimal digests by stream."""
        found = {name: digest.hexdigest() for name, digest in self._hashes.items()}
        for digests in self._others:
            found |= digests()
        return found


def content_hash(digests: Mapping[str, str], status: str, reason: str) -> str:
    """The identity of a recording from its digests and its end.

    Where a name or the reason has a line break, it could pass for lines of its own: then it is that of a JSON text.
    """
    if any("\n" in text for text in (*digests, reason)):
        text = json.dumps([sorted(digests.items()), status, reason])
    else:
        lines = [f"{name} {digest}\n" for name, digest in digests.items()]
        lines += [f"status {status}\n", f"reason {reason}\n"]
        text = "".join(sorted(lines))
    return hashlib.sha256(text.encode()).hexdigest()
