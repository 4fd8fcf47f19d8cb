"""Blocks of states and actions as the bytes of one message; the writer has no need of them joined."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from gpusimbench.schemas.block_parts import action_parts, state_parts


def encode_state(array: NDArray[Any], **place: int) -> bytes:
    """A serialised StateBlock; see state_parts."""
    return b"".join(bytes(part.data) for part in state_parts(array, **place))


def encode_action(array: NDArray[Any], **place: int) -> bytes:
    """A serialised ActionBlock; see action_parts."""
    return b"".join(bytes(part.data) for part in action_parts(array, **place))
