"""Units, frames and components of the state fields: the vocabulary that every recording uses."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, UsageError

UNKNOWN = "unknown"
"""The unit of numbers of which nothing tells a unit."""


@dataclass(frozen=True)
class FieldKind:
    """What a state field means.

    components  names of the numbers of an item; empty where they depend on the joint (qpos, qvel)
    unit        SI unit
    frame       "world": the engine's global frame, including the env's origin; "env": relative to the env's
                origin; "joint": joint coordinates
    """

    components: tuple[str, ...]
    unit: str
    frame: str


FIELD_KINDS = {
    "position": FieldKind(("x", "y", "z"), "m", "world"),
    "orientation": FieldKind(("w", "x", "y", "z"), "unit quaternion", "world"),
    "linear_velocity": FieldKind(("x", "y", "z"), "m/s", "world"),
    "angular_velocity": FieldKind(("x", "y", "z"), "rad/s", "world"),
    "qpos": FieldKind((), "m or rad", "joint"),
    "qvel": FieldKind((), "m/s or rad/s", "joint"),
}

DIMENSIONLESS = "1"
"""The unit of flags and counts."""

ENV = "env"
"""The group of arrays of environments: observations, actions, rewards, and whatever else is no state of bodies."""

DTYPES = ("float32", "float64")

BODY_FIELDS = ("position", "orientation", "linear_velocity", "angular_velocity")


@dataclass(frozen=True)
class StateField:
    """One recorded array of a run, shape [step, env, item, width].

    group       bodies or joints that belong together, such as cubes, bodies, joints; ENV for arrays of environments
    field       a key of FIELD_KINDS; the array's name in the group ENV
    dtype       "float32" or "float64": what the engine computes in
    items       names of the bodies or joints, in order; one empty name in the group ENV
    components  names of the numbers of one item
    unit        SI unit; where items differ in it, all of their units in words, such as "m or rad"
    frame       see FieldKind
    note        how the recorded number differs from what the engine returns; empty where it does not
    item_units  SI unit of each item, in the order of the items, where they differ; empty where all are in `unit`
    """

    group: str
    field: str
    dtype: str
    items: tuple[str, ...]
    components: tuple[str, ...]
    unit: str
    frame: str
    note: str = ""
    item_units: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """ "group/field", unique within a recording; the field alone where it is of no group, as arrays may be."""
        return f"{self.group}/{self.field}" if self.group else self.field

    @property
    def width(self) -> int:
        """Numbers per item."""
        return len(self.components)

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each item, in the order of the items."""
        return self.item_units or (self.unit,) * len(self.items)

    def to_metadata(self) -> dict[str, str]:
        """The strings that a channel carries; lists are joined by commas."""
        return {
            "group": self.group,
            "field": self.field,
            "dtype": self.dtype,
            "shape": "step,env,item,component",
            "items": ",".join(self.items),
            "components": ",".join(self.components),
            "unit": self.unit,
            "frame": self.frame,
            "note": self.note,
            **({"item_units": ",".join(self.item_units)} if self.item_units else {}),
        }

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> StateField:
        """From the JSON of a recording; DamagedRecording where a key is missing or of the wrong kind."""
        dtype = checks.text(record, "dtype")
        if dtype not in DTYPES:
            raise DamagedRecording(f"dtype is not one of {', '.join(DTYPES)}: {dtype[:20]!r}")
        items, item_units = checks.texts(record, "items"), checks.texts(record, "item_units")
        if item_units and len(item_units) != len(items):
            raise DamagedRecording(f"item_units has {len(item_units)} units, and there are {len(items)} items")
        return cls(
            group=checks.text(record, "group"),
            field=checks.text(record, "field"),
            dtype=dtype,
            items=items,
            components=checks.texts(record, "components"),
            unit=checks.text(record, "unit"),
            frame=checks.text(record, "frame"),
            note=checks.text(record, "note", default=""),
            item_units=item_units,
        )


def body_field(group: str, field: str, dtype: str, items: tuple[str, ...], *, note: str = "") -> StateField:
    """A pose or velocity field of a group of bodies, with the unit and frame that the format gives it.

    UsageError for a field that is not in BODY_FIELDS.
    """
    if field not in BODY_FIELDS:
        raise UsageError(f"'{field}' is no field of bodies; these are: {', '.join(BODY_FIELDS)}")
    kind = FIELD_KINDS[field]
    return StateField(group, field, dtype, items, kind.components, kind.unit, kind.frame, note)


def body_fields(
    groups: Mapping[str, tuple[str, ...]], dtype: str, notes: Mapping[str, str] | None = None
) -> tuple[StateField, ...]:
    """All fields of BODY_FIELDS for each group of bodies, groups outermost.

    notes  by the name of a field
    """
    noted = notes or {}
    return tuple(
        body_field(group, field, dtype, names, note=noted.get(field, ""))
        for group, names in groups.items()
        for field in BODY_FIELDS
    )


def joint_field(
    group: str, field: str, dtype: str, joints: tuple[str, ...], *, slides: Collection[str] = ()
) -> StateField:
    """Positions ("qpos") or velocities ("qvel") of hinges and slides, one number a joint.

    slides  names of the joints that slide [m, m/s]; all others turn [rad, rad/s]
    """
    turns, moves = {"qpos": ("rad", "m"), "qvel": ("rad/s", "m/s")}[field]
    kind, units = FIELD_KINDS[field], tuple(moves if joint in slides else turns for joint in joints)
    if len(set(units)) > 1:
        return StateField(group, field, dtype, joints, ("coordinate",), kind.unit, kind.frame, "", units)
    component = "coordinate" if moves in units else "angle"
    return StateField(group, field, dtype, joints, (component,), moves if moves in units else turns, kind.frame)


def ball_fields(group: str, dtype: str, joints: tuple[str, ...]) -> tuple[StateField, ...]:
    """Orientations and angular velocities of ball joints, in joint coordinates: of the child body in its parent."""
    return tuple(
        replace(body_field(group, field, dtype, joints), frame="joint") for field in ("orientation", "angular_velocity")
    )


def array_field(
    name: str, dtype: str, shape: tuple[int, ...] = (), *, unit: str = UNKNOWN, note: str = ""
) -> StateField:
    """An array of each environment that is no state of bodies: an observation, an action, a reward, a flag.

    name   lower-case letters, digits and underscores; no key of FIELD_KINDS
    dtype  "float32" or "float64"; flags are 0 and 1
    shape  of the array of one environment; numbers are named by their indices, joined by underscores
    unit   where all its numbers have one

    UsageError for the name of a state of bodies or joints.
    """
    if name in FIELD_KINDS:
        raise UsageError(f"'{name}' is a state of bodies or joints, which body_field and joint_field describe")
    components = tuple("_".join(map(str, at)) for at in product(*map(range, shape)))
    return StateField(ENV, name, dtype, ("",), components, unit, UNKNOWN, note)
