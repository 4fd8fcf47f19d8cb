"""gpusimbench.wrap used wrongly: a sentence at the first step that says what is wrong, and no file that is not true."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from gpusimbench import RecordingWriter, UsageError, open_recording, record_rollout, wrap
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.vector.device import rows
from gpusimbench.schemas.errors import DataLost
from tests.limits import full_disk
from tests.reading import verified
from tests.recorder.engines import needed

jax, jnp = needed("jax"), needed("jax.numpy")

N_ENV = 3


def key() -> Any:
    return jax.random.PRNGKey(0)


@cache
def _register() -> None:
    jax.tree_util.register_dataclass(State)


@dataclass
class State:
    """What Brax and MuJoCo Playground call a state."""

    obs: Any
    reward: Any
    done: Any
    info: Any
    metrics: Any


class Counting:
    """Environments whose observation is the number of steps since the reset.

    autoreset  they hide the last observation as Brax's wrapper does
    changes    of what step returns, by name: functions of the array
    """

    dt = 0.1

    def __init__(self, *, autoreset: bool = False, **changes: Any) -> None:
        _register()
        self._changes = changes
        self._first = {"first_obs": jnp.zeros((N_ENV, 1))} if autoreset else {}

    def reset(self, rng: Any) -> State:
        return self._changed(self._state(jnp.zeros(())))

    def step(self, state: State, action: Any) -> State:
        return self._changed(self._state(state.info["time"] + 1))

    def _state(self, time: Any) -> State:
        ones = jnp.ones(N_ENV)
        return State(ones[:, None] * time, ones, ones * 0, {"time": time, **self._first}, {"far": ones})

    def _changed(self, state: State) -> State:
        return replace(state, **{name: change(getattr(state, name)) for name, change in self._changes.items()})


def stepped(env: Any, path: Path, *, steps: int = 8, action: Any = None, before: Any = None) -> Recording:
    """A recording of an environment; before(step, state) gives the state that a step begins in."""
    with wrap(env, path, steps=steps) as recorded:
        state = recorded.reset(key())
        for step in range(steps):
            state = recorded.step(before(step, state) if before else state, action or jnp.zeros((N_ENV, 1)))
    return verified(path)


@pytest.mark.parametrize("autoreset", [False, True])
def test_a_state_that_is_used_again_begins_an_episode(autoreset: bool, tmp_path: Path) -> None:
    """Begin an episode where the user goes back to the state of the reset: the trajectory does not go on there."""
    first: list[Any] = []

    def before(step: int, state: Any) -> Any:
        first.append(state)
        return first[0] if step % 4 == 0 else state

    recording = stepped(Counting(autoreset=autoreset), tmp_path / "a.mcap", before=before)
    assert recording.state("env", "observation")[:, 0].ravel().tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 4]
    assert recording.state("env", "episode")[:, 0].ravel().tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda obs: obs[:1] + 1, r"observation is float32 \(1, 1\), and was float32 \(3, 1\) before"),
        (lambda obs: obs.astype(jnp.float16) + 1, r"observation is float16 \(3, 1\)"),
        (lambda obs: {"other": obs + 1}, r"observation is missing \(\)"),
    ],
)
def test_observations_that_the_user_makes_others(change: Any, said: str, tmp_path: Path) -> None:
    """Refuse observations of another shape or type between steps, of which a part was written over the old ones."""
    with pytest.raises(UsageError, match=said):
        stepped(
            Counting(),
            tmp_path / "a.mcap",
            before=lambda step, state: replace(state, obs=change(state.obs)) if step == 4 else state,
        )
    assert open_recording(tmp_path / "a.mcap").status == "failed"


@pytest.mark.parametrize(
    ("changes", "action", "said"),
    [
        ({"done": lambda done: done[:, None]}, None, r"done has shape \(3, 1\); a truth value for each of 3"),
        ({"reward": lambda reward: reward[:, None] * 1j}, None, "reward is complex64; arrays of real numbers"),
        ({"obs": lambda obs: obs[:2]}, None, r"observation has shape \(2, 1\); a row for each of 3 environments"),
        ({"obs": lambda obs: jax.random.split(jax.random.key(0), 3)}, None, "observation is key<fry>; arrays of real"),
        ({}, [[0.5]], "action/0/0 is float, and no array"),
        ({}, {"a": None}, "action/a is NoneType, and no array"),
        ({}, lambda: jnp.ones((4, 1)), r"action has shape \(4, 1\)"),
    ],
)
def test_arrays_that_cannot_be_recorded(changes: Any, action: Any, said: str, tmp_path: Path) -> None:
    """Say at the first step which array is none of real numbers for each environment; leave nothing."""
    recorded = wrap(Counting(**changes), tmp_path / "a.mcap", steps=4)
    given = action() if callable(action) else jnp.zeros((N_ENV, 1)) if action is None else action
    with pytest.raises(UsageError, match=said):
        recorded.step(recorded.reset(key()), given)
    recorded.close()
    assert not list(tmp_path.iterdir())


def test_a_wrap_of_a_wrap(tmp_path: Path) -> None:
    """Record the same twice, of one environment in two files."""
    stepped(wrap(Counting(), tmp_path / "a.mcap", steps=8), tmp_path / "b.mcap")
    a, b = (open_recording(tmp_path / f"{name}.mcap") for name in "ab")
    assert a.status == b.status == "complete"
    assert np.array_equal(a.state("env", "observation"), b.state("env", "observation"))


def test_rollouts_of_nothing(tmp_path: Path) -> None:
    """Refuse scans of no step, states and actions that are none, and a name for names; take lists of arrays."""
    env, path = Counting(), tmp_path / "a.mcap"
    first = env.reset(key())
    actions = jnp.zeros((4, N_ENV, 1))
    _, states = jax.lax.scan(lambda s, a: (env.step(s, a),) * 2, first, actions)
    for wrong, said in (
        ({"actions": actions[:0], "states": jax.tree.map(lambda array: array[:0], states)}, "stacked no states"),
        ({"states": None}, "NoneType has no obs"),
        ({"actions": None}, "action is NoneType, and no array"),
        ({"rng": 3}, "rng is no key of JAX"),
        ({"infos": "far"}, r"infos is a list of names, such as \(\"far\",\)"),
    ):
        given = {"states": states, "actions": actions, **wrong}
        with pytest.raises(UsageError, match=said):
            record_rollout(env, path, first, **given)
    assert not list(tmp_path.iterdir())
    record_rollout(env, path, jax.tree.map(np.asarray, first), states, [actions, actions + 1])
    assert (open_recording(path).state("env", "action_1")[1:] == 1).all()


def cartpoles() -> Any:
    """Two environments of Gymnasium."""
    return gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync")


class Seeing(gymnasium.vector.VectorWrapper):  # type: ignore[misc]
    """Environments whose observations are others."""

    def __init__(self, observation: Any) -> None:
        super().__init__(cartpoles())
        self._observation = observation

    def reset(self, **keywords: Any) -> Any:
        return self._observation, self.env.reset(**keywords)[1]

    def step(self, actions: Any) -> Any:
        return (self._observation, *self.env.step(actions)[1:])


@pytest.mark.parametrize(
    ("env", "wrong", "said"),
    [
        (cartpoles, {"steps": 1 << 41}, "could not be read again: steps is not a whole number from 1"),
        (cartpoles, {"steps": 1, "seed": 1 << 70}, "could not be read again: seed is not a whole number"),
        (
            lambda: Seeing(np.zeros((2, 256, 256, 3), np.float32)),
            {"steps": 1},
            "observation/000000 has .* too many numbers",
        ),
        (lambda: Seeing({"x" * 2000: np.zeros(2)}), {"steps": 1}, "has too long a name"),
        (
            lambda: Seeing({"a b": np.zeros(2), "a_b": np.zeros(2)}),
            {"steps": 1},
            "same group and name, env/observation_a_b",
        ),
        (lambda: Seeing(np.zeros((1, 4))), {"steps": 1}, r"observation has shape \(1, 4\); a row for each of 2"),
    ],
)
def test_recordings_that_nobody_could_read(env: Any, wrong: Any, said: str, tmp_path: Path) -> None:
    """Refuse before the first step what a whole run was recorded of, in a file that no command reads."""
    with wrap(env(), tmp_path / "a.mcap", steps=wrong["steps"]) as recorded:
        recorded.reset(seed=wrong.get("seed"))
        with pytest.raises(UsageError, match=said):
            recorded.step(np.zeros(2, dtype=np.int64))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"steps": 2.5}, "steps is a whole number, not 2.5"),
        ({"steps": True}, "steps is a whole number, not True"),
        ({"steps": "5"}, "steps is a whole number, not '5'"),
        ({"dt": "fast"}, "dt is a number of seconds, not 'fast'"),
        ({"infos": None}, "infos is a list of names, not None"),
        ({"infos": [3]}, r"infos is a list of names, not \[3\]"),
        ({"path": None}, "path is the file to write, not None"),
        ({"envs": None}, "None is no environment: it has no reset and step"),
    ],
)
def test_arguments_that_are_none(wrong: Any, said: str, tmp_path: Path) -> None:
    """Say at once which argument is of another kind."""
    given = {"envs": cartpoles(), "path": tmp_path / "a.mcap", "steps": 5, **wrong}
    with pytest.raises(UsageError, match=said):
        wrap(given.pop("envs"), given.pop("path"), **given)


def test_lists_of_actions(tmp_path: Path) -> None:
    """Take the actions of all environments as a list, as Gymnasium and Stable-Baselines3 do."""
    with wrap(cartpoles(), tmp_path / "a.mcap", steps=np.int64(3)) as recorded:
        recorded.reset(seed=0)
        for _ in range(3):
            recorded.step([1, 0])
    actions = open_recording(tmp_path / "a.mcap").state("env", "action")
    assert actions[1:].reshape(3, 2).tolist() == [[1, 0]] * 3


@pytest.mark.parametrize("functional", [True, False], ids=["a functional environment", "a vector"])
def test_a_disk_that_is_full(functional: bool, tmp_path: Path) -> None:
    """Raise one error that says what was written, and leave nothing under the name of a whole recording."""
    with (
        full_disk(30_000),
        pytest.raises(DataLost, match=r"writing stopped: File too large; what was written is in .*a\.mcap\.partial"),
    ):
        if functional:
            stepped(Counting(), tmp_path / "a.mcap", steps=2000)
        else:
            envs = gymnasium.make_vec("CartPole-v1", num_envs=N_ENV, vectorization_mode="sync")
            with wrap(envs, tmp_path / "a.mcap", steps=2000) as recorded:
                recorded.reset(seed=0)
                for _ in range(2000):
                    recorded.step(np.zeros(N_ENV, dtype=np.int64))
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.partial"]
    assert open_recording(tmp_path / "a.mcap.partial").status == "incomplete"


@pytest.mark.parametrize(
    ("functional", "number", "raised"),
    [
        (True, signal.SIGINT, KeyboardInterrupt),
        (True, signal.SIGTERM, TimeoutError),
        (False, signal.SIGINT, KeyboardInterrupt),
    ],
)
def test_an_interruption_while_the_disk_is_behind(
    functional: bool, number: int, raised: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Write all rows before a recording ends as complete, however the user interrupts the close of an environment."""

    def interrupted(*_: Any) -> None:
        raise raised

    append = RecordingWriter.append

    def slow(log: RecordingWriter, *arrays: Any) -> None:
        if len(arrays[0]) in (20, 21):  # the rows behind the last whole block
            os.kill(os.getpid(), number)
            time.sleep(0.1)
        append(log, *arrays)

    monkeypatch.setattr(RecordingWriter, "append", slow)
    monkeypatch.setattr(rows, "_WAIT_S", 0.0)
    recorded: Any = wrap(Counting() if functional else cartpoles(), tmp_path / "a.mcap")
    state = recorded.reset(key()) if functional else recorded.reset(seed=0)
    for _ in range(70):
        state = recorded.step(*((state, jnp.zeros((N_ENV, 1))) if functional else ([0, 1],)))
    before = signal.signal(number, interrupted)
    try:
        with pytest.raises(raised):
            recorded.close()
    finally:
        signal.signal(number, before)
    recording = verified(tmp_path / "a.mcap")
    assert (recording.status, recording.configuration.steps) == ("complete", 70)
