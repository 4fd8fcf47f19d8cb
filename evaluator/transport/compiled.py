"""Functions compiled by numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, kept on disk where there is a place for it.

    IEEE arithmetic as written: nothing is contracted or reordered, so that one input gives the same bits everywhere.
    """
    return _compile(function, {})


def compiled_without_nan(function: Callable[P, R]) -> Callable[P, R]:
    """The same for numbers that are finite, so that minima may be taken in any order: sums still may not."""
    return _compile(function, {"fastmath": {"nnan", "ninf", "nsz"}})


def _compile(function: Callable[P, R], more: dict[str, Any]) -> Callable[P, R]:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", **more}
    try:
        made = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the folder of this file nor the user's cache can be written to
        made = numba.njit(**options)(function)
    return cast(Callable[P, R], made)
