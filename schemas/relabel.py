"""Identical bodies that exchange their states.

Physics does not know names: a state in which identical bodies have exchanged their states goes on as the exchanged one.
An engine that goes through bodies, contacts or constraints by their numbers adds up the same numbers in another order.

Bodies of a group are identical if their descriptions differ only in the name, the initial state and what is drawn for
it. Of n identical bodies, the k-th gets the state of the (n + 1 - k)-th. This reversal exchanges the order of every two
bodies, whereas a cyclic shift keeps that of nearly all neighbours; and it is its own inverse.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.gathering import gathered

_OF_THE_STATE = {
    "name", "position", "orientation", "linear_velocity", "angular_velocity", "launch", "spin", "turned",
}  # fmt: skip


@dataclass(frozen=True)
class Relabelling:
    """An exchange of states between identical bodies; see schemas.symmetry.Symmetry.

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
