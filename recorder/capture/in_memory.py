"""Captured states that are kept in the host's memory, to be written once the engine has made its last step."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import psutil

from gpusimbench.recorder.capture.ranges import Ranges, row_bytes
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.capture.writing import Block
from gpusimbench.recorder.failure import NoHostMemory
from gpusimbench.recorder.simulators.captured import Held
from gpusimbench.schemas.fields import StateField

_USABLE = 0.8  # of what the system says is available


class StatesInMemory:
    """Memory for the states of `rows` steps, all of it touched before the first one is made.

    n_action  numbers that an environment is given in a step

    Raises NoHostMemory where the machine has not that much to spare.
    """

    def __init__(self, fields: Sequence[StateField], *, n_env: int, rows: int, n_action: int, workers: Workers) -> None:
        need = rows * (row_bytes(n_env, fields) + n_env * n_action * np.dtype(np.float32).itemsize)
        available = int(psutil.virtual_memory().available * _USABLE)
        if need > available:
            raise NoHostMemory(
                f"--capture memory keeps {need / 1e9:.1f} GB of states, and {available / 1e9:.1f} GB may be used: "
                "capture fewer steps, or lossless"
            )
        shapes = [(rows, n_env, len(field.items), field.width) for field in fields]
        # zeros alone would give no memory yet
        self._arrays = [np.full(shape, 0, dtype=f.dtype) for shape, f in zip(shapes, fields, strict=True)]
        self._actions = np.full((rows, n_env, n_action), 0, dtype=np.float32)
        self._ranges = [slice(envs.start, envs.stop) for envs in Ranges(n_env).each]
        self._workers = workers
        self._blocks: list[Block] = []
        self._filled = 0

    def keep(self, block: Block) -> None:
        """Copy a block."""
        first = self._filled

        def copy(envs: slice) -> tuple[int, bool]:
            states, actions = block.captured.states(envs), block.captured.actions(envs)
            for kept, array in zip(self._arrays, states, strict=True):
                kept[first : first + len(array), envs] = array
            if actions is not None:
                self._actions[first : first + len(actions), envs] = actions
            return len(states[0]), actions is not None

        (count, acted) = next(iter(set(self._workers.start(copy, self._ranges))))
        rows = slice(first, first + count)
        self._filled += count
        shown = block.captured.evidence()
        captured = Held(
            tuple(array[rows] for array in self._arrays),
            None if shown is None else shown.copy(),
            self._actions[rows] if acted else None,
        )
        self._blocks.append(Block(block.first_step, captured, block.actions))

    def write(self, write: Callable[[Block], None]) -> None:
        """Have everything that was kept written, in order."""
        for block in self._blocks:
            write(block)
