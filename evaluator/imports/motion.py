"""How a model moves in an engine's hands, compared with the reference: links in drawn poses, and responses to single
impulses and controls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.imports.parameters import angle
from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.imported import Trials

MAX_DISTANCE = 1e-5
"""Of a link from where the reference has it [m]."""

MAX_ANGLE = 1e-4
"""Between the orientations of a link [rad]."""

MAX_STEPS = 0.1
"""Of a response: its largest difference, as a share of what the reference changes in a step."""

_SAME_POSE = 1e-5  # [m or rad] between the joints of two engines that were given the same pose
_LEAST = 5e-4  # [rad/s or m/s] a response changes less in a step: what differs is held against this

Floats = NDArray[np.floating]

Items = Mapping[str, Sequence[str]]
"""Names of a state field's items, by its name, GROUP/FIELD."""

Coordinates = dict[tuple[str, str], Floats]
"""An array [..., width] of each field and item."""


@dataclass(frozen=True)
class LinkError:
    """How far a link is from where the reference has it, at most in all poses.

    distance  of the origins [m]
    angle     between the orientations [rad]
    """

    link: str
    distance: float
    angle: float

    @property
    def agrees(self) -> bool:
        """Whether it is where it should be."""
        return self.distance <= MAX_DISTANCE and self.angle <= MAX_ANGLE


@dataclass(frozen=True)
class Poses:
    """Kinematics in n_pose poses; links in the order of the reference, parents first."""

    n_pose: int
    links: tuple[LinkError, ...]

    @property
    def wrong(self) -> tuple[LinkError, ...]:
        """Links that are not where they should be."""
        return tuple(link for link in self.links if not link.agrees)


@dataclass(frozen=True)
class Response:
    """What a joint does that begins with a speed, or an actuator that is given a control.

    kind    "joint" or "actuator"
    target  its name
    steps   largest difference of the velocities within n_step steps, in units of what the reference's velocity changes
            in one step: how late or early the engine is, in time steps
    """

    kind: str
    target: str
    steps: float | Missing

    @property
    def agrees(self) -> bool | None:
        """Whether it is within the tolerance; None where it was not compared."""
        return None if isinstance(self.steps, Missing) else self.steps <= MAX_STEPS


@dataclass(frozen=True)
class Responses:
    """Of all joints and actuators, after n_step steps."""

    n_step: int
    each: tuple[Response, ...]

    @property
    def wrong(self) -> tuple[Response, ...]:
        """Responses that differ, the worst first."""
        differ = [one for one in self.each if one.agrees is False]
        return tuple(sorted(differ, key=lambda one: -float(one.steps) if not isinstance(one.steps, Missing) else 0.0))


def poses(reference: Trials, engine: Trials, items: tuple[Items, Items]) -> Poses | Missing:
    """Where links are in the poses that both were given; `items` of the reference's fields and of the engine's."""
    wanted, found = _by_item(reference.given, items[0]), _by_item(engine.given, items[1])
    if why := _other(wanted, found, "in other poses"):
        return Missing(why)
    if len(reference.position) != len(engine.position):
        return Missing("they were tried in different numbers of poses")
    links = [link for link in reference.links if link in set(engine.links)]
    errors = []
    for link in links:
        a, b = reference.links.index(link), engine.links.index(link)
        apart = np.linalg.norm(reference.position[:, a] - engine.position[:, b], axis=1)
        turned = [angle(x, y) for x, y in zip(reference.orientation[:, a], engine.orientation[:, b], strict=True)]
        errors.append(LinkError(link, _most(apart), _most(np.array(turned))))
    return Poses(len(reference.position), tuple(errors))


def responses(reference: Trials, engine: Trials, items: tuple[Items, Items]) -> Responses | Missing:
    """What joints and actuators do, in trials that both made; arguments as of `poses`."""
    if why := _other(_by_item(reference.start, items[0]), _by_item(engine.start, items[1]), "from other poses"):
        return Missing(why)
    wanted, found = _by_item(reference.velocity, items[0]), _by_item(engine.velocity, items[1])
    steps = [len(array) for array in (*wanted.values(), *found.values())]
    if not steps or min(steps) < max(steps):
        return Missing("the trials have different numbers of steps")
    at = {label: trial for trial, label in enumerate(_labels(engine))}
    worst: dict[tuple[str, str], float | Missing] = {}
    for trial, label in enumerate(_labels(reference)):
        kind, target, _ = label
        if kind == "rest":
            continue
        there = at.get(label)
        value: float | Missing
        if there is None:
            value = Missing("it was not tried")
        elif max(int(reference.contacts[trial]), int(engine.contacts[there])) > 0:
            value = Missing("bodies touch in this trial")
        else:
            rest = None if kind == "joint" else (0, 0)
            value = _late(wanted, found, (trial, there), rest)
        worst[kind, target] = _worse(worst.get((kind, target), 0.0), value)
    each = tuple(Response(kind, target, value) for (kind, target), value in worst.items())
    return Responses(steps[0] - 1, each)


def _worse(a: float | Missing, b: float | Missing) -> float | Missing:
    if isinstance(a, Missing) or isinstance(b, Missing):
        return a if isinstance(a, Missing) else b
    return max(a, b)


def _late(
    wanted: Coordinates, found: Coordinates, trials: tuple[int, int], rest: tuple[int, int] | None
) -> float | Missing:
    # of a joint: the item that the trial sets in motion; of an actuator: all items, against the trial at rest
    change, apart = 0.0, 0.0
    for key, ours in wanted.items():
        x = ours[:, trials[0]]
        if rest is None and not x[0].any():
            continue
        theirs = found.get(key)
        if theirs is None:
            return Missing(f"the engine has no {key[1]} in {key[0]}")
        y = theirs[:, trials[1]]
        if x.shape != y.shape:
            return Missing(f"{key[1]} in {key[0]} has another number of components")
        if rest is not None:
            x, y = x - ours[:, rest[0]], y - theirs[:, rest[1]]
        change = max(change, _most(np.abs(np.diff(x, axis=0))))
        apart = max(apart, _most(np.abs(x - y)))
    return apart / max(change, _LEAST)


def _most(values: Floats) -> float:
    found = float(np.max(values, initial=0.0))
    return float("inf") if np.isnan(found) else found


def _labels(trials: Trials) -> list[tuple[str, str, int]]:
    # of several trials of one joint, each has its number
    seen: Counter[tuple[str, str]] = Counter()
    labels = []
    for kind, target in zip(trials.kinds, trials.targets, strict=True):
        labels.append((kind, target, seen[kind, target]))
        seen[kind, target] += 1
    return labels


def _by_item(arrays: Mapping[str, Floats], items: Items) -> Coordinates:
    return {
        (field, item): array[..., number, :]
        for field, array in arrays.items()
        for number, item in enumerate(items.get(field, ())[: array.shape[-2]])
    }


def _other(wanted: Coordinates, found: Coordinates, how: str) -> str:
    # why what two engines were given is not the same; empty where it is
    if wanted.keys() != found.keys():
        field, item = sorted(wanted.keys() ^ found.keys())[0]
        return f"only one of the two has {item} in {field}"
    for (field, item), ours in wanted.items():
        theirs = found[field, item]
        if ours.shape != theirs.shape:
            return f"they were tried {how}"
        near = np.abs(ours - theirs)
        if field.endswith("orientation"):
            near = np.minimum(near, np.abs(ours + theirs))
        if not _most(near) <= _SAME_POSE * max(1.0, _most(np.abs(ours))):
            return f"they were tried {how}: {item} differs, as limits or references do"
    return ""
