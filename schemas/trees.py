"""What environments and users give, as arrays by name in the memory of the host."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import UsageError

_KINDS = "fiub"
_LARGEST = 8


def on_host(value: Any, name: str, *, copy: bool = True) -> NDArray[Any]:
    """A copy of an array of any library (numpy, torch, JAX, Warp) on any device, or of a number; name is for the error.

    copy  also of what is in the host's memory already

    UsageError where it is not of real numbers or truth values, of at most 8 bytes each.
    """
    if isinstance(value, np.ndarray):
        pass
    elif hasattr(value, "detach"):  # torch
        value = value.detach().cpu()
    elif not hasattr(value, "__array__") and callable(getattr(value, "numpy", None)):  # Warp
        value = value.numpy()
    array = np.array(value) if copy else np.asarray(value)
    if array.dtype.kind not in _KINDS or array.dtype.itemsize > _LARGEST:
        raise UsageError(
            f"{name} is {array.dtype}; arrays of real numbers or truth values, of at most 8 bytes each, are taken"
        )
    return array


def leaves(tree: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every array of nested dicts, tuples and lists, named by its way: "observation/joints/0".

    name  of the whole; an empty one is left out of the names
    """
    if isinstance(tree, Mapping):
        parts = [(str(key), value) for key, value in tree.items()]
    elif isinstance(tree, (tuple, list)):
        parts = [(str(index), value) for index, value in enumerate(tree)]
    else:
        yield name or "array", tree
        return
    for key, value in parts:
        yield from leaves(value, f"{name}/{key}" if name else key)


def mapped(function: Callable[[Any], Any], tree: Any) -> Any:
    """Nested dicts, tuples and lists of arrays with a function applied to each array."""
    if isinstance(tree, Mapping):
        return {key: mapped(function, value) for key, value in tree.items()}
    if isinstance(tree, (tuple, list)):
        return tuple(mapped(function, value) for value in tree)
    return function(tree)
