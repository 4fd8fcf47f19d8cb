"""Symmetries of scenes: changes of the state after which the same physics must go on alike.

A run begins in images of the usual initial states (schemas.initial), and the images of what follows are compared with
the usual run. A symmetry is its own inverse.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import NDArray

from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.initial import Initial
from gpusimbench.schemas.mirror import Mirror
from gpusimbench.schemas.relabel import Relabelling


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
