"""Functional environments on JAX in gpusimbench.wrap: what is in the file, what users see, and what is refused."""

from __future__ import annotations

import json
import re
import warnings
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from gpusimbench import UsageError, record_rollout, wrap
from gpusimbench.evaluator.cli.compare import main as compare_command
from gpusimbench.evaluator.cli.info import main as info_command
from gpusimbench.evaluator.diff import compare
from gpusimbench.evaluator.player.poses import items_of
from gpusimbench.evaluator.read.episodes import count_episodes, episodes
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.vector.device import rows
from gpusimbench.recorder.vector.device.jax_rows import JaxRows
from gpusimbench.recorder.vector.device.states import RecordedArrays, seeds_of
from gpusimbench.schemas.images import image_hashes
from tests.conftest import run_python
from tests.reading import verified
from tests.recorder.engines import needed

needed("brax")
jax = needed("jax")

N_ENV, LONGEST = 3, 7


@cache
def brax() -> Any:
    """Brax's environments, whose import takes seconds and warns of what is old."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_module("brax.envs")


@cache
def falling_task() -> Any:
    """Brax's environment for tests, which begins at a drawn place, and ends where it has come far enough."""
    fast: Any = brax().fast.Fast

    class Falling(fast):  # type: ignore[misc]
        def reset(self, rng: Any) -> Any:
            state = super().reset(rng)
            place = jax.random.uniform(rng, (2,))
            state.metrics["far"] = place[0]
            return state.replace(obs=place)

        def step(self, state: Any, action: Any) -> Any:
            before = state.obs
            state = super().step(state, action)
            obs = before + abs(action[0]) / 4
            state.metrics["far"] = obs[0]
            return state.replace(obs=obs, reward=obs[1], done=(obs[0] > 1.5).astype(float))

    return Falling


def falling(*, reset: bool = True) -> Any:
    """Some of them as Brax trains with them, or without the resets."""
    training = brax().wrappers.training
    env = training.EpisodeWrapper(training.VmapWrapper(falling_task()(use_dict_obs=False)), LONGEST, 1)
    return training.AutoResetWrapper(env) if reset else env


def keys(seed: int = 0) -> Any:
    """A key of each environment."""
    return jax.random.split(jax.random.PRNGKey(seed), N_ENV)


