"""What Genesis' rigid solver carries from one step to the next: its own checkpoint, environment by environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.snapshot import Envs, rows_of

_ERRORS = "errno"  # codes of what went wrong, which are no state: a recording tells each once

_ALSO = ("collider_state.n_broad_pairs", "collider_state.broad_collision_pairs")
"""Arrays that Genesis 1.4.5 leaves out of its checkpoints, as if a step wrote them before it read them.

Yet a step begins by forgetting the contact cache of the pairs that the step before had found near each other and that
no longer are. Without them, environments go on with other bits after a restore.
"""


class Keep:
    """The arrays of a built solver that its steps change, by the names that its checkpoints have for them.

    Genesis says of each array whether the next step reads it (STATE), or makes it again from others, up to the last
    bits (DERIVED). Both are kept. What is left are the model and what a step writes before it reads it.
    """

    def __init__(self, solver: Any) -> None:
        from genesis.utils.array_class import ArrayItem, ConfigItem, DataKind

        self._solver = solver
        self._n_env = int(solver.scene.n_envs)
        self._kinds = frozenset((DataKind.STATE, DataKind.DERIVED))
        self._axes: dict[str, int | None] = {}  # of the environments; None where an array is of no environment
        self._also = []
        for item in solver.data:
            if isinstance(item, ConfigItem) or item.name == _ERRORS:
                continue
            if item.kind not in self._kinds:
                if item.name not in _ALSO:
                    continue
                self._also.append(item)
            shape = tuple(item.array.shape) if isinstance(item, ArrayItem) else ()
            self._axes[item.name] = len(shape) - 1 if shape and shape[-1] == self._n_env else None

    def kept(self) -> dict[str, NDArray[Any]]:
        """Copies [env, ...]; what is of no environment stands there once for each."""
        found = {}
        for name, value in self._present().items():
            if name != _ERRORS:
                axis, array = self._axes[name], _on_host(value)
                whole = np.moveaxis(array, axis, 0) if axis is not None else np.stack([array] * self._n_env)
                found[name] = np.ascontiguousarray(whole)
        return found

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
        """Write the rows of these environments of such arrays, which have those of all."""
        from genesis.engine.states.solvers import SolverCheckpoint
        from genesis.utils.array_class import fill_data

        written = self._present()
        for name, saved in arrays.items():
            axis, whole = self._axes[name], _on_host(written[name])
            if axis is not None:
                rows = rows_of(envs)
                np.moveaxis(whole, axis, 0)[rows] = saved[rows]
            elif envs is None:
                whole = saved[0]
            elif whole.dtype == np.bool_:
                whole = whole & saved[0]  # whether poses are up to date: those of some are not enough
            written[name] = whole
        fill_data(self._also, {item.name: written.pop(item.name) for item in self._also})
        self._solver.__setstate__(SolverCheckpoint(arrays=written, configs={}, kinds=self._kinds))

    def _present(self) -> dict[str, Any]:
        # in the engine's own shapes, and the codes with them, without which it takes no checkpoint back
        from genesis.utils.misc import qd_to_numpy

        record = self._solver.__getstate__().arrays
        also = {item.name: qd_to_numpy(item.array, copy=True) for item in self._also}
        return {name: value for name, value in record.items() if name in self._axes or name == _ERRORS} | also


def _on_host(value: Any) -> NDArray[Any]:
    # a copy: of a torch tensor on whatever device, or of an array
    return np.array(value.cpu().numpy() if hasattr(value, "cpu") else value)
