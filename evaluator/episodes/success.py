"""Whether an episode succeeded, by a flag of its steps."""

from __future__ import annotations

import re
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.episodes import EpisodeTable
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import NothingComparable, UsageError
from gpusimbench.schemas.fields import ENV

_INFO, _GIVEN = "info_", "_given"


class At(Enum):
    """At which of its steps the flag of an episode counts.

    LAST  at the last alone: "success at end"
    ANY   at any: "success once"
    """

    LAST = "last"
    ANY = "any"


def successes(
    recording: Recording, table: EpisodeTable, rows: NDArray[np.int64], name: str, at: At
) -> NDArray[np.bool_]:
    """Whether episodes succeeded, in the shape of `rows`.

    rows  of the table
    name  of an info, such as "success", or of another array of one number, such as "terminated"

    UsageError where there is no such array, or it has another value than 0 and 1; NothingComparable where it counts at
    the last step, and was not given there.
    """
    flag = _array(recording, name)
    values, given = (
        recording.state(ENV, one)[:, :, 0, 0] if one else None for one in (flag, _flag_of(recording, flag))
    )
    assert values is not None
    env, last = table.env[rows], table.last_row[rows]
    told = np.ones(values.shape, dtype=np.bool_) if given is None else given != 0
    odd = told & (values != 0) & (values != 1)
    if odd.any():
        row, of = map(int, np.argwhere(odd)[0])
        raise UsageError(
            f"--success takes a flag; {flag} of {recording.path} is {values[row, of]:g} in environment {of}, row {row}"
        )
    reached = told & (values != 0)
    if at is At.ANY:
        count = np.cumsum(reached, axis=0)
        found: NDArray[np.bool_] = count[last, env] > count[table.first_row[rows], env]
        return found
    if not told[last, env].all():
        missing = int((~told[last, env]).sum())
        raise NothingComparable(
            f"{missing} of {rows.size} episodes of {recording.path} have no {name} in the info of their last step; "
            "--success-at any counts those in which a step has it"
        )
    at_last: NDArray[np.bool_] = reached[last, env]
    return at_last


def _array(recording: Recording, name: str) -> str:
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    scalars = [one.field for one in recording.fields if one.group == ENV and one.width == 1]
    for candidate in (_INFO + plain, plain):
        if candidate in scalars:
            return candidate
    infos = [one.removeprefix(_INFO) for one in scalars if one.startswith(_INFO) and not one.endswith(_GIVEN)]
    raise UsageError(
        f"{recording.path} has no info {name}; it has {', '.join(infos) or 'none'}, and the flags terminated and "
        'truncated. gpusimbench.wrap(..., infos=("success",)) records infos'
    )


def _flag_of(recording: Recording, array: str) -> str:
    given = f"{array}{_GIVEN}"
    return given if any(one.field == given for one in recording.fields) else ""
