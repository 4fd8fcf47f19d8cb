"""The state that a simulator begins with; and what an adapter claims of saving, restoring, resetting and setting it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.checks.agreement import differences, expect_repeatable
from gpusimbench.recorder.conformance.checks.description import expect_layout
from gpusimbench.recorder.conformance.scene import N_ENV
from gpusimbench.recorder.conformance.subject import CHOSEN, MEDDLED, RESTORED, Subject
from gpusimbench.recorder.conformance.trajectory import expect_origins, local, rounding
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect, expect_close, fail
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.snapshot import Claim, Extent
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


_METHODS = {
    "snapshot": ("snapshot", "restore"), "some": ("restore",), "reset": ("reset",), "set_state": ("set_state",),
}  # fmt: skip


def claims_are_kept(subject: Subject) -> None:
    """Have a method for each operation that is claimed, and a reason for each that is partial or missing."""
    for name, methods in _METHODS.items():
        claim: Claim = getattr(subject.claims, name)
        expect(bool(claim.why) == (claim.extent is not Extent.COMPLETE), f"{name} is {claim.extent.value}: say why")
        for method in methods if claim.extent is not Extent.NONE else ():
            overridden = getattr(subject.adapter, method) is not getattr(Simulator, method)
            expect(overridden, f"{name} is claimed to be {claim.extent.value}, and there is no {method}()")


def restored_state_repeats(subject: Subject) -> None:
    """Show the saved state after restore; where that is complete, make the same bits again in the steps that follow."""
    complete = _offered(subject, "snapshot")
    states = subject.meddled.states
    _same(subject, _last(states["after reset"]), states["restored"], "restore does not bring back")
    if complete:
        _same(subject, states["once"], states["again"], f"{MEDDLED} steps after restore are not those after snapshot:")


def restored_before_compile_repeats(subject: Subject) -> None:
    """Take a snapshot of another build before compile, as a recording that begins at a snapshot does, and keep it."""
    complete = _offered(subject, "snapshot")
    states = subject.meddled.states
    if "restored" not in states:
        raise NotApplicable(f"reset: {subject.claims.reset.why}")
    shown, onward = subject.revived
    _same(subject, states["restored"], shown, "restore before compile does not bring back")
    if complete:
        _same(
            subject, states["once"], onward, f"{MEDDLED} steps after restore and compile are not those after snapshot:"
        )


def restoring_some_leaves_others(subject: Subject) -> None:
    """Restore some environments, with all that decides their next steps, and change nothing of the others."""
    complete = _offered(subject, "some")
    states, fresh = subject.meddled.states, subject.trajectory.states
    others = [env for env in range(N_ENV) if env not in RESTORED]
    _same(subject, states["restored"], states["some restored"], "restore of some does not bring back", RESTORED)
    _same(subject, _last(states["again"]), states["some restored"], "restore of some changes others:", others)
    if complete:
        after = states["after some restored"]
        _same(subject, states["again"], after, "restored envs do not repeat themselves:", RESTORED)
        onward = tuple(array[2 * MEDDLED + 1 : 3 * MEDDLED + 1] for array in fresh)
        _same(subject, onward, after, "what other envs do after a restore of some differs from a run without:", others)


def reset_is_a_fresh_start(subject: Subject) -> None:
    """Show the first state after reset of all; where that is complete, step from there as a fresh build does."""
    complete = _offered(subject, "reset")
    states, fresh = subject.meddled.states, subject.trajectory.states
    _same(subject, subject.trajectory.described, states["reset"], "reset does not bring back the first")
    if complete:
        first = tuple(array[1 : MEDDLED + 1] for array in fresh)
        _same(subject, first, states["after reset"], "steps after reset are not those of a fresh build:")


def resetting_some_leaves_others(subject: Subject) -> None:
    """Reset some environments as a fresh build begins, and change nothing of the others."""
    complete = _offered(subject, "reset")
    states, fresh = subject.meddled.states, subject.trajectory.states
    others = [env for env in range(N_ENV) if env not in CHOSEN]
    _same(subject, subject.trajectory.described, states["some reset"], "reset of some does not bring back", CHOSEN)
    _same(subject, states["before some reset"], states["some reset"], "reset of some changes others:", others)
    if complete:
        first = tuple(array[1 : MEDDLED + 1] for array in fresh)
        _same(subject, first, states["after some reset"], "reset envs do not step as those of a fresh build:", CHOSEN)


def set_state_is_shown(subject: Subject) -> None:
    """Show what set_state was given, in the environments that were asked for, also after compile, and in no other."""
    _offered(subject, "set_state")
    states = subject.meddled.states
    everyone, others = range(N_ENV), [env for env in range(N_ENV) if env not in CHOSEN]
    for name, envs in (("begun", everyone), ("some set", CHOSEN)):
        rows = list(envs)
        layouts = subject.trajectory.description.fields
        for layout, found, given in zip(layouts, states[name], states["given"], strict=True):
            expect_close(
                found[None, rows],
                given[None, rows],
                atol=_TOLERANCE,
                rtol=_TOLERANCE,
                what=f"{layout.name} after set_state",
                unit=layout.unit,
            )
    _same(subject, states["before some set"], states["some set"], "set_state of some changes others:", others)


def set_state_starts_afresh(subject: Subject) -> None:
    """Step from a state that was set as from the same one right after build: nothing of earlier steps is left over."""
    if not _offered(subject, "set_state"):
        raise NotApplicable(f"set_state is {subject.claims.set_state}")
    states = subject.meddled.states
    _same(
        subject, states["after begun"], states["after some set"], "earlier steps leave traces behind set_state:", CHOSEN
    )


def _offered(subject: Subject, name: str) -> bool:
    """Whether an operation is complete; NotApplicable where there is none."""
    claim: Claim = getattr(subject.claims, name)
    if claim.extent is Extent.NONE:
        raise NotApplicable(f"{name}: {claim.why}")
    return claim.extent is Extent.COMPLETE


def _last(states: States) -> States:
    return tuple(array[-1] for array in states)


def _same(
    subject: Subject, one: States, other: States, message: str, envs: Sequence[int] | range = range(N_ENV)
) -> None:
    # arrays [env, item, width] or [step, env, item, width]; those of some environments have to be the same bits
    rows = np.array(envs)

    def chosen(states: States) -> States:
        return tuple(np.ascontiguousarray(array[..., rows, :, :]) for array in states)

    differ = differences(subject.trajectory.description, chosen(one), chosen(other))
    if differ:
        expect_repeatable(subject)
        fail(f"{message} {', '.join(differ)}")