def drawn(steps: int, seed: int = 1) -> Any:
    """Actions, [step, env, 1]."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, N_ENV, 1)).astype(np.float32)


def chosen(mask: Any, one: Any, other: Any) -> Any:
    """Arrays [env, ...] of two states, the first where the mask says so."""
    return jax.numpy.where(mask.reshape(-1, *(1,) * (one.ndim - 1)) != 0, one, other)


def column(recording: Recording, name: str) -> Any:
    """An array of environments, [row, env, ...] as the environment has it, without axes of one number."""
    return recording.state("env", name)[:, :, 0].squeeze(-1 if recording.state("env", name).shape[-1] == 1 else ())


@pytest.mark.parametrize("steps", [1, 49, 50, 170])
def test_a_recording_has_what_bare_environments_return(steps: int, tmp_path: Path) -> None:
    """Return and record, bit for bit, what the bare environment returns; ends and steps follow from its flags."""
    bare = falling()
    reset, step = jax.jit(bare.reset), jax.jit(bare.step)
    states, actions = [reset(keys())], drawn(steps)
    with wrap(falling(), tmp_path / "a.mcap", steps=steps, dt=0.1, infos=("far",)) as recorded:
        assert (recorded.action_size, type(recorded.unwrapped)) == (1, type(bare.unwrapped))
        state = recorded.reset(keys())
        for action in actions:
            states.append(step(states[-1], action))
            state = recorded.step(state, action)
            assert jax.tree.all(jax.tree.map(np.array_equal, state, states[-1]))
        assert np.array_equal(recorded.step(state, action).obs, step(states[-1], action).obs)
    recording = verified(tmp_path / "a.mcap")
    assert (recording.status, recording.configuration.steps) == ("complete", steps)
    assert recording.configuration.options["infos"] == "far"
    assert np.array_equal(column(recording, "observation"), np.stack([s.obs for s in states]))
    assert np.array_equal(column(recording, "reward")[1:], np.stack([s.reward for s in states[1:]]))
    assert np.array_equal(column(recording, "action")[1:], actions[..., 0])
    assert np.array_equal(column(recording, "info_far")[1:], np.stack([s.metrics["far"] for s in states[1:]]))
    done, cut = (np.stack([f(s) for s in states]) != 0 for f in (lambda s: s.done, lambda s: s.info["truncation"]))
    assert np.array_equal(column(recording, "truncated") != 0, cut)
    assert np.array_equal(column(recording, "terminated") != 0, done & ~cut)
    seen, last = column(recording, "observation"), column(recording, "final_observation")
    assert np.array_equal(last[1:], np.where(done[1:, :, None], seen[:-1], seen[1:]))
    assert np.array_equal(column(recording, "final_observation_given") != 0, ~done)
    if steps == 170:
        assert (done & ~cut).any() and cut.any() and done[51::50].any()  # in the first row of a block, too
    for episode in episodes(recording):
        assert episode.final_known is not episode.ended
        seen, end = episode.observations["observation"], -1 if episode.ended else None
        moved = np.diff(seen[:end, 0])
        assert np.allclose(moved, np.abs(episode.actions["action"][: len(moved), 0]) / 4, atol=1e-6)
    counts = count_episodes(recording)
    assert counts.ended == done[1:].sum()
    c = recording.configuration
    assert (c.simulator, c.scene, c.dt, c.n_env, c.seed) == ("brax", "Falling", 0.1, N_ENV, 0)
    assert c.options["env_wrappers"] == "AutoResetWrapper, EpisodeWrapper, VmapWrapper"


def test_equal_keys_give_equal_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Record the same for the same keys, whether steps are called or scanned; say by which keys environments began."""
    actions = drawn(60)
    for name, seed in (("a", 0), ("b", 0), ("c", 5)):
        with wrap(falling(), tmp_path / f"{name}.mcap", steps=60, dt=0.1) as recorded:
            state = recorded.reset(keys(seed))
            for action in actions:
                state = recorded.step(state, action)
    env = falling()
    first = jax.jit(env.reset)(keys())

    def step(state: Any, action: Any) -> Any:
        following = env.step(state, action)
        return following, (following, action)

    _, (states, given) = jax.lax.scan(step, first, actions)
    for name, rng in (("scan", keys()), ("unknown", None), ("other", keys(5))):
        record_rollout(env, tmp_path / f"{name}.mcap", first, states, given, dt=0.1, rng=rng)
    found = {name: verified(tmp_path / f"{name}.mcap") for name in ("a", "b", "c", "scan", "unknown", "other")}
    assert compare.compare(found["a"], found["b"]).bit_identical
    assert compare.compare(found["a"], found["scan"]).bit_identical
    assert not compare.compare(found["a"], found["c"]).bit_identical
    told = [recording.configuration.options.get("rng") for recording in found.values()]
    assert told[0] == told[1] == told[3] != told[2] == told[5] and told[4] is None

    # keys are what seeds are elsewhere: not another configuration, and not seed 0
    base, head = ([str(tmp_path / f"{name}.mcap") for name in names] for names in ("ac", "b"))
    compare_command(["--base", *base, "--head", *head, "--no-cache", "--json", str(tmp_path / "compared.json")])
    (configuration,) = json.loads((tmp_path / "compared.json").read_text())["compared"]
    assert "2 seeds of base and 1 of head, 1 on both sides, are one sample" in configuration["notes"]
    assert configuration["differs"] == []
    base, head = ([str(tmp_path / f"{name}.mcap") for name in names] for names in (("scan", "other"), ("a", "unknown")))
    compare_command(["--base", *base, "--head", *head, "--no-cache", "--json", str(tmp_path / "rollouts.json")])
    (configuration,) = json.loads((tmp_path / "rollouts.json").read_text())["compared"]
    said = (
        "2 seeds of base and 2 of head, 1 on both sides, are one sample; each run without a seed counts as another seed"
    )
    assert said in configuration["notes"]
    capsys.readouterr()
    assert info_command([head[1]]) == 0
    assert f"{N_ENV} environments, dt 0.1 s, seeds not given" in capsys.readouterr().out
    assert info_command([head[0]]) == 0
    assert f"{N_ENV} environments, dt 0.1 s, rng {told[0]}" in capsys.readouterr().out


def test_keys_are_described() -> None:
    """Name the seed of a key that jax.random made of one, and the hash of keys that were split."""
    for key in (jax.random.key(3), jax.random.PRNGKey(3), np.asarray(jax.random.PRNGKey(3))):
        assert seeds_of(key) == {"rng": "seed 3"}
    split = [seeds_of(keys(seed))["rng"] for seed in (3, 4)]
    assert all(re.fullmatch(rf"uint32 {N_ENV}x2 keys, hash [0-9a-f]{{16}}", text) for text in split)
    assert split[0] != split[1]
    assert seeds_of(None) == {"seeds": "not given"}


