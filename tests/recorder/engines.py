"""Simulators of one engine on the CPU, and scenes as small as a question allows."""

from __future__ import annotations

from dataclasses import fields, replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.inclined_collision import inclined_collision
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.registry import find_simulator, is_there


class Later:
    """A module that is imported when a test asks for something of it.

    Every process of the tests reads every file of tests. An engine takes seconds to import, and JAX minds the forks
    that follow.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # pytest asks whatever a file of tests names whether it is a fixture
            raise AttributeError(name)
        return getattr(import_module(self._name), name)


def needed(name: str) -> Any:
    """The module of that name, Later; the tests of the calling file are skipped where it is not installed."""
    if not is_there(name):
        pytest.skip(f"{name} is not installed", allow_module_level=True)
    return Later(name)


def make(
    name: str, scene: Scene, *, n_env: int = 2, seed: int = 0, determinism: str = "default", **options: Any
) -> Simulator:
    """A simulator that is not built yet; the test is skipped where its engine is not installed."""
    entry = find_simulator(name)
    if entry.missing():
        pytest.skip(f"{name} is not installed")
    adapter = entry.load()
    cpu = {"device": "cpu"} if any(option.name == "device" for option in fields(adapter.Options)) else {}
    parsed = adapter.parsed(name, scene, {**cpu, **{k: str(v) for k, v in options.items()}})
    return adapter(scene, n_env=n_env, dt=scene.dt, seed=seed, options=parsed, determinism=determinism)


def build(name: str, scene: Scene, **options: Any) -> tuple[Simulator, Description]:
    """A built simulator, and what it says of itself."""
    simulator = make(name, scene, **options)
    return simulator, simulator.build()


def cubes(*names: str) -> Scene:
    """Some cubes of the stack on the board."""
    scene = inclined_collision()
    return replace(scene, bodies=tuple(body for body in scene.bodies if body.name in ("board", *names)))


PAIR = cubes("cube_0_0_0", "cube_0_0_1")
"""Two cubes, one on the other: eight contacts at rest, three pairs of boxes."""


def field(description: Description, states: States, name: str) -> NDArray[Any]:
    """One field of a state by "group/field"."""
    return np.asarray(states[[f.name for f in description.fields].index(name)])


def counts(simulator: Simulator, name: str) -> list[list[int]]:
    """What the simulator counts, [row][env]."""
    evidence = simulator.evidence()
    return evidence.counts[name].tolist()


def bits(simulator: Simulator) -> int:
    """All overflow bits of all rows and environments."""
    evidence = simulator.evidence()
    assert evidence.overflow is not None
    return int(np.bitwise_or.reduce(evidence.overflow, axis=None))
