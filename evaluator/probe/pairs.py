"""Environments that should have the same trajectory, held against each other: where they part, and how far they get."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import differs, opposite_signs, ulp_distance
from gpusimbench.evaluator.metrics.levels import MAX_ULP, TOLERANCE_M, EqualityLevel
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.symmetry import Symmetry

_ROWS = 50  # a block's rows, so that none is decoded twice


@dataclass(frozen=True)
class Pairs:
    """Pairs of environments of two recordings.

    a, b      the recordings; may be the same
    envs      of each pair, the environment of a and that of b
    ahead     the state of a after step s + ahead is held against that of b after step s
    first     step of b to begin with: 0 is the initial state
    symmetry  the images of b's states are compared, bit by bit; None: the states themselves
    """

    a: Recording
    b: Recording
    envs: tuple[tuple[int, int], ...]
    ahead: int = 0
    first: int = 0
    symmetry: Symmetry | None = None


@dataclass(frozen=True)
class First:
    """The first number that differs, at the first recorded state that does.

    step         of a
    env_a, env_b of the pair
    item, field, component  body or joint, "group/field", and "x", "angle", ...
    ulp          distance in units in the last place, in the order of the bits
    signs_differ the two have opposite signs, so that `ulp` says nothing
    """

    step: int
    env_a: int
    env_b: int
    item: str
    field: str
    component: str
    ulp: int
    signs_differ: bool


@dataclass(frozen=True)
class Found:
    """What holding pairs against each other gave.

    level         bit-identical; within 8 ULP at every recorded number; positions within 0.1 mm (angles within 0.1 mrad)
                  at every recorded state; or different, also where neither positions nor angles were recorded
    pairs         how many; `differing` of them differ anywhere
    steps         number of common steps, by state hashes where both have them
    first_step    first step of a at which anything differs, by state hashes where both have them; None: nowhere
    first         the first recorded number; None where no recorded state differs
    max_ulp       largest distance of any recorded number
    max_distance  largest distance of two positions [m]; without positions, of two joint angles [rad]; without both, of
                  two sliding joints [m]
    at_step       step of a of that
    curve         (step of a, largest distance at it), of each recorded state
    unit          "m" or "rad"; empty where no distance is measured
    files         of a and b
    """

    level: EqualityLevel
    pairs: int
    differing: int
    steps: int
    first_step: int | None
    first: First | None
    max_ulp: int
    max_distance: float
    at_step: int
    curve: tuple[tuple[int, float], ...]
    unit: str
    files: tuple[Place, Place]


def compare_pairs(pairs: Pairs) -> Found | Missing:
    """Hold each pair against each other; Missing where the recordings cannot be compared by bits."""
    if why := _incomparable(pairs):
        return Missing(why)
    states = _Steps(pairs)
    apart, steps, first_step = _by_hashes(pairs)
    if not states.rows_a.size and not steps:
        return Missing("they have no step in common, neither by states nor by hashes")
    first: First | None = None
    most_ulp, most, at_step = 0, 0.0, 0
    curve: list[tuple[int, float]] = []
    unit, measured = _measured(pairs.a.fields)
    for rows in states.blocks():
        distance = np.zeros(len(rows))
        found: list[First] = []
        for field in pairs.a.fields:
            a, b = states.read(field, rows)
            mask = differs(a, b)
            if items := measured.get(field.name):
                distance = np.maximum(distance, _distance(a[:, :, items], b[:, :, items]))
            if not mask.any():
                continue
            apart |= mask.any(axis=(0, 2, 3))
            most_ulp = max(most_ulp, int(ulp_distance(a, b)[mask].max()))
            found.append(_first(pairs, field, states.steps_a[rows], a, b, mask))
        if found and first is None:
            first = min(found, key=lambda one: one.step)
        curve += zip(states.steps_a[rows].tolist(), distance.tolist(), strict=True)
    if first is not None and (first_step is None or first.step < first_step):
        first_step = first.step
    if curve:
        at_step, most = max(curve, key=lambda point: point[1])
    return Found(
        _level(first_step, first, most_ulp, most if measured else None),
        len(pairs.envs),
        int(apart.sum()),
        max(steps, len(states.rows_a)),
        first_step,
        first,
        most_ulp,
        most,
        at_step,
        tuple(curve),
        unit,
        (pairs.a.path, pairs.b.path),
    )


def _measured(fields: Sequence[StateField]) -> tuple[str, dict[str, list[int]]]:
    """The unit of distances, and by the name of a field the items that they are of; never of two units."""
    places = {f.name: list(range(len(f.items))) for f in fields if f.field == "position"}
    if places:
        return "m", places
    for unit in ("rad", "m"):
        of_unit = {f.name: [i for i, u in enumerate(f.units) if u == unit] for f in fields if f.field == "qpos"}
        if any(of_unit.values()):
            return unit, of_unit
    return "", {}


def _level(first_step: int | None, first: First | None, ulp: int, distance: float | None) -> EqualityLevel:
    # distance: None where none is measured, so that only ULPs tell how equal the numbers are
    if first_step is None:
        return EqualityLevel.BIT_IDENTICAL
    if first is None or (distance is not None and not distance <= TOLERANCE_M):
        return EqualityLevel.DIFFERENT  # at a step whose states were not recorded, nobody knows by how much
    if ulp <= MAX_ULP:
        return EqualityLevel.WITHIN_ULP
    return EqualityLevel.DIFFERENT if distance is None else EqualityLevel.WITHIN_TOLERANCE


def _incomparable(pairs: Pairs) -> str:
    a, b = pairs.a, pairs.b
    layouts = [[(f.name, f.dtype, f.items, f.components) for f in recording.fields] for recording in (a, b)]
    if layouts[0] != layouts[1]:
        return "they have other state fields"
    if a.configuration.dt != b.configuration.dt:
        return "they have other time steps"
    origins = [recording.simulation.env_origins if recording.simulation else () for recording in (a, b)]
    if pairs.symmetry and (why := next(filter(None, map(pairs.symmetry.why_unknown, a.fields)), "")):
        return why
    in_world = any(f.field == "position" and f.frame == "world" for f in a.fields)
    places = np.array(origins[0]).reshape(-1, 3)
    if in_world and pairs.symmetry and not np.array_equal(pairs.symmetry.point(places), places):
        return "environments stand at origins beside the mirror's plane or axis, so that images are rounded otherwise"
    if in_world and any(_origin(origins[0], e) != _origin(origins[1], f) for e, f in pairs.envs):
        return "they stand at different origins, so that their positions cannot be compared by bits"
    if set(a.action_names) != set(b.action_names) or any(_other_actions(pairs, name) for name in a.action_names):
        return "the environments that would be compared were given other actions"
    return ""


def _other_actions(pairs: Pairs, name: str) -> bool:
    """Whether any pair was given other actions, of the steps that are compared."""
    a, b = pairs.a.actions(name), pairs.b.actions(name)
    later = pairs.b.configuration.first_step + pairs.ahead - pairs.a.configuration.first_step  # row of a that is 0 of b
    a, b = a[max(later, 0) :], b[max(-later, 0) :]
    rows = min(len(a), len(b))
    envs_a, envs_b = (np.array(envs) for envs in zip(*pairs.envs, strict=True))
    return not np.array_equal(a[:rows, envs_a], b[:rows, envs_b])


def _origin(origins: Sequence[tuple[float, float, float]], env: int) -> tuple[float, float, float]:
    return origins[env] if origins else (0.0, 0.0, 0.0)


class _Steps:
    """The recorded states that both sides have.

    steps_a  of side a
    rows_a   and where they are in its arrays
    """

    def __init__(self, pairs: Pairs) -> None:
        self._pairs = pairs
        steps_a, steps_b = (r.state(r.fields[0].group, r.fields[0].field).steps for r in (pairs.a, pairs.b))
        wanted = steps_b[steps_b >= pairs.first]
        _, self.rows_a, rows_b = np.intersect1d(steps_a, wanted + pairs.ahead, return_indices=True)
        self._rows_b = rows_b + np.searchsorted(steps_b, pairs.first)
        self.steps_a = steps_a[self.rows_a]
        self._envs_a, self._envs_b = (np.array(envs) for envs in zip(*pairs.envs, strict=True))

    def blocks(self) -> Iterator[NDArray[np.int64]]:
        for begin in range(0, len(self.rows_a), _ROWS):
            yield np.arange(begin, min(begin + _ROWS, len(self.rows_a)))

    def read(self, field: StateField, rows: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """A field of both sides, [step, pair, item, component]."""
        sides = (
            (self._pairs.a, self.rows_a[rows], self._envs_a),
            (self._pairs.b, self._rows_b[rows], self._envs_b),
        )
        a, b = (_read_states(recording.state(field.group, field.field), at, envs) for recording, at, envs in sides)
        if (symmetry := self._pairs.symmetry) is None:
            return a, b
        # the image of the image has no signs of zeros where the image has none
        return symmetry.image(field, symmetry.image(field, a)), symmetry.image(field, b)


def _read_states(array: Any, rows: NDArray[np.int64], envs: NDArray[np.int64]) -> NDArray[Any]:
    low, first = int(rows[0]), int(envs.min())
    read: NDArray[Any] = array.read(slice(low, int(rows[-1]) + 1), slice(first, int(envs.max()) + 1))
    return np.asarray(read[rows - low][:, envs - first])


def _by_hashes(pairs: Pairs) -> tuple[NDArray[np.bool_], int, int | None]:
    """Which pairs differ by hashes, over how many common steps, and the first step of a at which one does."""
    apart = np.zeros(len(pairs.envs), dtype=bool)
    if pairs.symmetry is not None:
        return apart, 0, None  # a hash has no image
    found = [recording.fingerprints("capture") for recording in (pairs.a, pairs.b)]
    if found[0] is None or found[1] is None:
        return apart, 0, None
    a, b = found[0], found[1]
    wanted = b.steps >= pairs.first
    steps, at_a, at_b = np.intersect1d(a.steps, b.steps[wanted] + pairs.ahead, return_indices=True)
    envs_a, envs_b = (np.array(envs) for envs in zip(*pairs.envs, strict=True))
    differ = a.hashes[at_a][:, envs_a] != b.hashes[wanted][at_b][:, envs_b]
    first = np.flatnonzero(differ.any(axis=1))
    return differ.any(axis=0), len(steps), int(steps[first[0]]) if first.size else None


def _distance(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    # largest of each step; infinite where one is not finite and they differ
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.linalg.norm(a.astype(np.float64) - b.astype(np.float64), axis=-1)
    apart[np.isnan(apart)] = np.inf
    apart[~differs(a, b).any(axis=-1)] = 0.0
    return np.asarray(apart.max(axis=(1, 2), initial=0.0))


def _first(
    pairs: Pairs, field: StateField, steps: NDArray[np.int64], a: NDArray[Any], b: NDArray[Any], mask: NDArray[np.bool_]
) -> First:
    row, pair, item, component = (int(i) for i in np.argwhere(mask)[0])
    at = (row, pair, item, component)
    env_a, env_b = pairs.envs[pair]
    one, other = a[at].reshape(1), b[at].reshape(1)
    return First(
        int(steps[row]), env_a, env_b, field.items[item], field.name, field.components[component],
        int(ulp_distance(one, other)[0]), bool(opposite_signs(one, other)[0]),
    )  # fmt: skip