def test_steps_transfer_nothing(tmp_path: Path) -> None:
    """Send nothing to the device and take nothing from it in the steps of a block, whichever row they fill."""
    recorded = wrap(falling(), tmp_path / "a.mcap", steps=60, dt=0.1)
    actions = [jax.device_put(action) for action in drawn(60)]
    state = recorded.step(recorded.reset(keys()), actions[0])
    with jax.transfer_guard("disallow"):
        for action in actions[1:45]:
            state = recorded.step(state, action)
        with pytest.raises(Exception, match="Disallowed host-to-device transfer"):
            state.reward + np.float32(1)
    for action in actions[45:]:
        state = recorded.step(state, action)
    assert verified(tmp_path / "a.mcap").status == "complete"


def test_steps_start_no_function_for_what_is_not_there() -> None:
    """Where states tell no truncation, the zeros that stand for it are made once."""
    state = falling(reset=False).reset(keys())
    silent = state.replace(info={name: array for name, array in state.info.items() if name != "truncation"})
    layout = RecordedArrays(silent, infos=(), physics=False)
    first, second = (layout.row(silent, drawn(1)[0])["truncation"] for _ in range(2))
    assert first is second
    assert not np.asarray(first).any()
    assert np.array_equal(layout.row(state, drawn(1)[0])["truncation"], state.info["truncation"])


