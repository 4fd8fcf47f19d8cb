"""Scenes by name."""

from __future__ import annotations

from collections.abc import Callable

from recorder.scenes.base import Scene
from recorder.scenes.franka import franka
from recorder.scenes.free_fall import free_fall
from recorder.scenes.inclined_collision import inclined_collision
from schemas.errors import UsageError

SCENES: dict[str, Callable[[], Scene]] = {
    "inclined-collision": inclined_collision,
    "free-fall": free_fall,
    "franka": franka,
}


def make_scene(name: str) -> Scene:
    """The scene of that name; UsageError names the known ones."""
    try:
        return SCENES[name]()
    except KeyError:
        raise UsageError(f"there is no scene '{name}'; known scenes: {', '.join(SCENES)}") from None
