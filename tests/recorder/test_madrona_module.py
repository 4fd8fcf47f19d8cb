"""The example of a Madrona module: its sources keep the contract, and so does a build, where one is at hand.

GSB_MADRONA_MODULE names the build, and PYTHONPATH leads to it; the project has no Madrona.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Material, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.madrona.module import METHODS, REQUIRED_SETTINGS, VARIABLE, MadronaOptions
from gpusimbench.recorder.simulators.madrona.simulator import Madrona
from tests.conftest import run_python

SOURCES = Path(__file__).resolve().parents[2] / "examples" / "madrona_module"
NAME = os.environ.get(VARIABLE, "")
WOOD = Material("wood", static_friction=0.5, kinetic_friction=0.5, restitution=0.3)

built = pytest.mark.skipif(not NAME or find_spec(NAME) is None, reason=f"{VARIABLE} names no module that is built")


def source(name: str) -> str:
    """A file of the example."""
    return (SOURCES / name).read_text(encoding="utf-8")


def test_the_sources_offer_what_the_contract_asks() -> None:
    """Bind every method, argument and setting by the name that the adapter uses."""
    module = source("module.cpp")
    assert {name for name in METHODS if f'.def("{name}"' not in module} == set()
    assert {name for name in REQUIRED_SETTINGS if f'found["{name}"]' not in module} == set()
    arguments = re.findall(r'nb::arg\("(\w+)"\)', module)
    assert arguments == [
        "exec_mode", "gpu_id", "num_worlds", "rand_seed", "auto_reset", "scene", "delta_t", "num_substeps",
    ]  # fmt: skip


def test_the_sources_read_what_a_scene_has() -> None:
    """Read each value of a body by the key that it has in the scene's JSON; a key that was renamed is found here."""
    body = next(b for b in json.loads(make_scene("free-fall").to_json())["bodies"] if "mass" in b)
    for key in set(body) - {"group"}:
        assert f'["{key}"]' in source("module.cpp"), f"module.cpp does not read {key}"
    for key in ("static_friction", "kinetic_friction"):
        assert f'material["{key}"]' in source("module.cpp")


def test_nothing_of_madronas_is_shipped() -> None:
    """Have sources of this project alone, and no script that builds them."""
    assert sorted(path.name for path in SOURCES.iterdir()) == [
        "README.md", "module.cpp", "scene.hpp", "simulation.cpp", "simulation.hpp", "worlds.cpp", "worlds.hpp",
    ]  # fmt: skip
    for path in SOURCES.iterdir():
        assert "Shacklett" not in path.read_text(encoding="utf-8")


def scene_of(*bodies: Body) -> Scene:
    """A scene of bodies on a plane."""
    ground = Body("ground", Plane(), WOOD, position=(0.0, 0.0, 0.0))
    return replace(make_scene("free-fall"), bodies=(ground, *bodies))


def thing(name: str, shape: Any, **others: Any) -> Body:
    """A body above the ground."""
    given = {"position": (0.0, 0.0, 1.0), "mass": 0.1, "group": "things", **others}
    return Body(name, shape, WOOD, **given)


def made(scene: Scene, n_env: int = 2, **options: Any) -> Madrona:
    """An adapter on the module that is built, not built itself."""
    given = MadronaOptions(module=NAME, **options)
    return Madrona(scene, n_env=n_env, dt=0.01, seed=0, options=given)


@built
@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ((thing("pill", Capsule(0.1, 0.2)),), "body 'pill' is a capsule; Madrona has boxes, spheres and planes"),
        ((thing("one", Sphere(0.1)), thing("two", Sphere(0.1))), "'one' and 'two' are spheres, which attract"),
        (
            (thing("fixed", Sphere(0.1), mass=None, group=""), thing("two", Sphere(0.1), position=(1.0, 0.0, 1.0))),
            "'fixed' and 'two' are spheres",
        ),
        (
            (thing("two", Sphere(0.1)), thing("fixed", Sphere(0.1), mass=None, group="")),
            "'two' and 'fixed' are spheres",
        ),
        ((thing("shelf", Box((0.1, 0.1, 0.1)), mass=None, group=""),), "no body of the scene moves"),
    ],
    ids=lambda x: x[0].name if isinstance(x, tuple) else "",
)
def test_what_madrona_cannot_do_is_refused_by_name(bodies: tuple[Body, ...], message: str) -> None:
    """Name the body and the reason."""
    with pytest.raises(Refused, match=message):
        made(scene_of(*bodies)).build()


@built
def test_boxes_and_a_sphere_fall() -> None:
    """Begin as the scene says, fall by gravity, and say what differs from the scene."""
    simulator = made(scene_of(thing("box", Box((0.1, 0.2, 0.3))), thing("ball", Sphere(0.1), position=(1.0, 0, 1.0))))
    try:
        description = simulator.build()
        speed = simulator.states(10)[2][-1]
    finally:
        simulator.close()
    assert np.allclose(speed, (0.0, 0.0, -0.981), atol=2e-3)
    told = {deviation.parameter for deviation in description.deviations}
    assert told == {
        "contact.friction_combination", "contact.kinetic_friction", "contact.points", "contact.restitution",
    }  # fmt: skip
    assert description.options["num_substeps"] == 4
    assert description.options["restitution_threshold"] == pytest.approx(2 * 9.81 * 0.01 / 4)


@built
def test_one_manager_at_a_time() -> None:
    """Refuse a second one while the first lives, and make it afterwards."""
    first, second = made(make_scene("free-fall")), made(make_scene("free-fall"))
    first.build()
    with pytest.raises(RuntimeError, match="there is a SimManager in this process already"):
        second.build()
    first.close()
    second.build()
    second.close()


@built
def test_nothing_is_printed_on_standard_output() -> None:
    """Leave standard output to results."""
    code = (
        "from tests.recorder.test_madrona_module import made, make_scene\n"
        "simulator = made(make_scene('free-fall'))\n"
        "simulator.build()\n"
        "simulator.step(3)\n"
    )
    root = Path(__file__).parents[2]
    assert run_python(code, cwd=root, env=dict(os.environ)).stdout == ""
