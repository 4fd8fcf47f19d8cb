"""Hashes of arrays that a program has beside the states of its simulator: parameters, gradients, batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.schemas import topics
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fingerprint import ALGORITHM, array_fingerprint
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.mixing import GOLDEN
from gpusimbench.schemas.text import stored_text
from gpusimbench.schemas.trees import leaves

_LEAST, _MOST = -(1 << 63), (1 << 64) - 1  # integers that arrays hold; generators of numpy have states of 128 bits
_WORDS = (1, 2, 4, 8)
_LARGEST = 8  # bytes of an element
_LONGEST = 100  # characters of a name
_CHUNK = 1 << 22  # elements that are hashed at a time on a device
_FACTORS = ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB))


@dataclass(frozen=True)
class Hashed:
    """Hashes of the arrays of one call.

    arrays  of each "<dtype> <shape> <name>", as gsb.v1.ArrayHashes has it
    hashes  one an array
    """

    arrays: tuple[str, ...]
    hashes: tuple[int, ...]


def hashed(tree: Any, name: str) -> Hashed:
    """Hashes of an array, or of nested dicts, tuples and lists of arrays, numbers, texts and None.

    Arrays may be of numpy, torch, JAX or any library that numpy takes arrays of. A tensor of torch on another device
    than the host is hashed there, and one number of it comes to the host; what else is not on the host is copied.

    name  of the whole, with which those of the arrays begin

    UsageError where there is no array, or one of objects, of complex numbers or of elements of more than 8 bytes, and
    where the arrays are nested without an end.
    """
    try:
        found = [_hash_value(value, at) for at, value in leaves(tree, name)]
    except RecursionError:
        raise UsageError(f"{name} is nested too deeply, or has itself as a member") from None
    if not found:
        raise UsageError(f"{name} has no arrays")
    return Hashed(tuple(array for array, _ in found), tuple(number for _, number in found))


class ArrayHashWriter:
    """Writes hashes to the topics /program/<name> of a recording, in the order of the calls."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._order = 0
        self._updates: dict[str, int] = {}
        self._arrays: dict[str, tuple[str, ...]] = {}  # of the message before

    def write(self, name: str, found: Hashed, *, states: int) -> None:
        """Add a message.

        states  that precede it
        """
        topic = topics.program(name)
        update = self._updates.get(name, 0)
        if not update:
            self._sink.channel(topic, "gsb.v1.ArrayHashes", {"algorithm": ALGORITHM})
        arrays = found.arrays if self._arrays.get(name) != found.arrays else ()
        message = message_class("gsb.v1.ArrayHashes")(
            update=update, order=self._order, states=states, arrays=arrays, hashes=found.hashes
        )
        self._sink.write(topic, message.SerializeToString())
        self._updates[name], self._arrays[name] = update + 1, found.arrays
        self._order += 1


def checked_name(name: str) -> str:
    """The name; UsageError where it is none of a topic, or longer than readers take."""
    if not isinstance(name, str) or len(name) > _LONGEST or topics.parse_program(topics.program(name)) is None:
        raise UsageError(
            f"arrays are named by at most {_LONGEST} small letters, digits and _, such as policy or gradient, not "
            f"{str(name)[:_LONGEST]!r}"
        )
    return name


def _hash_value(value: Any, name: str) -> tuple[str, int]:
    if value is None or isinstance(value, str) or (type(value) is int and not _LEAST <= value <= _MOST):
        data = np.frombuffer(repr(value).encode(), dtype=np.uint8)
        return _described("text", data.shape, name), array_fingerprint(data)
    if _is_tensor(value):
        return _described(str(value.dtype).removeprefix("torch."), value.shape, name), _tensor(value, name)
    if not hasattr(value, "__array__") and callable(getattr(value, "numpy", None)):  # Warp
        value = value.numpy()
    array = np.asarray(value)
    plain = array.dtype.kind in "fiub" or (
        array.dtype.kind == "V" and array.dtype.names is None and array.dtype.itemsize in _WORDS
    )  # V: bfloat16 of JAX
    if not plain or array.dtype.itemsize > _LARGEST:
        raise UsageError(
            f"{name} is {array.dtype}; arrays of real numbers or truth values, of at most 8 bytes each, are taken"
        )
    return _described(str(array.dtype), array.shape, name), array_fingerprint(array)


def _described(dtype: str, shape: Any, name: str) -> str:
    text = stored_text(name)
    return f"{dtype} {'x'.join(map(str, shape)) or '-'} {text}"


def _is_tensor(value: Any) -> bool:
    return hasattr(value, "detach") and type(value).__module__.partition(".")[0] == "torch"


def _tensor(tensor: Any, name: str) -> int:
    import torch

    words = {1: torch.uint8, 2: torch.int16, 4: torch.int32, 8: torch.int64}.get(tensor.element_size())
    if words is None or tensor.is_complex():
        raise UsageError(f"{name} is {tensor.dtype}; tensors of real numbers or truth values are taken")
    flat = tensor.detach().contiguous().reshape(-1).view(words)
    if flat.device.type == "cpu":
        return array_fingerprint(flat.numpy())
    return _on_device(flat, torch)


def _on_device(flat: Any, torch: Any) -> int:
    """The hash of integers on their device: torch's 64-bit integers wrap as the definition asks for."""
    mask = (1 << 8 * flat.element_size()) - 1
    total = torch.zeros((), dtype=torch.int64, device=flat.device)
    for begin in range(0, len(flat), _CHUNK):
        part = flat[begin : begin + _CHUNK].to(torch.int64)
        if flat.element_size() < _LARGEST:
            part &= mask  # as unsigned
        at = torch.arange(begin + 1, begin + 1 + len(part), dtype=torch.int64, device=flat.device)
        word = part + at * _signed(GOLDEN)
        for shift, factor in _FACTORS:
            word = (word ^ _shifted(word, shift)) * _signed(factor)
        total += (word ^ _shifted(word, 31)).sum()
    return int(total) & ((1 << 64) - 1)


def _shifted(word: Any, by: int) -> Any:
    # to the right, with zeros from the left
    return (word >> by) & ((1 << (64 - by)) - 1)


def _signed(word: int) -> int:
    return word - (1 << 64) if word >> 63 else word
