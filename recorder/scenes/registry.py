"""Scenes by name, loaded only when asked for.

A distribution adds its own through the entry-point group ``gsb.scenes``: the entry's name is what users say, its object
is a callable without arguments that returns the Scene of that name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from importlib import metadata

from gpusimbench.recorder.plugins import in_words
from gpusimbench.recorder.scenes.ball_drop import ball_drop
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.cube_toss import cube_toss
from gpusimbench.recorder.scenes.dice_drop import dice_drop
from gpusimbench.recorder.scenes.double_pendulum import double_pendulum
from gpusimbench.recorder.scenes.four_bar import four_bar
from gpusimbench.recorder.scenes.franka import franka
from gpusimbench.recorder.scenes.free_body import free_body
from gpusimbench.recorder.scenes.free_fall import free_fall
from gpusimbench.recorder.scenes.inclined_collision import inclined_collision
from gpusimbench.recorder.scenes.pendulum import pendulum
from gpusimbench.recorder.scenes.sliding_block import sliding_block
from gpusimbench.schemas.commands.suggestion import did_you_mean
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.treatment import CONTROLS

ENTRY_POINTS = "gsb.scenes"

SCENES: dict[str, Callable[[], Scene]] = {
    "inclined-collision": inclined_collision,
    "free-fall": free_fall,
    "franka": franka,
    "cube-toss": cube_toss,
    "pendulum": pendulum,
    "sliding-block": sliding_block,
    "free-body": free_body,
    "ball-drop": ball_drop,
    "double-pendulum": double_pendulum,
    "dice-drop": dice_drop,
    "four-bar": four_bar,
}
"""The built-in ones."""


def scene_names() -> tuple[str, ...]:
    """All scenes: the built-in ones, and those that installed distributions add."""
    return tuple(dict.fromkeys([*SCENES, *sorted(_added())]))


def make_scene(name: str) -> Scene:
    """The scene of that name; UsageError names the known ones, or says why one that was added cannot be made."""
    if name in SCENES:
        return SCENES[name]()
    point = _added().get(name)
    if point is None:
        names = scene_names()
        raise UsageError(f"there is no scene '{name}'; known scenes: {', '.join(names)}{did_you_mean(name, names)}")
    owner = point.dist.name if point.dist else "an installed distribution"
    try:
        scene = point.load()()
    except Exception as error:  # whatever a third party's code raises
        raise UsageError(f"scene '{name}' of {owner} cannot be made: {in_words(error)}") from None
    if not isinstance(scene, Scene) or scene.name != name:
        made = f"a Scene named '{scene.name}'" if isinstance(scene, Scene) else f"a {type(scene).__name__}"
        raise UsageError(f"scene '{name}' of {owner} has to be a Scene of that name, and is {made}")
    return scene


def scene_of(configuration: RunConfiguration, inputs: Mapping[str, bytes]) -> Scene:
    """The scene that a run was asked for: a registered one, or the model whose files it is given.

    UsageError as of make_scene and model_scene, and where the files are not those that the configuration names.
    """
    if not configuration.model:
        return make_scene(configuration.scene).with_options(configuration.options)
    from gpusimbench.recorder.scenes.model.scene import model_scene
    from gpusimbench.schemas.model_files import MODEL

    archive = inputs.get(MODEL, b"")
    if hashlib.sha256(archive).hexdigest() != configuration.model:
        raise UsageError("the model's files are not there, or are not those that the configuration names")
    c, file = configuration, inputs.get(CONTROLS)
    return model_scene(c.scene, archive, keyframe=c.keyframe, actions=c.actions, file=file)


def _added() -> dict[str, metadata.EntryPoint]:
    return {point.name: point for point in metadata.entry_points(group=ENTRY_POINTS)}
