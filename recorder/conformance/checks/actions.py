"""Actions arrive in the engine as they were drawn."""

from __future__ import annotations

import numpy as np

from gpusimbench.recorder.conformance.subject import SEED, Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect
from gpusimbench.schemas.action_generator import Streams

_BLOCKS = (3, 2)
_ENVS = 2
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
