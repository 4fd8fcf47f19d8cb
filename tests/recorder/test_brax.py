"""Brax in particular, on the CPU; what every simulator must do is in the conformance suite."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.inclined_collision import inclined_collision
from gpusimbench.recorder.simulators.brax.simulator import SOLVERS
from gpusimbench.schemas.errors import UsageError
from tests.recorder import engines
from tests.recorder.engines import PAIR, bits

engines.needed("brax")

make = partial(engines.make, "brax")
build = partial(engines.build, "brax")


def falling_ball(height: float) -> Scene:
    """The steel ball above the board, its lowest point at `height` [m] over it."""
    scene = inclined_collision()
    board = next(body for body in scene.bodies if body.name == "board")
    ball = next(body for body in scene.bodies if body.name == "ball")
    centre = (board.position[0], board.position[1], 0.02 + ball.shape.radius + height)  # type: ignore[union-attr]
    return replace(scene, bodies=(board, replace(ball, position=centre)))


@pytest.mark.parametrize("options", [{"solver": "xpbd"}, {"collide_scale": 0}, {"solver_maxls": 0}])
def test_options_that_there_are_not(options: dict[str, Any]) -> None:
    """Refuse values that Brax has no meaning for."""
    with pytest.raises(UsageError, match=next(iter(options))):
        make(PAIR, **options)


def test_materials_as_brax_takes_them() -> None:
    """Give each shape its restitution, say what becomes of both frictions, record the options in force."""
    simulator, description = build(PAIR, solver="spring", baumgarte_erp=0.2)
    assert description.options["baumgarte_erp"] == 0.2
    assert description.options["solver"] == "spring"
    # by this, gsb-eval tells recordings whose timed steps searched for collisions once
    assert "from the contacts that the step found" in description.timing_covers
    said = {deviation.parameter: deviation.used for deviation in description.deviations}
    assert said["contact.friction_combination"] == "the larger coefficient of the two"
    assert said["contact.restitution_combination"] == "the mean of the two coefficients"
    materials = [body.material for body in PAIR.bodies]
    assert {f"{material.name}.static_friction" for material in materials} <= set(said)
    text = description.attachments["scene.xml"][1].decode()
    elasticity = text.split('name="elasticity" data="')[1].split('"')[0]
    assert elasticity.split() == [repr(material.restitution) for material in materials]
    simulator.close()


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["positional", "spring"])
def test_a_ball_bounces(solver: str) -> None:
    """Leave the board with the mean of the two restitutions times the speed of the impact, within 15 %."""
    scene = falling_ball(0.1)
    simulator, description = build(scene, n_env=1, solver=solver)
    names = [f.name for f in description.fields]
    velocity = simulator.states(25)[names.index("ball/linear_velocity")][:, 0, 0, 2]
    mean = sum(body.material.restitution for body in scene.bodies) / 2
    assert velocity.max() / -velocity.min() == pytest.approx(mean, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_step_searches_for_collisions_once(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Count contacts in the search of the step itself, timed and captured: a second search costs as much as a step."""
    from brax import contact

    simulator, _ = build(PAIR, n_env=1, solver=solver)
    searches = []
    search = contact.get
    monkeypatch.setattr(contact, "get", lambda system, x: searches.append(x) or search(system, x))
    for program in ("advance", "record"):
        searches.clear()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MJX warns that Brax reads names that have moved
            simulator._lowered(program)
        assert len(searches) == 1, program


@pytest.mark.slow
@pytest.mark.parametrize(("limits", "expected"), [({"max_geom_pairs": 2}, 0b01), ({"max_contact_points": 4}, 0b10)])
def test_limits_that_may_have_dropped_something(limits: dict[str, int], expected: int) -> None:
    """Set the bit of the limit of MJX's collision code that was reached at some step."""
    simulator, _ = build(PAIR, n_env=1, solver="spring", **limits)
    simulator.states(8)
    assert bits(simulator) == expected
