"""What an engine made of a model file: the parameters that it holds, by name, and how they move in its hands.

Two attachments, both archives of schemas.arrays. ``imported.npz`` has, for each kind of thing (bodies, joints, ...):

    KIND/names      of the things that the engine has, in its own order
    KIND/PARAMETER  a row for each of them, as of PARAMETERS; texts, or numbers in SI units. NaN: it has none
    unread          texts KIND/PARAMETER, a tab, and why the engine's value is not there

``import-trials.npz`` has what the engine did with drawn poses and single impulses, as of TrialArrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import DamagedRecording

IMPORTED = "imported.npz"
"""Attachment with the parameters that an engine holds."""

TRIALS = "import-trials.npz"
"""Attachment with what an engine did with drawn poses and single impulses."""

DROP = "import-drop.npz"
"""Attachment with how a model came to the ground on an engine."""

MAX_BYTES = 64 << 20
"""Of the arrays of each attachment."""

NAMES, UNREAD = "names", "unread"
_MOST_NAMES = 1 << 20

KINDS = {
    "model": "the model as a whole",
    "bodies": "",
    "joints": "",
    "geoms": "collision and visual shapes",
    "pairs": "contact pairs that the model lists",
    "excludes": "pairs of bodies that do not collide",
    "tendons": "",
    "equalities": "constraints of equality",
    "actuators": "",
}
"""Kinds of things, in order, and what they are where the word does not say it."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a kind of things.

    unit     of its numbers, "" for those without; "name": texts, "wxyz": a rotation
    default  what an engine that does not know it does, in every component; None: no engine can do without it
    """

    kind: str
    name: str
    unit: str
    default: float | None = None

    @property
    def key(self) -> str:
        """KIND/NAME, as the attachment has it."""
        return f"{self.kind}/{self.name}"


def _parameters(kind: str, **units: str | tuple[str, float]) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(kind, name, *(unit if isinstance(unit, tuple) else (unit, None))) for name, unit in units.items()
    )


_INF = float("inf")

PARAMETERS: tuple[Parameter, ...] = (
    *_parameters("model", gravity="m/s^2", timestep="s", wind=("m/s", 0), density=("kg/m^3", 0), viscosity=("Pa s", 0)),
    *_parameters(
        "bodies", parent="name", position="m", orientation="wxyz", mass="kg", centre_of_mass="m", inertia="kg m^2",
        gravity_compensation=("", 0),
    ),
    *_parameters(
        "joints", type="name", body="name", anchor="m", axis="", reference="rad or m", range=("rad or m", _INF),
        stiffness=("N m/rad or N/m", 0), spring_reference="rad or m", damping=("N m s/rad or N s/m", 0),
        armature=("kg m^2 or kg", 0), frictionloss=("N m or N", 0), force_range=("N m or N", _INF),
        limit_solref="", limit_solimp="", margin=("rad or m", 0),
    ),
    *_parameters(
        "geoms", type="name", body="name", size="m", position="m", orientation="wxyz", friction="", condim="",
        contype="", conaffinity="", priority=("", 0), solref="", solimp="", solmix="", margin=("m", 0), gap=("m", 0),
    ),
    *_parameters("pairs", condim="", friction="", solref="", solimp="", margin=("m", 0), gap=("m", 0)),
    *_parameters(
        "tendons", path="name", range=("rad or m", _INF), stiffness=("N m/rad or N/m", 0), spring_length="rad or m",
        damping=("N m s/rad or N s/m", 0), armature=("kg m^2 or kg", 0), frictionloss=("N m or N", 0),
        force_range=("N m or N", _INF),
    ),
    *_parameters("equalities", type="name", objects="name", active="", data="", solref="", solimp=""),
    *_parameters(
        "actuators", target="name", gear="", gain_type="name", gain="", bias_type="name", bias="", dynamics_type="name",
        dynamics="", control_range=("", _INF), force_range=("N m or N", _INF), activation_range=("", _INF),
    ),
)  # fmt: skip
"""All parameters, in the order in which they are shown. Positions and orientations of bodies are in the parent's frame,
those of shapes in the body's; an inertia is the tensor about the centre of mass along the body's axes, as xx, yy, zz,
xy, xz, yz, so that it does not depend on how an engine turns its principal axes. A range is lower and upper; -inf and
inf, where there is no limit. Gain, bias and dynamics are MuJoCo's gainprm, biasprm and dynprm: of a position actuator
kp is gain 0, and bias 1 and 2 are -kp and -kv."""


Values = NDArray[np.float64] | NDArray[np.str_]


@dataclass(frozen=True)
class Imported:
    """The parameters that an engine holds.

    names   of the things of a kind, in the engine's order; a kind that is not read is left out
    values  by KIND/PARAMETER: a row for each name, [item, component], float64 or texts
    unread  by KIND/PARAMETER, or by KIND for all of it: why there are no values
    """

    names: Mapping[str, tuple[str, ...]]
    values: Mapping[str, Values]
    unread: Mapping[str, str] = field(default_factory=dict)

    def encoded(self) -> bytes:
        """The attachment."""
        found: dict[str, NDArray[np.float64] | NDArray[np.str_]] = {
            f"{kind}/{NAMES}": np.array(names, dtype=np.str_) for kind, names in self.names.items()
        }
        found |= self.values
        if self.unread:
            found[UNREAD] = np.array([f"{key}\t{why}" for key, why in self.unread.items()])
        return arrays.encode(found)

    @classmethod
    def decoded(cls, data: bytes) -> Imported:
        """From the attachment. DamagedRecording where it is none, or says of a thing what it has no name for."""
        found = arrays.decode(IMPORTED, data, most=MAX_BYTES)
        names: dict[str, tuple[str, ...]] = {}
        for kind in KINDS:
            listed = found.get(f"{kind}/{NAMES}")
            if listed is None:
                continue
            if listed.ndim != 1 or (listed.size and listed.dtype.kind != "U"):
                raise DamagedRecording(f"{IMPORTED}: {kind}/{NAMES} is no list of names")
            names[kind] = tuple(map(str, listed))
            if len(set(names[kind])) < len(names[kind]):
                raise DamagedRecording(f"{IMPORTED}: two {kind} have one name")
        values: dict[str, Values] = {}
        for parameter in PARAMETERS:
            array = found.get(parameter.key)
            if array is None:
                continue
            texts = parameter.unit == "name"
            if array.ndim != 2 or len(array) != len(names.get(parameter.kind, ())) or not array.shape[1]:
                raise DamagedRecording(f"{IMPORTED}: {parameter.key} has the shape {array.shape}, not a row a name")
            if (array.dtype.kind == "U") != texts:
                raise DamagedRecording(f"{IMPORTED}: {parameter.key} is of type {array.dtype}")
            values[parameter.key] = array if texts else array.astype(np.float64)
        listed = found.get(UNREAD, np.array([], dtype=np.str_))
        if listed.ndim != 1 or (listed.size and listed.dtype.kind != "U"):
            raise DamagedRecording(f"{IMPORTED}: {UNREAD} is no list of texts")
        unread = dict(text.partition("\t")[::2] for text in map(str, listed))
        return cls(names, values, unread)


Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Trials:
    """What an engine did with drawn poses and single impulses. FIELD is the name of a state field, GROUP/FIELD.

    links           names of the bodies whose poses there are
    given           by FIELD: the poses that environments were given, [pose, item, width]
    position        of the links in these poses [pose, link, 3], in the environment's frame [m]
    orientation     the same, wxyz [pose, link, 4]
    start           by FIELD: the poses in which all trials begin, [item, width]
    kinds, targets  of each trial: "rest", "joint" or "actuator", and the name of the joint or actuator
    velocity        by FIELD, of velocities alone: before the first step and after each, [step, trial, item, width]
    contacts        the most contacts that there were at any step of a trial; -1 where the engine counts none
    """

    links: tuple[str, ...]
    given: Mapping[str, Floats]
    position: Floats
    orientation: Floats
    start: Mapping[str, Floats]
    kinds: tuple[str, ...]
    targets: tuple[str, ...]
    velocity: Mapping[str, Floats]
    contacts: NDArray[np.int64]

    def encoded(self) -> bytes:
        """The attachment."""
        return arrays.encode(
            {
                "links": np.array(self.links, dtype=np.str_),
                **{f"given/{name}": array for name, array in self.given.items()},
                "position": self.position,
                "orientation": self.orientation,
                **{f"start/{name}": array for name, array in self.start.items()},
                "kinds": np.array(self.kinds, dtype=np.str_),
                "targets": np.array(self.targets, dtype=np.str_),
                **{f"velocity/{name}": array for name, array in self.velocity.items()},
                "contacts": self.contacts,
            }
        )

    @classmethod
    def decoded(cls, data: bytes) -> Trials:
        """From the attachment; DamagedRecording where it is none, or its shapes do not fit each other."""
        found = arrays.decode(TRIALS, data, most=MAX_BYTES)
        links, kinds, targets = (_texts(found, name) for name in ("links", "kinds", "targets"))
        position = _numbers(found, "position", (None, len(links), 3))
        n_pose = len(position)
        made = cls(
            links,
            {name: _numbers(found, f"given/{name}", (n_pose, None, None)) for name in _below(found, "given/")},
            position,
            _numbers(found, "orientation", (n_pose, len(links), 4)),
            {name: _numbers(found, f"start/{name}", (None, None)) for name in _below(found, "start/")},
            kinds,
            targets,
            {
                name: _numbers(found, f"velocity/{name}", (None, len(kinds), None, None))
                for name in _below(found, "velocity/")
            },
            _numbers(found, "contacts", (len(kinds),)).astype(np.int64),
        )
        steps = {len(array) for array in made.velocity.values()}
        if len(targets) != len(kinds) or len(steps) > 1 or not all(step > 1 for step in steps):
            raise DamagedRecording(f"{TRIALS} has trials of different lengths")
        return made


@dataclass(frozen=True)
class Drop:
    """How a model comes to the ground on an engine, from its first state and without controls. A row is the state
    before the first step, or after a step; all of it is computed by MuJoCo C's model from the engine's states.

    time      [row] [s]
    contact   [row], whether a shape that moves reaches into one that does not
    height    [row], of the centre of mass of all that moves [m]
    momentum  [row], of the same, upwards [kg m/s]
    weight    of the same [N]
    """

    time: Floats
    contact: NDArray[np.bool_]
    height: Floats
    momentum: Floats
    weight: float

    def encoded(self) -> bytes:
        """The attachment."""
        return arrays.encode(
            {name: np.asarray(array) for name, array in vars(self).items()} | {"contact": self.contact.astype(np.int64)}
        )

    @classmethod
    def decoded(cls, data: bytes) -> Drop:
        """From the attachment; DamagedRecording where it is none, or its shapes do not fit each other."""
        found = arrays.decode(DROP, data, most=MAX_BYTES)
        time = _numbers(found, "time", (None,), of=DROP)
        rows = [_numbers(found, name, (len(time),), of=DROP) for name in ("contact", "height", "momentum")]
        weight = _numbers(found, "weight", (), of=DROP)
        if len(time) < 2 or not (np.diff(time) > 0).all() or not weight > 0:
            raise DamagedRecording(f"{DROP}: times do not ascend, or nothing has a weight")
        return cls(time, rows[0] != 0, rows[1], rows[2], float(weight))


def _below(found: Mapping[str, object], prefix: str) -> list[str]:
    return [name.removeprefix(prefix) for name in found if name.startswith(prefix)]


def _texts(found: Mapping[str, NDArray[np.generic]], name: str) -> tuple[str, ...]:
    array = found.get(name)
    if array is None or array.ndim != 1 or array.size > _MOST_NAMES or (array.size and array.dtype.kind != "U"):
        raise DamagedRecording(f"{TRIALS}: {name} is no list of names")
    return tuple(map(str, array))


def _numbers(
    found: Mapping[str, NDArray[np.generic]], name: str, shape: tuple[int | None, ...], of: str = TRIALS
) -> NDArray[np.floating]:
    array = found.get(name)
    if array is None or array.dtype.kind not in "if" or array.ndim != len(shape):
        raise DamagedRecording(f"{of}: {name} is no array of {len(shape)} axes")
    if any(wanted is not None and size != wanted for size, wanted in zip(array.shape, shape, strict=True)):
        raise DamagedRecording(f"{of}: {name} has the shape {array.shape}")
    if not np.isfinite(array).all() and name in ("contacts", "time", "weight"):
        raise DamagedRecording(f"{of}: {name} is not finite")
    return array.astype(np.float64)
