"""Symmetries of scenes: changes of the state after which the same physics must go on alike.

A run begins in images of the usual initial states (schemas.initial), and the images of what follows are compared with
the usual run. A symmetry is its own inverse.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.initial import Initial

_POLAR = ("position", "linear_velocity")
_AXIAL = ("angular_velocity", "orientation")
_SHAPES = ("box", "sphere", "capsule", "plane")  # each its own image in its own axes


@dataclass(frozen=True)
class Mirror:
    """A reflection in a vertical plane through the origin of an environment, or the half turn about the vertical axis
    there, which is two such reflections; see Symmetry.

    Both change signs alone, so they are exact, and rounding to nearest commutes with them. With S the diagonal matrix
    of the signs, of a body that is its own image in its own axes, as boxes, spheres and capsules are:

        position, linear velocity    S p
        rotation matrix R            S R S: the body's axes are mirrored or turned too. S R is left-handed after a
                                     reflection; after a half turn, its quaternion exchanges components, which an
                                     engine rounds otherwise
        angular velocity             det(S) S w, as of an axial vector: skew(w) becomes S skew(w) S
        quaternion (c, u)            (c, det(S) S u): of R's axis and angle, the axis is axial, the angle stays

    A zero is its own image, without a sign: exact cancellation gives +0.0 on both sides, so IEEE arithmetic itself does
    not mirror the sign of a zero.

    axes     as of schemas.initial.AXES
    why_not  why the scene is not its own image; empty where it is
    """

    axes: str
    why_not: str = ""

    @classmethod
    def of(cls, scene: Mapping[str, Any], axes: str) -> Mirror:
        """That of a scene, described as in scene.json."""
        why = why_unlike_its_image(scene, axes)
        return cls(axes, why and f"is not its own {_image(axes)}: {why}")

    @property
    def words(self) -> str:
        """The plane or axis."""
        return "turned by a half turn about z" if self.axes == "xy" else f"mirrored in the plane {self.axes} = 0"

    def why_unknown(self, layout: StateField) -> str:
        """Why a field has no known image: joints have none."""
        return "" if can_mirror(layout.field) else f"the {_image(self.axes)} of {layout.name} is not known"

    def image(self, layout: StateField, values: NDArray[Any]) -> NDArray[Any]:
        """The image of a field's numbers [..., item, component], zeros without a sign."""
        return mirrored(layout.field, values, self.axes)

    def point(self, positions: NDArray[Any]) -> NDArray[Any]:
        """The images of points [..., xyz] [m]."""
        return mirrored("position", positions, self.axes)


def _image(axes: str) -> str:
    return "half-turn image" if axes == "xy" else "mirror image"


def can_mirror(field: str) -> bool:
    """Whether a state field has an image that is known here; joints have none."""
    return field in (*_POLAR, *_AXIAL)


def mirrored(field: str, values: NDArray[Any], axes: str) -> NDArray[Any]:
    """The image of a state field's numbers [..., component], orientations wxyz, exact, zeros without a sign.

    axes  of schemas.initial.AXES
    """
    signs = np.array([-1.0 if axis in axes else 1.0 for axis in "xyz"])
    if field in _AXIAL:
        signs = signs * signs.prod()
    if field == "orientation":
        signs = np.concatenate([[1.0], signs])
    return np.asarray(values * signs.astype(values.dtype) + values.dtype.type(0.0))


def why_unlike_its_image(scene: Mapping[str, Any], axes: str) -> str:
    """Why a scene, described as in scene.json, is not its own image; empty where it is.

    Its fixed bodies must be those of the image, to the last bit, in any order: each its own image, or that of another.
    Of moving bodies only the shape matters, for their states are mirrored or turned with them.
    """
    for part, words in (("files_sha256", "a model file"), ("robot", "a robot"), ("actions", "actions")):
        if scene.get(part):
            return f"it has {words}, whose {_image(axes)} is not known"
    try:
        gravity = np.array(scene["gravity"], dtype=np.float64)
        bodies = [(str(body["name"]), str(body["shape"]["kind"]), body) for body in scene["bodies"]]
        fixed = [(name, _pose(body), body) for name, _, body in bodies if body.get("mass") is None]
        if odd := next((name for name, shape, _ in bodies if shape not in _SHAPES), ""):
            return f"the {_image(axes)} of the shape of '{odd}' is not known"
        if not np.array_equal(mirrored("position", gravity, axes), gravity):
            return "gravity is not along z"
        left = list(fixed)
        for name, (position, orientation), body in fixed:
            image = mirrored("position", position, axes), mirrored("orientation", orientation, axes)
            found = next((at for at, one in enumerate(left) if _same(image, body, one[1], one[2])), None)
            if found is None:
                return f"no fixed body is the {_image(axes)} of '{name}'"
            left.pop(found)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return "its description cannot be read"
    return ""


