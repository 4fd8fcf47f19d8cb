"""Scenes by name, loaded only when asked for.

A distribution adds its own through the entry-point group ``gsb.scenes``: the entry's name is what users say, its object
is a callable without arguments that returns the Scene of that name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib import import_module, metadata

from gpusimbench.recorder.failure import in_words
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.treatment import CONTROLS

ENTRY_POINTS = "gsb.scenes"

SCENES = (
    "inclined-collision",
    "free-fall",
    "franka",
    "cube-toss",
    "pendulum",
    "sliding-block",
    "free-body",
    "ball-drop",
    "double-pendulum",
    "dice-drop",
    "four-bar",
)
"""The built-in ones. "four-bar" is what the function `four_bar` of the module `four_bar` in this folder returns."""


def scene_names() -> tuple[str, ...]:
    """All scenes: the built-in ones, and those that installed distributions add."""
    return tuple(dict.fromkeys([*SCENES, *sorted(_added())]))


def make_scene(name: str) -> Scene:
    """The scene of that name; UsageError names the known ones, or says why one that was added cannot be made."""
    if name in SCENES:
        module = name.replace("-", "_")
        built_in: Scene = getattr(import_module(f"gpusimbench.recorder.scenes.{module}"), module)()
        return built_in
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
    from gpusimbench.recorder.scenes.model import model_scene
    from gpusimbench.schemas.model_files import MODEL

    archive = inputs.get(MODEL, b"")
    if hashlib.sha256(archive).hexdigest() != configuration.model:
        raise UsageError("the model's files are not there, or are not those that the configuration names")
    c, file = configuration, inputs.get(CONTROLS)
    return model_scene(c.scene, archive, keyframe=c.keyframe, actions=c.actions, file=file)


def _added() -> dict[str, metadata.EntryPoint]:
    return {point.name: point for point in metadata.entry_points(group=ENTRY_POINTS)}