def test_the_file_does_not_depend_on_when_blocks_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the same messages where a block is taken after 50 rows, after 400, and at the end."""
    actions, found, take = drawn(410), {}, JaxRows._take
    for wait in (0.0, 1e9):
        monkeypatch.setattr(rows, "_WAIT_S", wait)
        taken: list[int] = []

        def counted(own: JaxRows, filled: int, taken: list[int] = taken) -> Any:
            taken.append(filled)
            return take(own, filled)

        monkeypatch.setattr(JaxRows, "_take", counted)
        recorded = wrap(falling(), tmp_path / f"{wait}.mcap", steps=410, dt=0.1)
        state = recorded.reset(keys())
        for action in actions:
            state = recorded.step(state, action)
        assert taken == [1, *([50] * 8 if wait == 0.0 else [400]), 10]
        assert verified(tmp_path / f"{wait}.mcap").status == "complete"
        with (tmp_path / f"{wait}.mcap").open("rb") as stream:
            messages = make_reader(stream).iter_messages(log_time_order=False)
            of_states = [(c.topic, m.data) for _, c, m in messages if c.topic.startswith(("/state", "/fingerprint"))]
        found[wait] = of_states
    assert len(found[0.0]) > 9 and found[0.0] == found[1e9]


@pytest.mark.parametrize(
    ("size", "most"), [(1, 400), (40_000, 400), (100_000, 150), (1 << 20, 50), (4 << 20, 32), (1 << 30, 1)]
)
def test_rows_of_a_block(size: int, most: int) -> None:
    """Wait for more rows only where these are small; a block is whole blocks of the file, or no more than 128 MiB."""
    assert rows._rows_of(size) == most


def test_resets_of_the_user(tmp_path: Path) -> None:
    """Begin episodes where the user resets all, or puts other states where some ended; keep what was seen before."""
    recorded = wrap(falling(reset=False), tmp_path / "a.mcap", steps=70, dt=0.1)
    state = first = recorded.reset(keys())
    ended = 0
    for at, action in enumerate(drawn(70)):
        if at == 40:
            state = first = recorded.reset(keys(4))
        state = recorded.step(state, action)
        done = state.done
        if done.any() and at != 69:
            ended += int(done.sum())
            state = jax.tree.map(partial(chosen, done), first, state)
    recording = verified(tmp_path / "a.mcap")
    every = list(episodes(recording))
    assert all(episode.final_known for episode in every)
    assert sum(episode.ended for episode in every) >= ended > 20
    assert sum(map(len, every)) == 70 * N_ENV
    for episode in every:
        seen = episode.observations["observation"][:, 0]
        assert np.allclose(np.diff(seen), np.abs(episode.actions["action"][:, 0]) / 4, atol=1e-6)
        assert episode.terminated == (seen[-1] > 1.5)
        assert len(episode) <= LONGEST
    cut = [episode for episode in every if not episode.ended and episode.number]
    assert len(cut) >= N_ENV


def test_observations_that_the_user_changes_begin_no_episode(tmp_path: Path) -> None:
    """Record the observation that the next action is based on, such as a normalised one, in the same episode."""
    recorded = wrap(falling(), tmp_path / "a.mcap", steps=5, dt=0.1)
    state = recorded.reset(keys())
    for action in drawn(5) * 0:
        state = recorded.step(state.replace(obs=state.obs / 2), action)
    recording = verified(tmp_path / "a.mcap")
    assert column(recording, "episode").max() == 0
    seen, final = column(recording, "observation"), column(recording, "final_observation")
    assert np.array_equal(seen[1:-1], final[1:-1] / 2) and np.array_equal(seen[-1], final[-1])


def test_compiled_callers_are_refused(tmp_path: Path) -> None:
    """Say where steps cannot be recorded, and what to do instead; nothing is written."""
    recorded = wrap(falling(), tmp_path / "a.mcap", steps=5, dt=0.1)
    with pytest.raises(UsageError, match="reset is called while JAX compiles a function"):
        jax.jit(recorded.reset)(keys())
    state = recorded.reset(keys())
    with pytest.raises(UsageError, match=r"step is called .* give the states of a scan to gpusimbench.record_rollout"):
        jax.lax.scan(lambda s, a: (recorded.step(s, a), None), state, drawn(2))
    recorded.close()
    assert not list(tmp_path.iterdir())


def test_how_a_recording_ends(tmp_path: Path) -> None:
    """Failed where steps are missing, with the reason of an error; whole with what was hashed behind the last step."""
    with wrap(falling(), tmp_path / "short.mcap", steps=9, dt=0.1) as short:
        short.step(short.reset(keys()), drawn(1)[0])
    with (
        pytest.raises(UsageError, match="action is float16"),
        wrap(falling(), tmp_path / "other.mcap", steps=9, dt=0.1) as other,
    ):
        state = other.step(other.reset(keys()), drawn(1)[0])
        other.step(state, drawn(1)[0].astype(np.float16))
    hashing = wrap(falling(), tmp_path / "hashed.mcap", steps=2, dt=0.1)
    state = hashing.reset(keys())
    hashing.fingerprint("policy", jax.numpy.arange(3))
    for action in drawn(2):
        state = hashing.step(state, action)
    hashing.fingerprint("policy", jax.numpy.arange(4))
    hashing.close()
    found = {path.stem: verified(path) for path in tmp_path.glob("*.mcap")}
    assert {name: (r.status, r.reason) for name, r in found.items() if name != "other"} == {
        "short": ("failed", "states end at step 1 of 9"),
        "hashed": ("complete", ""),
    }
    assert found["other"].status == "failed" and "action is float16" in found["other"].reason


def test_what_cannot_be_recorded(tmp_path: Path) -> None:
    """Say which name or time is missing before a file is made."""
    with pytest.raises(UsageError, match="no metric or info named near"):
        recorded = wrap(falling(), tmp_path / "a.mcap", steps=5, dt=0.1, infos=["near"])
        recorded.step(recorded.reset(keys()), drawn(1)[0])
    with pytest.raises(UsageError, match="tuple has no obs, and is no state"):
        wrap(falling(), tmp_path / "a.mcap", steps=5, dt=0.1).step((), drawn(1)[0])
    with pytest.raises(UsageError, match="give it in seconds, such as wrap"):
        wrap(falling(), tmp_path / "a.mcap", steps=5)
    with pytest.raises(UsageError, match="physics is recorded of states with"):
        recorded = wrap(falling(), tmp_path / "a.mcap", steps=5, dt=0.1, physics=True)
        recorded.step(recorded.reset(keys()).replace(pipeline_state=None), drawn(1)[0])
    env = falling()
    first = env.reset(keys())
    stacked = jax.tree.map(lambda array: array[None], env.step(first, drawn(1)[0]))
    with pytest.raises(UsageError, match=r"action has shape \(2, 3, 1\), and not \(1, 3, 1\)"):
        record_rollout(env, tmp_path / "a.mcap", first, stacked, drawn(2), dt=0.1)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Brax, that it is old
@pytest.mark.parametrize("batch", [None, 4])
def test_a_pendulum_of_brax(batch: int | None, tmp_path: Path) -> None:
    """Record a task of Brax with its physics, one environment or several, of which time is the task's own."""
    env = brax().create(
        "inverted_pendulum", backend="generalized", batch_size=batch, episode_length=15, action_repeat=2
    )
    with wrap(env, tmp_path / "a.mcap", steps=20, physics=True) as recorded:
        state = recorded.reset(jax.random.PRNGKey(0))
        seen = [state]
        for _ in range(20):
            state = recorded.step(state, jax.numpy.ones((*state.reward.shape, 1)))
            seen.append(state)
    recording = verified(tmp_path / "a.mcap")
    assert recording.configuration.n_env == (batch or 1)
    assert recording.configuration.dt == pytest.approx(2 * env.dt)
    assert column(recording, "physics_q").shape == (21, batch or 1, 2)
    assert np.array_equal(
        column(recording, "physics_q").reshape(21, *seen[0].pipeline_state.q.shape),
        np.stack([one.pipeline_state.q for one in seen]),
    )


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True])
def test_a_cartpole_of_playground(full: bool, tmp_path: Path) -> None:
    """Record a task of MuJoCo Playground, whose states of MuJoCo are those that MJX has; count its episodes."""
    playground = pytest.importorskip("mujoco_playground")
    task = playground.registry.load("CartpoleBalance", config_overrides={"impl": "jax"})
    env = playground.wrapper.wrap_for_brax_training(task, episode_length=8, full_reset=full)
    with wrap(env, tmp_path / "a.mcap", steps=30, physics=True, infos=("reward/upright",)) as recorded:
        state = recorded.reset(keys())
        seen = [state]
        for action in drawn(30):
            state = recorded.step(state, action)
            seen.append(state)
    recording = verified(tmp_path / "a.mcap")
    assert (recording.configuration.simulator, recording.configuration.dt) == ("mujoco_playground", 0.01)
    for name in ("qpos", "qvel"):
        assert np.array_equal(column(recording, f"physics_{name}"), np.stack([getattr(one.data, name) for one in seen]))
    drawn_at = items_of(recording, 0, [range(31)])
    cart = [name for _, name in drawn_at.bodies].index("cart")
    slide = np.array([one.data.qpos[0, 0] for one in seen])
    np.testing.assert_allclose(drawn_at.position[:, cart, 0], slide, atol=1e-6)  # along the rail, in float32
    counts = count_episodes(recording)
    assert (counts.truncated, counts.terminated, counts.mean_length) == (3 * N_ENV, 0, 8)
    assert (column(recording, "info_reward_upright_given")[1:] == 1).all()


