"""A 64-bit hash of one environment's state at one step.

The state's numbers are taken as unsigned words of their own size, in the order of the recording's fields, items and
components. With word w_i at position i (from 0) and 64-bit wrapping arithmetic,

    hash = sum over i of mix(w_i + (i + 1) * 0x9E3779B97F4A7C15)

where mix is the finaliser of SplitMix64 (``schemas.mixing``). mix is a bijection, so a change of one word always
changes the hash; several changes cancel with a probability of 2^-64. A sum does not depend on the order of its terms,
so a GPU may add them in any order and gets the same bits. Not a defence against forgery: that is what the SHA-256
digests of the end record are for.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.mixing import GOLDEN, mix_in_place

ALGORITHM = "sum-splitmix64-v1"

_WORD = {1: "<u1", 2: "<u2", 4: "<u4", 8: "<u8"}

_MANY_CPUS = 4
_FEWER_WORDS = 1 << 15
_WORDS = 1 << 17 if (os.cpu_count() or 1) >= _MANY_CPUS else _FEWER_WORDS
"""At a time: few enough for a core's cache. Where many threads work, and share the interpreter, more of them, since
each call may have to wait for it: 1 GB took six threads 1.6 s, and 2.2 s with a quarter of the words."""

_FEW_WORDS = 4
_MASK = (1 << 64) - 1

COMPILED_BYTES = 2_000_000_000
"""Of states, from which on compiled hashes pay: loading numba takes 1 to 2 s, in which other threads wait for the
interpreter. Of 1 GB, numpy's were ready sooner by a quarter, of 4 GB later by a quarter."""

_LOADING_S = 60.0
"""That a fork waits at most until the machine code is loaded, which takes 1 to 3 s, and longer where others compute."""

_of_thread = threading.local()
_counting = threading.Lock()
_expected = 0
_seen = 0
_asked = False  # for machine code; there may be none
_compiled: Callable[[NDArray[Any], int, NDArray[np.uint64]], None] | None = None


def expect(size: int) -> None:
    """States of `size` bytes are going to be hashed by this process: once they are COMPILED_BYTES in all, the hashes
    are compiled to machine code, where numba is installed. They are the same.

    Nobody has to tell: once so many bytes were hashed, a thread loads the machine code while hashing goes on.
    """
    global _expected
    with _counting:
        _expected += size
        now = _ask(_expected)
    if now:
        _compile()


def in_one_thread() -> None:
    """No other thread of this process works: machine code is not loaded from now on, since that takes 2 s in which this
    thread would wait, and hashes by numpy are of a few words at a time."""
    global _asked, _WORDS
    _asked = True
    _WORDS = _FEWER_WORDS


def load_compiled() -> None:
    """Have the hashes compiled to machine code from now on, where numba is installed."""
    global _asked
    _asked = True
    _compile()


def _count(size: int) -> None:
    global _seen
    with _counting:
        _seen += size
        now = _ask(_seen)
    if now:  # whoever waits for the hashes does not wait for numba; the end of the process does
        with suppress(RuntimeError):  # the system has no thread left, or the process ends
            # and logging: their hooks of forks, added while a fork waits, would release what they had not acquired
            import concurrent.futures.thread  # noqa: F401

            loading = threading.Thread(target=_compile, name="compiling", daemon=False)
            loading.start()
            # a copy of the process would wait for ever for modules that a thread, which it lacks, was about to load
            if hasattr(os, "register_at_fork"):
                os.register_at_fork(before=partial(loading.join, _LOADING_S))


def _ask(size: int) -> bool:
    # whether so many bytes pay, and nobody has asked before
    global _asked
    now = size >= COMPILED_BYTES and not _asked
    _asked = _asked or now
    return now


def _compile() -> None:
    global _compiled
    # Pythons of engines have no numba, and a broken numba, or its cache, raises errors of any kind; hashes by numpy are
    # the same, and no recording is lost for want of faster ones
    with suppress(Exception):
        from gpusimbench.schemas.compiled import hash_loop

        _compiled = hash_loop()


def fingerprint(arrays: Sequence[NDArray[np.floating]]) -> NDArray[np.uint64]:
    """Hashes of states, shape [...], from the state's fields in recording order.

    arrays  each [..., item, width], float32 or float64, with the same leading shape ([env] or [step, env])
    """
    lead = arrays[0].shape[:-2]
    total = np.zeros(lead, dtype=np.uint64)
    flat = total.reshape(-1)
    position = 0
    if not _asked:
        _count(sum(array.nbytes for array in arrays))
    compiled = _compiled  # by one of the two in all fields
    for array in arrays:
        if array.shape[:-2] != lead:
            raise ValueError(f"leading shapes differ: {array.shape[:-2]} and {lead}")
        count = array.shape[-2] * array.shape[-1]
        words = np.ascontiguousarray(array).view(_WORD[array.dtype.itemsize]).reshape(len(flat), count)
        if compiled is not None:
            compiled(words, position, flat)
            position += count
            continue
        rows = max(1, _WORDS // max(1, count))
        keys = _keys(position, count, rows)
        mixed, spare = _scratch(rows, count)
        for begin in range(0, len(flat), rows):
            part = words[begin : begin + rows]
            some = mixed[: len(part)]
            np.add(part, keys[: len(part)], out=some)
            mix_in_place(some, spare[: len(part)])
            _add_rows(flat[begin : begin + rows], some)
        position += count
    return total


def array_fingerprint(array: NDArray[np.generic]) -> int:
    """Hash of one array of any shape, over its elements in row-major order: that of the module, however many there are.

    array  elements of 1, 2, 4 or 8 bytes
    """
    words = np.ascontiguousarray(array).reshape(-1).view(_WORD[array.dtype.itemsize])
    total = 0
    for begin in range(0, len(words), _WORDS):
        part = words[begin : begin + _WORDS]
        mixed, spare = (buffer[: len(part)] for buffer in _scratch(1, _WORDS)[:, 0])
        np.add(part, _keys(0, _WORDS, 1)[0, : len(part)], out=mixed)
        mixed += np.uint64(begin * GOLDEN & _MASK)
        mix_in_place(mixed, spare)
        total += int(mixed.sum(dtype=np.uint64))
    return total & _MASK


@lru_cache(maxsize=64)
def _keys(position: int, count: int, rows: int) -> NDArray[np.uint64]:
    # what is added to the words, [row, word]: rows of a few words are added much faster as one long one
    key = np.arange(position + 1, position + count + 1, dtype=np.uint64) * np.uint64(GOLDEN)
    return np.tile(key, (rows, 1))


def _scratch(rows: int, count: int) -> NDArray[np.uint64]:
    # two buffers [row, word] of the thread's own; memory that is new each time costs more than all arithmetic
    size = 2 * rows * count
    if getattr(_of_thread, "words", np.empty(0)).size < size:
        _of_thread.words = np.empty(size, dtype=np.uint64)
    words: NDArray[np.uint64] = _of_thread.words[:size].reshape(2, rows, count)
    return words


def _add_rows(total: NDArray[np.uint64], words: NDArray[np.uint64]) -> None:
    if words.shape[1] > _FEW_WORDS:
        total += np.einsum("ij->i", words)  # takes a third of the time of numpy.sum along short rows
        return
    for column in range(words.shape[1]):
        total += words[:, column]
