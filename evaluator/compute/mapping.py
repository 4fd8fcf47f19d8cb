"""How the independent parts of a computation are made: one after another, or by workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Mapper(Protocol):
    """Calls a function with each item, anywhere and in any order; gives the results in the order of the items.

    ``map`` is one. Functions and items can be pickled, and a result depends on nothing but its function and its item,
    so that it is the same bit for bit wherever it is computed, and can be computed again where it was lost.
    """

    def __call__(self, function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> Iterable[_Result]: ...


def serial(function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> Iterator[_Result]:
    """One after another, in this process."""
    return map(function, items)