def test_images_that_are_observed(tmp_path: Path) -> None:
    """Hash the frames that came from the device, of every row and environment."""

    class Camera:
        """A functional environment that observes a picture."""

        def reset(self, rng: Any) -> Any:
            return self._state(jax.numpy.zeros(N_ENV))

        def step(self, state: Any, action: Any) -> Any:
            return self._state(state.reward + 1)

        def _state(self, count: Any) -> Any:
            pixels = (jax.numpy.arange(4 * 5 * 3).reshape(4, 5, 3) + 7 * count[:, None, None, None]).astype("uint8")
            return brax().State(
                None, {"pixels": pixels, "at": count}, count, jax.numpy.zeros(N_ENV), {}, {"truncation": count * 0}
            )

    with wrap(Camera(), tmp_path / "a.mcap", dt=0.1) as recorded:
        state = recorded.reset(keys())
        seen = [np.asarray(state.obs["pixels"])]
        for action in drawn(60):
            state = recorded.step(state, action)
            seen.append(np.asarray(state.obs["pixels"]))
    recording = verified(tmp_path / "a.mcap")
    assert (recording.status, recording.configuration.steps) == ("complete", 60)
    assert recording.configuration.options["images"] == "hash"
    assert np.array_equal(column(recording, "observation_pixels_hash"), image_hashes(np.stack(seen), lead=2))
    assert np.array_equal(column(recording, "observation_at")[:, 0], np.arange(61))


_FORKS = """
import os, signal, sys, warnings
warnings.simplefilter("ignore")
from gpusimbench import wrap
from tests.recorder.test_wrap_functional import drawn, falling, keys

env = wrap(falling(), sys.argv[1], steps=20, dt=0.1)
state = env.reset(keys())
for number, action in enumerate(drawn(20)):
    state = env.step(state, action)
    if number == 10 and not os.fork():
        signal.alarm(300)
        env.close()
        os._exit(0)
ended = os.wait()[1]
env.close()
sys.exit(ended)
"""


@pytest.mark.slow
def test_a_copy_of_the_process_closes_nothing(tmp_path: Path) -> None:
    """Leave the recording to the process that began it: a copy lacks the thread that writes, and waits for none."""
    run_python(_FORKS, tmp_path / "a.mcap")
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "complete"
