"""Two sides of a comparison, each some environments of a recording, and what they have in common: fields, and steps at
the same simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.result import Basis, Contacts, Side
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.checks import MAX_COUNT
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import ENV, StateField
from gpusimbench.schemas.provenance import engine_name

EPISODE_STEP = "episode_step"
"""Of the group ENV: the step within its episode, 0 in the state that a reset made."""
_OF_THE_STEP = ("action", "final_observation", "info", "reward", "terminated", "truncated")

_LARGEST_RATIO = 1000  # of two time steps, and of its parts as a fraction
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Selection:
    """A recording and those of its environments that are compared, in order."""

    recording: Recording
    envs: range

    @property
    def slice(self) -> slice:
        """The environments as a slice."""
        return slice(self.envs.start, self.envs.stop)

    def side(self) -> Side:
        """The side as results describe it."""
        r = self.recording
        version = r.simulation.version if r.simulation else ""
        label = f"{engine_name(r.configuration.simulator, r.simulation)} {version}".strip()
        return Side(r.path, r.provenance.run_id, label, r.configuration.dt, self.envs, r.status, lost(r))

    def offsets(self, field: StateField) -> NDArray[np.float64]:
        """What the environments' origins add to the recorded positions of a field [m], shape [env, 3]."""
        origins = self.recording.simulation.env_origins if self.recording.simulation else ()
        if not origins or field.field != "position" or field.frame != "world":
            return np.zeros((len(self.envs), 3))
        return np.array(origins[self.slice], dtype=np.float64)

    def contacts(self, phase: str, step: int) -> Contacts | None:
        """The counter of contacts at a step, over all environments of the recording; None where it has none."""
        counted = self.recording.counts.get(phase, {}).get("contacts")
        at = np.flatnonzero(counted.steps == step) if counted else np.empty(0)
        if counted is None or not at.size:
            return None
        return Contacts(float(counted.mean[at[0]]), float(counted.max[at[0]]))

    def begins_episode(self, step: int, env: int) -> bool:
        """Whether a reset after the first one made the state of a step; False where it is not known."""
        if not step or f"{ENV}/{EPISODE_STEP}" not in {field.name for field in self.recording.fields}:
            return False
        states = self.recording.state(ENV, EPISODE_STEP)
        at = np.flatnonzero(np.asarray(states.steps) == step)
        return bool(at.size) and not np.any(states[int(at[0]), env])


def by_a_reset(fields: Sequence[str]) -> bool:
    """Whether a reset can have made what differs in these fields: rewards and flags in the row of a first observation
    may be those of the step that ended the episode before."""
    return not all(name.startswith(tuple(f"{ENV}/{start}" for start in _OF_THE_STEP)) for name in fields)


def one_env(recording: Recording, env: int) -> Selection:
    """One environment; UsageError where it is not there."""
    if not 0 <= env < recording.configuration.n_env:
        last = recording.configuration.n_env - 1
        raise UsageError(f"{recording.path} has no environment {env}: it has 0 to {last}")
    return Selection(recording, range(env, env + 1))


def lost(recording: Recording) -> tuple[str, ...]:
    """One sentence for each thing that a recording should hold and does not."""
    found = [f"{recording.path}: lost data: {sentence}" for sentence in recording.dropouts]
    if recording.status == "incomplete":
        found.append(f"{recording.path}: {recording.reason}")
    return tuple(found)


def picked(array: NDArray[Any], items: NDArray[np.int64], components: NDArray[np.int64]) -> NDArray[Any]:
    """Items and components of an array [..., item, component] by index; a view where all are taken in order."""
    for axis, index in ((-2, items), (-1, components)):
        if len(index) != array.shape[axis] or (index != np.arange(len(index))).any():
            array = np.take(array, index, axis=axis)
    return array


@dataclass(frozen=True)
class CommonField:
    """A field that both sides have, or the items of it that have one unit.

    a, b                    as each describes it
    items, components       names of what both have, in the order of a
    items_a, components_a   where they are in a; of b likewise
    basis                   what counts as different
    only                    unit of the items, where the field's items have several; empty where they have one
    undivided               whether the parts of the field together leave nothing out
    """

    a: StateField
    b: StateField
    items: tuple[str, ...]
    components: tuple[str, ...]
    items_a: NDArray[np.int64]
    items_b: NDArray[np.int64]
    components_a: NDArray[np.int64]
    components_b: NDArray[np.int64]
    basis: Basis
    only: str = ""
    undivided: bool = False

    @property
    def name(self) -> str:
        """ "group/field", and the unit of a part."""
        return f"{self.a.name} [{self.only}]" if self.only else self.a.name

    @property
    def unit(self) -> str:
        """The unit of the numbers."""
        return self.only or self.a.unit

    @property
    def whole(self) -> bool:
        """Whether nothing of either side's field is left out or in another order."""
        if self.only:
            return self.undivided
        return self.a.items == self.b.items == self.items and self.a.components == self.b.components == self.components

    @property
    def is_position(self) -> bool:
        """Whether it tells where bodies are [m]."""
        return self.a.field == "position" and self.a.unit == "m" and {"x", "y"} <= set(self.components)

    @property
    def is_rotation(self) -> bool:
        """Whether it is of unit quaternions, of which q and -q are one rotation."""
        return self.a.unit == "unit quaternion" and len(self.components) == len(self.a.components) == 4


