"""Actions from a file instead of a generator, and what a run is told of either. The file is a NumPy archive with an
array of numbers, and the names of the actuators."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import arrays
from gpusimbench.schemas.action_generator import MAX_RANGE, JointTargets, Streams, undrawable
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.treatment import CONTROLS, FromFile

_NUMBERS, _NAMES = "controls", "actuators"
_FORM = (
    "an archive (numpy.savez) with one array of numbers, controls [step, actuator], or [step, env, actuator], and, if "
    "you like, actuators, the names of its columns"
)


@dataclass(frozen=True)
class GivenControls(JointTargets):
    """Controls from a file, the same for all environments or of each.

    joints        names of the actuators
    lower, upper  least and largest control of each
    each          each environment has its own
    sha256        of the file [hex]
    rows          [step, env or 1, actuator]; the description leaves them out
    """

    unit = "of the actuator"
    meaning = "control of each actuator, held during the step, from a file"

    each: bool
    sha256: str
    rows: NDArray[np.float32] = field(repr=False, compare=False, metadata={"described": False})

    def draw(
        self, seed: int, *, n_env: int, first_step: int, n_step: int, streams: Streams | None = None
    ) -> NDArray[np.float32]:
        """See JointTargets.draw: rows of the file."""
        given = Streams.usual(n_env) if streams is None else streams
        steps = given.steps(first_step, n_step) % np.uint32(len(self.rows))
        return np.ascontiguousarray(self.rows[steps, given.env % np.uint32(self.rows.shape[1])])

    def describe(self, seed: int, streams: Streams) -> str:
        """See JointTargets.describe."""
        steps, envs = self.rows.shape[:2]
        about = {"name": self.name, "joints": self.joints, "sha256": self.sha256, "steps": steps, "envs": envs}
        return json.dumps({"generator": "file", **about, **streams.describe()})


def table(actions: JointTargets) -> NDArray[np.float32] | None:
    """Actions that were given and are not drawn, [step, env or 1, action], to be used row after row, and from the first
    on again after the last; None where they are drawn."""
    return actions.rows if isinstance(actions, GivenControls) else None


def refusal(actions: JointTargets, run: RunConfiguration) -> str:
    """Why a run cannot be given these actions; empty where it can."""
    if not isinstance(actions, GivenControls):
        refused = undrawable(actions)
        return f"actions {actions.name} have {refused}; at most {MAX_RANGE} steps can be drawn" if refused else ""
    steps, envs = actions.rows.shape[:2]
    if actions.each and envs != run.n_env:
        return f"the file of actions has controls of {envs} environments, and --n-env is {run.n_env}"
    if "capture" in run.phases and run.steps > steps:
        return f"the file of actions has controls of {steps} steps, fewer than --steps, {run.steps}"
    return ""


def packed(path: str) -> tuple[str, bytes]:
    """How a run's configuration calls the controls of a file, and the attachment with them, in float32.

    UsageError where the file is not there, or holds something else.
    """
    try:
        found = arrays.decode(path, Path(path).read_bytes())
    except OSError as error:
        raise UsageError(f"--actions {path}: {error.strerror or error}; the file is {_FORM}") from None
    except DamagedRecording as error:
        raise UsageError(f"--actions {error}; the file is {_FORM}") from None
    names = found.pop(_NAMES, None)
    if len(found) != 1:
        raise UsageError(f"--actions {path} has {len(found)} arrays of numbers; the file is {_FORM}")
    single = _numbers(f"--actions {path}", *found.values())
    data = arrays.encode({_NUMBERS: single} if names is None else {_NUMBERS: single, _NAMES: names.astype(str)})
    return str(FromFile(hashlib.sha256(data).hexdigest(), each=single.ndim == 3)), data


def controls_from(data: bytes, model: Any, names: tuple[str, ...]) -> GivenControls:
    """The controls of an attachment for the actuators of a mujoco.MjModel, by their names.

    UsageError where it has other actuators, or a control that an actuator's range does not have.
    """
    found = arrays.decode(CONTROLS, data)
    rows = _numbers("the file of actions", found.get(_NUMBERS, np.empty(0)))
    each = rows.ndim == 3
    rows = rows if each else rows[:, None]
    if _NAMES in found:
        rows = rows[..., _columns(tuple(map(str, found[_NAMES].ravel())), names)]
    if rows.shape[-1] != len(names):
        raise UsageError(
            f"the file of actions has {rows.shape[-1]} columns, and the model has the actuators {', '.join(names)}"
        )
    for a, name in enumerate(names):
        if model.actuator_ctrllimited[a]:
            low, high = (np.float32(end) for end in model.actuator_ctrlrange[a])
            outside = np.argwhere((rows[..., a] < low) | (rows[..., a] > high))
            if len(outside):
                step, env = outside[0]
                raise UsageError(
                    f"the file of actions gives actuator '{name}' {rows[step, env, a]:g} in step {step}, and its range "
                    f"is {low:g} to {high:g}; {len(outside)} of its controls are outside"
                )
    least, largest = (tuple(map(float, f(axis=(0, 1)))) for f in (rows.min, rows.max))
    digest = hashlib.sha256(data).hexdigest()
    return GivenControls("controls", names, least, largest, each, digest, np.ascontiguousarray(rows))


def _numbers(name: str, array: NDArray[Any]) -> NDArray[np.float32]:
    if array.dtype.kind not in "iuf" or array.ndim not in (2, 3) or not array.size:
        raise UsageError(f"{name}: an array of {array.dtype}, {array.shape}; the file is {_FORM}")
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(array, dtype=np.float32)
    if not np.isfinite(single).all():
        at = ", ".join(map(str, np.argwhere(~np.isfinite(single))[0]))
        raise UsageError(f"{name}: element [{at}] is no finite number in float32")
    return single


def _columns(given: tuple[str, ...], names: tuple[str, ...]) -> NDArray[np.int64]:
    missing, unknown = sorted(set(names) - set(given)), sorted(set(given) - set(names))
    if missing or unknown or len(given) != len(names):
        differ = (("it lacks", missing), ("the model has no", unknown))
        said = "; ".join(f"{words} {', '.join(found)}" for words, found in differ if found)
        raise UsageError(f"the file of actions names {len(given)} actuators: {said or 'some of them twice'}")
    return np.array([given.index(name) for name in names])
