"""What an engine makes of a model file: the parameters that it holds, and how the model moves in its hands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import CONTACTS
from gpusimbench.schemas.arrays import MEDIA_TYPE
from gpusimbench.schemas.imported import DROP, IMPORTED, TRIALS, Trials

Make = Callable[[Scene, int], Simulator]
"""Of a scene and a number of environments, a simulator that was not built yet."""


def write_imported(journal: Journal, simulator: Simulator) -> None:
    """Attach the parameters that a built simulator holds of a model file."""
    if isinstance(simulator.scene, ModelScene) and (held := simulator.imported()) is not None:
        journal.sink.attach(IMPORTED, MEDIA_TYPE, held.encoded())


def write_trials(journal: Journal, scene: ModelScene, make: Make, *, dt: float, seed: int) -> None:
    """Try the model on simulators of its own, and attach what came of it."""
    from gpusimbench.recorder.simulators.mujoco.trials import dropped

    if (found := tried(scene, make, dt=dt, seed=seed)) is None:
        journal.event("NOTE", "the simulator does not tell what it holds of a model file; nothing was tried")
    else:
        journal.sink.attach(TRIALS, MEDIA_TYPE, found.encoded())
        if (drop := dropped(scene, make, dt=dt)) is not None:
            journal.sink.attach(DROP, MEDIA_TYPE, drop.encoded())


def tried(scene: ModelScene, make: Make, *, dt: float, seed: int) -> Trials | None:
    """What a simulator does with the model in poses and trials of recorder.simulators.mujoco.trials, one in each
    environment; None where it does not tell what it holds. Actuators are tried where environments can have controls of
    their own."""
    from gpusimbench.recorder.simulators.mujoco.trials import N_STEP, plan

    still = replace(scene, actions=None, controls="none")  # but for the controls that a trial holds
    asked = plan(still, dt=dt, seed=seed)
    n_pose, n_trial = len(asked.poses[0]), len(asked.kinds)
    n_env = max(n_pose, n_trial)
    simulator = make(still, n_env)
    try:
        description = simulator.build()
        held = simulator.imported()
        if held is None:
            return None
        simulator.set_state(_placed(description, _padded(asked.poses, n_env), 1))
        position, orientation = simulator.link_poses()
        if description.env_origins:
            position = position - np.array(description.env_origins)[:, np.newaxis]
        given = tuple(np.array(array[:n_pose]) for array in _placed(description, simulator.state(), -1))
        simulator.compile("capture")
        simulator.reserve(N_STEP)
        simulator.prepare(None)
        simulator.set_state(_placed(description, _padded(asked.starts, n_env), 1))
        controls = np.zeros((n_env, asked.controls.shape[1]))
        controls[:n_trial] = asked.controls
        try:
            simulator.hold(controls)
        except NotImplementedError:
            n_trial = sum(kind != "actuator" for kind in asked.kinds)
        first = tuple(np.array(array[:n_trial]) for array in _placed(description, simulator.state(), -1))
        after = tuple(np.array(array[:, :n_trial]) for array in simulator.states(N_STEP))
        counted = simulator.evidence()
    finally:
        simulator.close()
    contacts = np.full(n_trial, -1, dtype=np.int64)
    if counted is not None and CONTACTS.name in counted.counts:
        contacts = counted.counts[CONTACTS.name][:, :n_trial].max(axis=0).astype(np.int64)
    names = [field.name for field in description.fields]
    return Trials(
        links=held.names["bodies"],
        given={name: array for name, array in zip(names, given, strict=True) if not _is_velocity(name)},
        position=position[:n_pose],
        orientation=orientation[:n_pose],
        start={name: array[0] for name, array in zip(names, first, strict=True) if not _is_velocity(name)},
        kinds=asked.kinds[:n_trial],
        targets=asked.targets[:n_trial],
        velocity={
            name: np.concatenate([begin[np.newaxis], later])
            for name, begin, later in zip(names, first, after, strict=True)
            if _is_velocity(name)
        },
        contacts=contacts,
    )


def _is_velocity(field: str) -> bool:
    return field.rpartition("/")[2] in ("qvel", "linear_velocity", "angular_velocity")


def _padded(states: States, n_env: int) -> States:
    # environments that nothing is tried in are as the first
    return tuple(np.concatenate([array, np.repeat(array[:1], n_env - len(array), axis=0)]) for array in states)


def _placed(description: Description, states: States, sign: int) -> States:
    # with positions moved to where environments stand, or back
    if not description.env_origins:
        return states
    origins = np.array(description.env_origins)[:, np.newaxis]
    world = [field.field == "position" and field.frame == "world" for field in description.fields]
    return tuple(array + sign * origins if is_world else array for array, is_world in zip(states, world, strict=True))
