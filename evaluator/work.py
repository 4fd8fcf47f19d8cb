"""Where the parts of an evaluation are computed: here, or wherever a mapper sends them; each part once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from evaluator.cache.store import Store

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Mapper(Protocol):
    """Calls a function with each item, anywhere and in any order; gives the results in the order of the items.

    ``map`` is one. Functions and items can be pickled, and a result depends on nothing but its item, so that it is the
    same bit for bit wherever it is computed, and can be computed again where it was lost.
    """

    def __call__(self, function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> Iterable[_Result]: ...


def serial(function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> Iterator[_Result]:
    """One after another, in this process."""
    return map(function, items)


@dataclass(frozen=True)
class Work:
    """A mapper, and what was computed before.

    mapper  where parts are computed
    store   results of earlier evaluations; None for none
    """

    mapper: Mapper = serial
    store: Store | None = None

    def map(self, function: Callable[[_Item], _Result], items: Sequence[_Item]) -> list[_Result]:
        """The function's result for each item, in their order; equal items and stored results are not computed again.

        For results that take far longer than a file of a few kilobytes takes to read: a store keeps each of them.
        """
        if self.store is None:
            return list(self.mapper(function, items))
        keys = [self.store.key(function, item) for item in items]
        known = {key: found for key in dict.fromkeys(keys) if (found := self.store.get(key)) is not None}
        missing = {key: item for key, item in zip(keys, items, strict=True) if key not in known}
        for key, result in zip(missing, self.mapper(function, list(missing.values())), strict=True):
            self.store.put(key, result)
            known[key] = result
        return [known[key] for key in keys]


HERE = Work()
"""Everything in this process, and nothing kept."""
