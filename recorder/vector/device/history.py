"""Rows as a device kept them, completed on the host: which episode and step each is of, and how episodes ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.device.rows import Columns
from gpusimbench.recorder.vector.fields import GIVEN
from gpusimbench.recorder.vector.modes import Ledger, Mode, final_name
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.vector import FINAL_GIVEN

INFO = "info/"
"""Begins the names of the arrays of infos."""

_TRUE = np.ones(1, dtype=np.bool_)

DONE, TRUNCATION = "done", "truncation"
"""The flags of Brax, of which terminated and truncated are made."""


class Which(Enum):
    """Which environments the user reset: ALL, those whose episodes had ENDED, or NONE, where only arrays changed."""

    ALL = "all"
    ENDED = "ended"
    NONE = "none"


@dataclass(frozen=True)
class Reset:
    """Observations of a row were replaced before the next step.

    which   environments begin an episode there, of each reset
    before  the observations that the first of them replaced, [env, ...]
    """

    which: tuple[Which | NDArray[np.bool_], ...]
    before: Callable[[], Columns]


class History:
    """Follows the episodes of all environments from row to row.

    mode    when environments are reset
    hidden  a reset within step hides the last observation of an episode: what the file has instead is the one before
    """

    def __init__(self, n_env: int, mode: Mode, *, hidden: bool) -> None:
        self._ledger = Ledger(n_env, mode)
        self._hidden = hidden
        self._rows = 0
        self._last: dict[str, NDArray[np.generic]] = {}  # observations of the row before

    def completed(self, rows: Columns, resets: Mapping[int, Reset]) -> Columns:
        """The arrays of the recording, of the rows that follow those of the last call.

        rows    what the device kept, [row, env, ...]
        resets  by the number of the row in `rows`
        """
        flags = _flags(rows)
        done = flags["terminated"] | flags["truncated"]
        shape = done.shape
        stepped = np.ones(shape, dtype=np.bool_)
        counts = {name: np.zeros(shape, dtype=np.int64) for name in ("episode", "episode_step")}
        for row in range(len(done)):
            if self._rows + row:
                stepped[row] = ~self._ledger.stepped(done[row])
            else:
                stepped[row] = False
            if row in resets:
                self._ledger.reset(np.any([_mask(which, done[row]) for which in resets[row].which], axis=0))
            counts["episode"][row], counts["episode_step"][row] = self._ledger.episode, self._ledger.step
        if not rows.get(FINAL_GIVEN, _TRUE).all():
            raise UsageError("an episode ended in a step that begins the next one, and info has no final_obs")
        of_info, kept = {}, {}
        for name, array in rows.items():
            if name.startswith(INFO):
                if not name.endswith(GIVEN):
                    of_info[name] = array
                    of_info[f"{name}{GIVEN}"] = rows.get(f"{name}{GIVEN}", stepped) & stepped
            elif name not in (DONE, TRUNCATION, FINAL_GIVEN):
                kept[name] = array
        if not stepped[0 if self._rows else 1 :].all():  # a call of step that begins an episode ignores its actions
            kept |= {name: _where(stepped, array, 0) for name, array in kept.items() if name.startswith("action")}
        found = {**kept, **flags, **self._final(kept, done, resets), "stepped": stepped, **counts, **of_info}
        self._rows += len(done)
        return found

    def _final(self, rows: Columns, done: NDArray[np.bool_], resets: Mapping[int, Reset]) -> Columns:
        # where no episode ended and nothing was reset, the observation is what the step led to
        found: Columns = {}
        replaced = {row: reset.before() for row, reset in resets.items()}
        for name, array in rows.items():
            final = final_name(name)
            if not name.startswith("observation") or final in rows:
                continue
            led_to = array
            if replaced:
                led_to = array.copy()
                for row, before in replaced.items():
                    led_to[row] = before[name]
            if self._hidden:
                led_to = _without_ends(led_to, done, self._last.get(name, array[0]))
                self._last[name] = array[-1].copy()  # the block's memory is used again
            found[final] = led_to
        return {**found, FINAL_GIVEN: ~done} if self._hidden else found


def _flags(rows: Columns) -> Columns:
    if DONE not in rows:
        return {name: rows[name].astype(np.bool_) for name in ("terminated", "truncated")}
    done, truncated = rows[DONE] != 0, rows[TRUNCATION] != 0
    return {"terminated": done & ~truncated, "truncated": truncated}


def _mask(which: Which | NDArray[np.bool_], done: NDArray[np.bool_]) -> NDArray[np.bool_]:
    if isinstance(which, Which):
        return {Which.ALL: np.ones_like(done), Which.ENDED: done, Which.NONE: np.zeros_like(done)}[which]
    return which


def _without_ends(array: NDArray[Any], done: NDArray[np.bool_], last: NDArray[Any]) -> NDArray[Any]:
    # arrays [row, env, ...], where an episode ended with what the row before has; `last` is the row before the first
    row, env = np.nonzero(done)
    if not row.size:
        return array
    found = array.copy()
    found[row, env] = array[row - 1, env]
    found[0, env[row == 0]] = last[env[row == 0]]
    return found


def _where(mask: NDArray[np.bool_], array: NDArray[Any], other: NDArray[Any] | int) -> NDArray[Any]:
    # mask [row, env], arrays [row, env, ...]
    found: NDArray[Any] = np.where(mask.reshape(*mask.shape, *(1,) * (array.ndim - mask.ndim)), array, other)
    return found
