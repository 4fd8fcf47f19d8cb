"""The state that a simulator begins with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.checks.description import expect_layout
from gpusimbench.recorder.conformance.frames import expect_origins, local, rounding
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect, expect_close, fail
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField

_TOLERANCE = 2e-6  # absolute and relative: a few roundings of float32
_ENVS = 2


def first_state_is_the_scenes(subject: Subject) -> None:
    """Positions, orientations (wxyz) and velocities after build are those of the conformance scene."""
    trajectory = subject.trajectory
    _expect_first_state(trajectory.scene, trajectory.description, trajectory.described)


def envs_start_alike(subject: Subject) -> None:
    """All environments begin with the same bits, but for positions where they have origins of their own."""
    trajectory = subject.trajectory
    apart = bool(np.any(trajectory.rounding))
    for layout, array in zip(trajectory.description.fields, trajectory.described, strict=True):
        if apart and layout.field == "position":
            continue  # rounded differently at each origin; held to the scene by first_state_is_the_scenes
        for env in range(1, trajectory.n_env):
            expect(
                array[env].tobytes() == array[0].tobytes(),
                f"{layout.name} of envs {env} and 0 starts differently, by {np.abs(array[env] - array[0]).max():.2g}",
            )


def compile_moves_nothing(subject: Subject) -> None:
    """compile leaves the state as build made it, bit for bit."""
    trajectory = subject.trajectory
    for layout, before, after in zip(
        trajectory.description.fields, trajectory.described, trajectory.compiled, strict=True
    ):
        expect(
            before.tobytes() == after.tobytes(), f"compile changes {layout.name}, by {np.abs(after - before).max():.2g}"
        )


def registered_scenes_start_as_described(subject: Subject) -> None:
    """Every built-in scene within the adapter's abilities builds, with the layout and first state that it describes."""
    if not subject.scenes:
        raise NotApplicable("the adapter has not the abilities that any built-in scene needs")
    for scene in subject.scenes:
        try:
            with subject.built(scene, n_env=_ENVS) as (simulator, description):
                state = tuple(np.array(array) for array in simulator.state())
            expect_layout(subject, scene, description, state, _ENVS)
            _expect_first_state(scene, description, state)
        except UsageError as error:
            fail(f"the adapter declares all abilities that scene {scene.name} needs, and refuses it: {error}")
        except AssertionError as error:
            raise AssertionError(f"scene {scene.name}: {error}") from None


def _expect_first_state(scene: Scene, description: Description, state: States) -> None:
    displaced = {
        item: local(description, layout, array)[:, index].astype(np.float64) - _described(scene, layout)[index]
        for layout, array in zip(description.fields, state, strict=True)
        if layout.field == "position"
        for index, item in enumerate(layout.items)
    }
    if displaced:
        expect_origins(description, displaced)
    for layout, array in zip(description.fields, state, strict=True):
        expected = _described(scene, layout)
        found, tolerance = array[None], np.array(_TOLERANCE)  # one step
        if layout.field == "position":
            found, tolerance = (
                local(description, layout, found),
                _TOLERANCE + rounding(description, len(array))[:, None],
            )
        if layout.field == "orientation":  # a quaternion and its negative are one orientation
            found = found * np.where(np.sum(found * expected, axis=-1, keepdims=True) < 0, -1.0, 1.0)
        for index, item in enumerate(layout.items):
            expect_close(
                found[:, :, index],
                np.broadcast_to(expected, array.shape)[None, :, index],
                atol=tolerance,
                rtol=_TOLERANCE,
                what=f"first {layout.field} of {item}",
                unit=layout.unit,
            )


def _described(scene: Scene, layout: StateField) -> NDArray[np.float64]:
    if layout.field == "qpos":
        assert scene.robot is not None
        return np.array(scene.robot.start)[:, None]
    if layout.field == "qvel":
        assert scene.robot is not None
        return np.array(scene.robot.speeds())[:, None]
    bodies = {body.name: body for body in scene.moving()}
    return np.array([getattr(bodies[item], layout.field) for item in layout.items])
