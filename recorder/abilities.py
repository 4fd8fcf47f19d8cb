"""The vocabulary between scenes and engines: a scene says what it needs, an engine what it can do.

Neither names the other (``Scene.needs``, ``Simulator.abilities``), and both are read without importing an engine.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum


class Ability(Enum):
    """What a scene may need of an engine. An engine takes a scene where it has all abilities that the scene needs, with
    the options that were given, and says in its deviations what it does otherwise than the scene.

    title    in the plural, as it stands in sentences and lists
    meaning  one line
    """

    FREE_BODIES = "free bodies", "rigid bodies of one shape each, which nothing holds"
    BOXES = "boxes", "bodies that are boxes, free or fixed"
    SPHERES = "spheres", "bodies that are spheres, free or fixed"
    CAPSULES = "capsules", "bodies that are capsules, free or fixed"
    PLANES = "planes", "level planes, which are fixed"
    TILTED_PLANES = "tilted planes", "planes that are not level"
    MESHES = "meshes", "shapes made of triangles"
    FIXED_BASE = "fixed-base robots", "a tree of links whose base is part of the world"
    FLOATING_BASE = "floating-base robots", "a tree of links whose base moves freely"
    CHAINS = "robots of several chains", "a tree of links that branches, with joints behind each other in the branches"
    LOOPS = "closed loops", "a pin between two links of a robot, which closes a loop"
    ROBOT_AMONG_BODIES = "robots among free bodies", "a robot and free bodies in one environment"
    HINGES = "hinge joints", "joints that turn about an axis"
    SLIDES = "slide joints", "joints that move along an axis"
    BALLS = "ball joints", "joints that turn about a point"
    ACTIONS = "actions", "a target for the position servo of every joint, at every step"
    MODELS = "model files", "MJCF files of the user's own, with all that is in them"
    ENV_STARTS = "initial states per environment", "environments that do not all begin alike"

    VARIED_MASS = "masses per environment", "bodies and links whose masses differ from environment to environment"
    VARIED_FRICTION = "frictions per environment", "surfaces whose friction differs from environment to environment"
    VARIED_SIZE = "sizes per environment", "free bodies whose sizes differ from environment to environment"

    def __init__(self, title: str, meaning: str) -> None:
        self.title = title
        self.meaning = meaning


BODIES = frozenset(
    {Ability.FREE_BODIES, Ability.BOXES, Ability.SPHERES, Ability.CAPSULES, Ability.PLANES, Ability.TILTED_PLANES}
)
"""Free bodies, and bodies of every shape that is not a mesh."""

ROBOTS = frozenset({Ability.FIXED_BASE, Ability.ROBOT_AMONG_BODIES, Ability.HINGES, Ability.ACTIONS})
"""Robots on fixed bases, driven by actions, alone or among free bodies."""


VARIED = {"mass": Ability.VARIED_MASS, "friction": Ability.VARIED_FRICTION, "size": Ability.VARIED_SIZE}
"""What each of schemas.treatment.QUANTITIES needs to differ from environment to environment."""


def titles(abilities: Iterable[Ability]) -> list[str]:
    """Titles in the order of the vocabulary."""
    wanted = set(abilities)
    return [ability.title for ability in Ability if ability in wanted]


def listed(words: Sequence[str]) -> str:
    """Words as a sentence has them behind "no": "a, b or c"."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))
