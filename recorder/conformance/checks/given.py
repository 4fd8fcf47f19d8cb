"""What environments are given arrives in the engine: parameters that differ between them, held against scenes that are
written with these; and actions, as they were drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import VARIED, listed, titles
from gpusimbench.recorder.conformance.checks.agreement import differences, expect_repeatable
from gpusimbench.recorder.conformance.scene import DT, N_STEP, G
from gpusimbench.recorder.conformance.subject import SEED, Subject
from gpusimbench.recorder.conformance.trajectory import drift, local
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect, fail
from gpusimbench.recorder.run import vary
from gpusimbench.recorder.scenes.base import Body, Box, Material, Scene, Sphere
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.schemas.action_generator import Streams

_ENVS = 2
_SPREADS = {"mass": 0.5, "friction": 0.5, "size": 0.05}

_TOLERANCE_M = 1e-4
"""What compiled code may add where a parameter is an array instead of a constant: far less than other parameters do."""

_ICE = Material("ice", static_friction=0.05, kinetic_friction=0.05, restitution=0.0)
_WOOD = Material("wood", static_friction=0.3, kinetic_friction=0.3, restitution=0.0)


def varied_scene() -> Scene:
    """A box that slides to rest on ice, which depends on its friction; two balls that meet in the air, on their masses;
    a ball that falls on the ice, on its size."""
    speed, gap = 1.0, 0.003  # of the fliers [m/s]; so that a larger body does not begin in the ice [m]
    fliers = ((-0.05, speed, "left"), (0.05, -speed, "right"))
    return Scene(
        name="varied",
        summary="a sliding box, two balls that meet and one that falls",
        gravity=(0.0, 0.0, -G),
        dt=DT,
        sample_time=N_STEP * DT,
        bodies=(
            Body("ice", Box((2.0, 1.0, 0.1)), _ICE, position=(0.0, 0.0, -0.05)),
            Body(
                "slider",
                Box((0.06, 0.06, 0.02)),
                _WOOD,
                mass=0.1,
                group="boxes",
                position=(0.0, 0.3, 0.01 + gap),
                linear_velocity=(speed, 0.0, 0.0),
            ),
            *(
                Body(
                    name,
                    Sphere(0.02),
                    _WOOD,
                    mass=0.1,
                    group="balls",
                    position=(x, 0.0, 2.0),
                    linear_velocity=(velocity, 0.0, 0.0),
                )
                for x, velocity, name in fliers
            ),
            Body("stone", Sphere(0.05), _WOOD, mass=0.1, group="balls", position=(0.0, -0.3, 0.05 + gap)),
        ),
    )


def varied_envs_are_those_of_their_scenes(subject: Subject) -> None:
    """Move an environment with parameters of its own as one of a scene that is written with them: to the bit, or, where
    compiled code rounds a varied parameter otherwise than a constant, within a tenth of a millimetre."""
    offered = subject.adapter.offered(subject.options) - subject.adapter.withheld(subject.options).keys()
    spreads = [f"{name}:{_SPREADS[name]}" for name, ability in VARIED.items() if ability in offered]
    if not spreads:
        raise NotApplicable(f"with these options the adapter has no {listed(titles(VARIED.values()))}")
    scene = varied_scene()
    variation = vary.variation(",".join(spreads), scene, n_env=_ENVS, seed=SEED)
    assert variation is not None
    description, varied = _captured(subject, scene, variation)
    tolerance = _TOLERANCE_M + drift(description, _ENVS, N_STEP)
    for env in range(_ENVS):
        _, alone = _captured(subject, variation.of(scene, env), None)
        own, as_written = (tuple(np.ascontiguousarray(a[:, [env]]) for a in states) for states in (varied, alone))
        if differences(description, own, as_written):
            body, apart = _farthest(description, own, as_written)
            if not apart <= tolerance[env]:
                expect_repeatable(subject)
                fail(
                    f"'{body}' of environment {env}, which has parameters of its own, is {apart:.2g} m from where it "
                    "is in a scene that is written with them"
                )
    body, apart = _farthest(description, *(tuple(a[:, [env]] for a in varied) for env in range(_ENVS)))
    if not apart > tolerance.max():
        fail(f"environments whose parameters differ move alike, '{body}' within {apart:.2g} m")


def _captured(subject: Subject, scene: Scene, variation: Variation | None) -> tuple[Description, States]:
    # positions relative to the origins of their environments
    with subject.built(scene, n_env=_ENVS, variation=variation) as (simulator, description):
        simulator.compile("capture")
        simulator.prepare(None)
        states = (np.array(array) for array in simulator.states(N_STEP))
        return description, tuple(
            local(description, layout, array) if layout.field == "position" else array
            for layout, array in zip(description.fields, states, strict=True)
        )


def _farthest(description: Description, one: States, other: States) -> tuple[str, float]:
    """The body whose positions [step, env, item, 3] are farthest apart, and how far [m]; not a number is farthest."""
    found: list[tuple[float, str]] = []
    for layout, a, b in zip(description.fields, one, other, strict=True):
        if layout.field == "position":
            apart: NDArray[np.float64] = np.linalg.norm(a.astype(np.float64) - b.astype(np.float64), axis=-1)
            most = np.nan_to_num(apart, nan=np.inf).max(axis=(0, 1))
            found += zip(most.tolist(), layout.items, strict=True)
    apart_by, body = max(found)
    return body, apart_by


_BLOCKS = (3, 2)
_OTHERS = Streams(np.array([1, 0], dtype=np.uint32), np.array([0, _BLOCKS[0]], dtype=np.uint32))


def actions_are_those_drawn(subject: Subject) -> None:
    """applied gives the joint targets of the last step, bit for bit, also where environments are given the actions of
    others, which begin anew; and each environment's arm moves its own way."""
    scene = next((scene for scene in subject.scenes if scene.actions is not None), None)
    if scene is None or scene.actions is None:
        raise NotApplicable("the adapter has not the abilities that any built-in scene with actions needs")
    targets = scene.actions
    with subject.built(scene, n_env=_ENVS) as (simulator, description):
        before = tuple(np.array(array) for array in simulator.state())
        simulator.compile("timed")
        done = 0
        for count, streams in zip(_BLOCKS, (simulator.streams, _OTHERS), strict=True):
            simulator.streams = streams
            drawn = targets.draw(SEED, n_env=_ENVS, first_step=done, n_step=count, streams=streams)
            simulator.prepare(None if simulator.draws_actions else drawn)
            simulator.step(count)
            done += count
            applied = simulator.applied()
            if applied is not None:
                expect(applied.shape == drawn[-1].shape, f"applied() is {applied.shape}, not {drawn[-1].shape}")
                expect(
                    np.array_equal(applied, drawn[-1]),
                    f"applied() after step {done - 1} differs from the targets drawn, by "
                    f"{np.abs(applied - drawn[-1]).max():.3g} rad",
                )
        after = tuple(np.array(array) for array in simulator.state())
    for layout, was, now in zip(description.fields, before, after, strict=True):
        expect(bool(np.isfinite(now).all()), f"{layout.name} is not finite after {done} steps")
        if layout.field == "qpos":
            expect(bool((now != was).any(axis=(1, 2)).all()), f"the arm has not moved after {done} steps")
            expect(not np.array_equal(now[0], now[1]), "two environments with different targets moved alike")
    if applied is None:
        raise NotApplicable("the engine cannot tell which actions it holds: applied() is None")