def _pose(body: Mapping[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    position, orientation = (np.array(body[name], dtype=np.float64) for name in ("position", "orientation"))
    if position.shape != (3,) or orientation.shape != (4,):
        raise ValueError(position.shape, orientation.shape)
    return position, orientation


def _same(
    image: tuple[NDArray[np.float64], NDArray[np.float64]], body: Mapping[str, Any],
    pose: tuple[NDArray[np.float64], NDArray[np.float64]], other: Mapping[str, Any],
) -> bool:  # fmt: skip
    # a quaternion and its opposite are one rotation
    turned = np.array_equal(image[1], pose[1]) or np.array_equal(-image[1], pose[1])
    made = all(body[part] == other[part] for part in ("shape", "material"))
    return np.array_equal(image[0], pose[0]) and turned and made


_OF_THE_STATE = {
    "name", "position", "orientation", "linear_velocity", "angular_velocity", "launch", "spin", "turned",
}  # fmt: skip


@dataclass(frozen=True)
class Relabelling:
    """An exchange of states between identical bodies; see Symmetry.

    partners  by group, of each body that has another one's state: the name of that body
    why_not   why there are no such bodies; empty where there are
    """

    partners: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    why_not: str = ""

    words = "exchanged between identical bodies, in reverse order"

    @classmethod
    def of(cls, scene: Mapping[str, Any], vary: str = "") -> Relabelling:
        """The exchange of a scene, described as in scene.json.

        vary  parameters that differ between bodies, as of a RunConfiguration: then none are identical
        """
        if vary:
            return cls(why_not="has no identical bodies: each has parameters of its own (--vary)")
        if scene.get("files_sha256"):
            return cls(why_not="has no bodies that are known to be identical: they are those of a model file")
        try:
            moving = [body for body in scene["bodies"] if body.get("mass") is not None]
            alike = gathered((_kind(body), str(body["name"])) for body in moving)
        except (AttributeError, KeyError, TypeError, ValueError):
            return cls(why_not="has a description that cannot be read")
        partners: dict[str, dict[str, str]] = {}
        for (group, _), names in alike.items():
            exchanged = zip(names, reversed(names), strict=True)
            partners.setdefault(group, {}).update((one, other) for one, other in exchanged if one != other)
        if not any(partners.values()):
            return cls(why_not="has no two identical bodies that move")
        return cls({group: others for group, others in partners.items() if others})

    def why_unknown(self, layout: StateField) -> str:
        """Why a field has no known image: bodies that it lacks."""
        partners = self.partners.get(layout.group, {})
        missing = next((name for name in partners if name not in layout.items), "")
        return f"{layout.name} has no body '{missing}'" if missing else ""

    def image(self, layout: StateField, values: NDArray[Any]) -> NDArray[Any]:
        """The numbers [..., item, component] of a field, each item with those of its partner."""
        partners = self.partners.get(layout.group, {})
        at = {name: index for index, name in enumerate(layout.items)}
        return np.asarray(values[..., [at[partners.get(name, name)] for name in layout.items], :])

    def point(self, positions: NDArray[Any]) -> NDArray[Any]:
        """The points [..., xyz] themselves [m]."""
        return positions


def _kind(body: Mapping[str, Any]) -> tuple[str, str]:
    # group, and all that identical bodies have in common
    common = {name: value for name, value in body.items() if name not in _OF_THE_STATE}
    return str(body["group"]), json.dumps(common, sort_keys=True)


class Symmetry(Protocol):
    """What a state is turned into.

    why_not  why a scene is not the same after it, as what follows "the scene"; empty where it is
    words    what is done to initial states
    """

    @property
    def why_not(self) -> str: ...
    @property
    def words(self) -> str: ...

    def why_unknown(self, layout: StateField) -> str:
        """Why a field has no known image; empty where it has."""

    def image(self, layout: StateField, values: NDArray[Any]) -> NDArray[Any]:
        """The image of a field's numbers [..., item, component], exact: that of the image is the field again, but for
        the signs of zeros where the symmetry changes signs."""

    def point(self, positions: NDArray[Any]) -> NDArray[Any]:
        """The images of points of space [..., xyz], relative to the origin of their environment [m]."""


def symmetry_of(initial: Initial, scene: Mapping[str, Any], vary: str = "") -> Symmetry | None:
    """The symmetry by which a run's initial states are images of the usual ones; None where they are not.

    scene  described as in scene.json
    vary   parameters that differ between bodies, as of a RunConfiguration
    """
    if initial.mirror:
        return Mirror.of(scene, initial.mirror)
    return Relabelling.of(scene, vary) if initial.relabel else None
