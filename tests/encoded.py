"""Blocks of states and actions as the bytes of one message, which the writer has no need of joined; forged frames."""

from __future__ import annotations

import struct
from typing import Any

from numpy.typing import NDArray

from gpusimbench.schemas.block_parts import action_parts, state_parts


def encode_state(array: NDArray[Any], **place: int) -> bytes:
    """A serialised StateBlock; see state_parts."""
    return b"".join(bytes(part.data) for part in state_parts(array, **place))


def encode_action(array: NDArray[Any], **place: int) -> bytes:
    """A serialised ActionBlock; see action_parts."""
    return b"".join(bytes(part.data) for part in action_parts(array, **place))


def announcing(frame: bytes, size: int) -> bytes:
    """The frame of Zstandard with another content size in its header, in eight bytes."""
    assert frame[:4] == b"\x28\xb5\x2f\xfd"
    return frame[:4] + b"\xe0" + struct.pack("<Q", size) + frame[6:]  # single segment, no dictionary, no checksum