def common_fields(a: Selection, b: Selection) -> tuple[tuple[CommonField, ...], list[str]]:
    """Fields that both sides have, and in sentences what is left out."""
    theirs = {f.name: f for f in b.recording.fields}
    found, left_out = [], []
    for field in a.recording.fields:
        other = theirs.pop(field.name, None)
        if other is None:
            left_out.append(f"{field.name}: only in a")
            continue
        why_not = _why_not(field, other)
        if why_not:
            left_out.append(f"{field.name}: {why_not}")
            continue
        shared = _common(field, other, a, b)
        for what, of_a, of_b, of_both in (
            ("items", field.items, other.items, shared.items),
            ("components", field.components, other.components, shared.components),
        ):
            if not len(of_a) == len(of_b) == len(of_both):
                left_out.append(f"{field.name}: {len(of_both)} {what} in common, of {len(of_a)} in a, {len(of_b)} in b")
        if shared.items and shared.components:
            found += _by_unit(shared)
    left_out += [f"{name}: only in b" for name in theirs]
    return tuple(found), left_out


def _why_not(a: StateField, b: StateField) -> str:
    units = dict(zip(b.items, b.units, strict=True))
    same = [units[item] == unit for item, unit in zip(a.items, a.units, strict=True) if item in units]
    if same and not any(same):
        return f"in {a.unit} in a, in {b.unit} in b"
    if a.frame != b.frame and {a.frame, b.frame} != {"world", "env"}:
        return f"in frame {a.frame} in a, {b.frame} in b"
    for field in (a, b):
        if len(set(field.items)) < len(field.items) or len(set(field.components)) < len(field.components):
            return "two items or components have the same name"
    return ""


def _common(a: StateField, b: StateField, left: Selection, right: Selection) -> CommonField:
    items_a, items_b = _matched(list(zip(a.items, a.units, strict=True)), list(zip(b.items, b.units, strict=True)))
    components_a, components_b = _matched(a.components, b.components)
    if (left.offsets(a) != right.offsets(b)).any():
        basis = Basis.LOCAL
    else:
        basis = Basis.BITS if a.dtype == b.dtype else Basis.FLOAT32
    return CommonField(
        a, b, tuple(a.items[i] for i in items_a), tuple(a.components[i] for i in components_a),
        items_a, items_b, components_a, components_b, basis,
    )  # fmt: skip


def _by_unit(field: CommonField) -> list[CommonField]:
    """The parts of a field whose items differ in their units; the field itself where they do not."""
    units = [field.a.units[item] for item in field.items_a]
    if len(set(units)) == 1 and not field.a.item_units:
        return [field]
    parts = []
    for unit in dict.fromkeys(units):
        at = np.flatnonzero([other == unit for other in units])
        items = tuple(field.items[i] for i in at)
        parts.append(
            replace(
                field, items=items, items_a=field.items_a[at], items_b=field.items_b[at], only=unit,
                undivided=field.whole,
            )
        )  # fmt: skip
    return parts


def _matched(a: Sequence[object], b: Sequence[object]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    at = {name: index for index, name in enumerate(b)}
    pairs = [(index, at[name]) for index, name in enumerate(a) if name in at]
    both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def step_ratio(dt_a: float, dt_b: float) -> Fraction | None:
    """Steps of b for a step of a, where both are at the same simulated time again and again; None where they are not.

    dt_a, dt_b  time steps [s]
    """
    ratio = dt_a / dt_b
    if not 1 / _LARGEST_RATIO <= ratio <= _LARGEST_RATIO:
        return None
    fraction = Fraction(ratio).limit_denominator(_LARGEST_RATIO)
    return fraction if abs(float(fraction) - ratio) <= _TOLERANCE * ratio else None


def common_steps(
    a: NDArray[np.int64], b: NDArray[np.int64], ratio: Fraction
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Steps of a and of b at the same simulated time, both increasing.

    ratio  steps of b for a step of a
    """
    a = a[(a >= 0) & (a <= MAX_COUNT)]
    scaled = a * ratio.numerator
    whole = scaled % ratio.denominator == 0
    there, at, _ = np.intersect1d(scaled[whole] // ratio.denominator, b, return_indices=True)
    return a[whole][at], there
