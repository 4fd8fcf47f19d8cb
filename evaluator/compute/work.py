"""Where the parts of an evaluation are computed: here, or wherever a mapper sends them; each part once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar, get_type_hints

from gpusimbench.evaluator.compute.cache import Store
from gpusimbench.evaluator.compute.mapping import Mapper, serial

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Work:
    """A mapper, and what was computed before.

    mapper  where parts are computed
    store   results of earlier evaluations; None for none
    """

    mapper: Mapper = serial
    store: Store | None = None

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> list[_Result]:
        """The function's result for each item, in their order; equal items and stored results are not computed again.

        A mapper itself, for results that take far longer than a file of a few kilobytes takes to read: a store keeps
        each of them.
        """
        if self.store is None:
            return list(self.mapper(function, items))
        found = list(items)
        keys, kind = self.store.keys(function, found), _kind_of(function)
        known = {key: stored for key in dict.fromkeys(keys) if (stored := self.store.get(key, kind)) is not None}
        missing = {key: item for key, item in zip(keys, found, strict=True) if key not in known}
        for key, result in zip(missing, self.mapper(function, list(missing.values())), strict=True):
            self.store.put(key, result)
            known[key] = result
        return [known[key] for key in keys]

    def once(self, function: Callable[..., _Result], *arguments: Any) -> _Result:
        """The function's result for these arguments and the mapper, which it may spread its own parts by."""
        if self.store is None:
            return function(*arguments, self.mapper)
        (key,) = self.store.keys(function, [list(arguments)])
        stored: _Result | None = self.store.get(key, _kind_of(function))
        if stored is None:
            stored = function(*arguments, self.mapper)
            self.store.put(key, stored)
        return stored


def _kind_of(function: Callable[..., Any]) -> Any:
    # what its results are, by its annotation
    called = function if hasattr(function, "__qualname__") else type(function).__call__
    return get_type_hints(called)["return"]


HERE = Work()
"""Everything in this process, and nothing kept."""
