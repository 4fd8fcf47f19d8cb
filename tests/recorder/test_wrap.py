"""Vector environments in gpusimbench.wrap: what is in the file, in every autoreset mode, and what users see."""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench import DamagedRecording, RecordingWriter, UsageError, open_recording, wrap
from gpusimbench.evaluator.read.episodes import NEEDED, Episode, count_episodes, episodes
from gpusimbench.schemas.fields import array_field
from tests.conftest import call, run_python
from tests.reading import verified

gymnasium = pytest.importorskip("gymnasium")
MODES = ("NextStep", "SameStep", "Disabled")


class Walk(gymnasium.Env):  # type: ignore[misc,name-defined]
    """A walk that ends at a drawn place, or is cut after some steps; everything follows from seed and actions."""

    metadata = {"render_fps": 20}  # noqa: RUF012
    observation_space = gymnasium.spaces.Dict(
        {"at": gymnasium.spaces.Box(-99, 99, (2,), np.float32), "level": gymnasium.spaces.Discrete(99)}
    )
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, longest: int) -> None:
        self.longest = longest

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.at = self.np_random.normal(size=2).astype(np.float32)
        self.steps, self.level = 0, int(self.np_random.integers(99))
        self.last = int(self.np_random.integers(1, 6))
        return self.seen(), {}

    def seen(self) -> Any:
        return {"at": self.at.copy(), "level": self.level}

    def step(self, action: Any) -> Any:
        self.steps += 1
        self.at += action * self.np_random.uniform(0, 1)
        reward = float(self.at[0] * self.level)
        return self.seen(), reward, self.steps == self.last, self.steps == self.longest, {}


def walks(n_env: int, longest: int, mode: str) -> Any:
    """Walks as a vector of that mode."""
    return gymnasium.vector.SyncVectorEnv(
        [lambda: Walk(longest)] * n_env, autoreset_mode=gymnasium.vector.AutoresetMode(mode)
    )


class Breaking(Walk):
    """A walk whose place is not finite after the third step."""

    def step(self, action: Any) -> Any:
        self.last = 99
        self.at[:] = np.nan if self.steps == 2 else self.at
        return super().step(action)


def acted(observation: Any) -> Any:
    """A policy: actions that follow from the observations alone."""
    return np.tanh(observation["at"] - observation["level"][:, None] / 50).astype(np.float32)


def play(envs: Any, steps: int, seed: Any = 0) -> list[Any]:
    """Step as a user of that mode does; returns what each step returned."""
    observation, _ = envs.reset(seed=seed)
    told = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = envs.step(acted(observation))
        told.append((observation, reward, terminated, truncated, info))
        if envs.metadata["autoreset_mode"].value == "Disabled" and (terminated | truncated).any():
            observation, _ = envs.reset(options={"reset_mask": terminated | truncated})
    return told


def played(path: Path, n_env: int, longest: int, mode: str, steps: int, seed: Any = 0) -> dict[int, list[Episode]]:
    """The episodes of a recording, by environment."""
    envs = wrap(walks(n_env, longest, mode), path, steps=steps)
    play(envs, steps, seed)
    envs.close()
    recording = verified(path)
    assert recording.status == "complete"
    found = defaultdict(list)
    for episode in episodes(recording):
        found[episode.env].append(episode)
    return found


def said(episode: Episode) -> dict[str, Any]:
    """An episode as plain values."""
    arrays = {**episode.observations, **episode.actions, "rewards": episode.rewards}
    return {
        "number": episode.number, "ended": (episode.terminated, episode.truncated),
        **{name: array.tolist() for name, array in arrays.items()},
    }  # fmt: skip


@settings(max_examples=15)
@given(
    n_env=st.integers(1, 4), longest=st.integers(1, 6), seed=st.integers(0, 99), steps=st.sampled_from([1, 7, 49, 53])
)
@pytest.mark.slow
def test_every_mode_gives_the_same_episodes(n_env: int, longest: int, seed: int, steps: int) -> None:
    """Record the same episodes whenever the environment is reset, and those that the tasks themselves went through."""
    with TemporaryDirectory() as folder:
        found = {mode: played(Path(folder, f"{mode}.mcap"), n_env, longest, mode, steps, seed) for mode in MODES}
    for env in range(n_env):
        same, disabled, following = ([*map(said, found[mode][env])] for mode in ("SameStep", "Disabled", "NextStep"))
        assert same == disabled
        # a call that begins an episode makes no step there, so that fewer episodes fit in
        ended = [one for one in following if any(one["ended"])]
        assert ended == same[: len(ended)]
        for one in following[len(ended) :]:  # which the end of the recording cut
            whole = same[len(ended)]
            assert one["rewards"] == whole["rewards"][: len(one["rewards"])]
            assert one["observation_at"] == whole["observation_at"][: len(one["observation_at"])]
        assert sum(len(one["rewards"]) for one in same) == steps
        truth = transitions(env, longest, seed, steps)
        assert [one["rewards"] for one in same] == truth["rewards"]
        assert [one["observation_at"] for one in same] == truth["at"]
        assert [one["observation_level"] for one in same] == truth["level"]
        assert [one["ended"] for one in same if any(one["ended"])] == truth["ended"]


def transitions(env: int, longest: int, seed: int, steps: int) -> dict[str, list[Any]]:
    """The episodes of one walk, stepped without a vector."""
    walk = Walk(longest)
    found: dict[str, list[Any]] = {"rewards": [], "at": [], "level": [], "ended": []}
    done, made = True, 0
    while made < steps:
        if done:
            observation, _ = walk.reset(seed=seed + env if not found["at"] else None)
            found["rewards"].append([])
            found["at"].append([observation["at"].tolist()])
            found["level"].append([[observation["level"]]])
        action = acted({"at": observation["at"][None], "level": np.array([observation["level"]])})[0]
        observation, reward, terminated, truncated, _ = walk.step(action)
        found["rewards"][-1].append(reward)
        found["at"][-1].append(observation["at"].tolist())
        found["level"][-1].append([observation["level"]])
        done, made = terminated or truncated, made + 1
        if done:
            found["ended"].append((terminated, truncated))
    return found


@pytest.mark.parametrize("mode", MODES)
def test_users_see_what_they_saw(mode: str, tmp_path: Path) -> None:
    """Return what the environment returns, after the end of the recording too, and offer its interface."""
    bare, wrapped = walks(3, 4, mode), wrap(walks(3, 4, mode), tmp_path / "a.mcap", steps=20)
    assert isinstance(wrapped, gymnasium.vector.VectorEnv)
    assert wrapped.metadata["autoreset_mode"] == bare.metadata["autoreset_mode"]
    assert (wrapped.num_envs, wrapped.action_space) == (3, bare.action_space)
    for one, other in zip(play(bare, 30), play(wrapped, 30), strict=True):
        for a, b in zip(one[0].values(), other[0].values(), strict=True):
            assert np.array_equal(a, b)
        assert all(np.array_equal(a, b) for a, b in zip(one[1:4], other[1:4], strict=True))
        assert one[4].keys() == other[4].keys()
    assert open_recording(tmp_path / "a.mcap").status == "complete"
    wrapped.close()
    assert open_recording(tmp_path / "a.mcap").configuration.steps == 20


def test_what_is_recorded(tmp_path: Path) -> None:
    """Say of each array what it is, its dtype and its unit where it has one, and what ran."""
    played(tmp_path / "a.mcap", 2, 3, "NextStep", 12, seed=7)
    recording = open_recording(tmp_path / "a.mcap")
    assert {field.field: (field.dtype, field.unit, field.components) for field in recording.fields} == {
        "action": ("float32", "unknown", ("0", "1")),
        "observation_at": ("float32", "unknown", ("0", "1")),
        "observation_level": ("float64", "unknown", ("",)),
        "reward": ("float64", "unknown", ("",)),
        "terminated": ("float32", "1", ("",)),
        "truncated": ("float32", "1", ("",)),
        "final_observation_at": ("float32", "unknown", ("0", "1")),
        "final_observation_level": ("float64", "unknown", ("",)),
        "stepped": ("float32", "1", ("",)),
        "episode": ("float64", "1", ("",)),
        "episode_step": ("float64", "1", ("",)),
    }
    c = recording.configuration
    assert (c.simulator, c.scene, c.dt, c.seed, c.steps, c.n_env) == ("gymnasium", "Walk", 0.05, 7, 12, 2)
    assert c.options == {"autoreset_mode": "NextStep"}
    assert recording.simulation.version == gymnasium.__version__
    stepped = recording.state("env", "stepped")[:, :, 0, 0]
    begins = (stepped[1:] == 0) & (recording.state("env", "episode")[1:, :, 0, 0] > 0)
    assert begins.any()
    assert (recording.state("env", "action")[1:][begins] == 0).all()
    assert (recording.state("env", "episode_step")[1:, :, 0, 0][begins] == 0).all()
    assert not stepped[0].any()


def test_seeds_and_time_steps(tmp_path: Path) -> None:
    """Record seeds as they were given, and the time step as the task or the user tells it."""
    for name, seed, dt in (("none", None, None), ("list", [5, 3], 0.01), ("one", 4, None)):
        envs = wrap(walks(2, 3, "NextStep"), tmp_path / f"{name}.mcap", steps=1, dt=dt)
        envs.reset(seed=seed)
        envs.step(envs.action_space.sample())
        envs.close()
    found = {path.stem: open_recording(path).configuration for path in tmp_path.glob("*.mcap")}
    assert {name: (c.seed, c.options.get("seeds"), c.dt) for name, c in found.items()} == {
        "none": (0, "not given", 0.05), "list": (0, "5, 3", 0.01), "one": (4, None, 0.05),
    }  # fmt: skip
    assert "seeds 5, 3" in call("gsb-info", tmp_path / "list.mcap").stdout
    assert "seed 4" in call("gsb-info", tmp_path / "one.mcap").stdout


@pytest.mark.parametrize(
    ("told", "wanted"),
    [
        ({"dt": 0.01}, 0.01),
        ({"dt": 0.01, "control_hz": 10}, 0.1),
        ({"dt": 0.002, "control_freq": 20.0, "step_dt": 0.05}, 0.05),
        ({"dt": 0.01, "control_timestep": 0.04, "control_freq": 25}, 0.04),
        ({"dt": 0, "control_freq": 0, "control_hz": True}, 0.05),
        ({"control_timestep": lambda: 0.1}, 0.05),
    ],
)
def test_the_time_between_two_actions(told: dict[str, Any], wanted: float, tmp_path: Path) -> None:
    """Record the control step where a task tells it beside the step of its physics; else what the task says at all."""
    envs = walks(1, 3, "NextStep")
    for name, value in told.items():
        setattr(envs.envs[0].unwrapped, name, value)
    with wrap(envs, tmp_path / "a.mcap", steps=1) as recorded:
        recorded.reset(seed=0)
        recorded.step(recorded.action_space.sample())
    assert open_recording(tmp_path / "a.mcap").configuration.dt == pytest.approx(wanted)


@pytest.mark.parametrize("mode", MODES)
def test_a_reset_of_all_cuts_the_episodes(mode: str, tmp_path: Path) -> None:
    """Begin the next episode of every environment, keep what was seen before, and lose no step."""

    class Long(Walk):
        def seen(self) -> Any:
            self.last = 99
            return super().seen()

    modes = gymnasium.vector.AutoresetMode
    vector = gymnasium.vector.SyncVectorEnv([lambda: Long(99)] * 2, autoreset_mode=modes(mode))
    envs = wrap(vector, tmp_path / "a.mcap", steps=4)
    first, _ = envs.reset(seed=9)
    lasts = []
    for _ in range(2):
        for _ in range(2):
            last, _, terminated, truncated, _ = envs.step(envs.action_space.sample())
            assert not (terminated | truncated).any()
        lasts.append({name: array.copy() for name, array in last.items()})
        envs.reset()
    envs.close()
    found = list(episodes(open_recording(tmp_path / "a.mcap")))
    assert [(e.env, e.number, len(e), e.ended) for e in found] == [
        (env, number, 2, False) for env in range(2) for number in range(2)
    ]
    assert np.array_equal(found[0].observations["observation_at"][0], first["at"][0])
    for episode in found:
        assert np.array_equal(episode.observations["observation_at"][-1], lasts[episode.number]["at"][episode.env])


def test_how_a_recording_ends(tmp_path: Path) -> None:
    """Complete with its last step; failed where there were fewer, and with the reason where an error ended it."""
    short = wrap(walks(1, 3, "NextStep"), tmp_path / "short.mcap", steps=10)
    play(short, 4)
    short.close()
    short.close()

    class Broken(Walk):
        def step(self, action: Any) -> Any:
            calls.append(action)
            if len(calls) == 3:
                raise RuntimeError("the motor is hot")
            return super().step(action)

    calls: list[Any] = []
    broken = wrap(gymnasium.vector.SyncVectorEnv([lambda: Broken(9)]), tmp_path / "broken.mcap", steps=10)
    with pytest.raises(RuntimeError, match="hot"):
        play(broken, 10)
    broken.close()
    with pytest.raises(KeyError), wrap(walks(1, 3, "SameStep"), tmp_path / "mine.mcap", steps=10) as mine:
        play(mine, 2)
        raise KeyError("of the user")
    unused = wrap(walks(1, 3, "SameStep"), tmp_path / "unused.mcap", steps=10)
    unused.close()
    unannounced = wrap(walks(1, 3, "NextStep"), tmp_path / "unannounced.mcap")
    play(unannounced, 70)
    unannounced.close()
    found = {path.stem: open_recording(path) for path in tmp_path.glob("*.mcap")}
    assert {name: (r.status, r.reason) for name, r in found.items()} == {
        "short": ("failed", "states end at step 4 of 10"),
        "broken": ("failed", "RuntimeError: the motor is hot"),
        "mine": ("failed", "KeyError: 'of the user'"),
        "unannounced": ("complete", ""),
    }
    assert found["unannounced"].configuration.steps == 70
    assert len(found["unannounced"].state("env", "reward")) == 71
    made = found["broken"].state("env", "stepped")[1:, 0, 0, 0]
    assert made.sum() == 2


def test_what_cannot_be_wrapped(tmp_path: Path) -> None:
    """Say what is missing before anything is recorded."""
    with pytest.raises(UsageError, match="at least 1 step"):
        wrap(walks(1, 3, "NextStep"), tmp_path / "a.mcap", steps=0)
    timeless = walks(1, 3, "NextStep")
    timeless.metadata = {}
    with pytest.raises(UsageError, match="give it in seconds, such as wrap"):
        wrap(timeless, tmp_path / "a.mcap", steps=1)
    modeless = walks(1, 3, "NextStep")
    modeless.metadata = {"render_fps": 20}
    with pytest.raises(UsageError, match="need an autoreset_mode"):
        wrap(modeless, tmp_path / "a.mcap", steps=1)
    with pytest.raises(UsageError, match="is a single environment; wrap records vector environments"):
        wrap(gymnasium.make("CartPole-v1"), tmp_path / "a.mcap", steps=1)
    with pytest.raises(UsageError, match="is reset before it is stepped"):
        wrap(walks(1, 3, "NextStep"), tmp_path / "a.mcap", steps=1).step(np.zeros((1, 2), np.float32))
    assert not list(tmp_path.iterdir())


def test_other_libraries_are_not_loaded(tmp_path: Path) -> None:
    """Record environments of Gymnasium without JAX and torch, which may be installed for other things."""
    code = (
        "import sys, gymnasium, gpusimbench\n"
        "envs = gymnasium.make_vec('CartPole-v1', num_envs=2)\n"
        f"with gpusimbench.wrap(envs, {str(tmp_path / 'a.mcap')!r}, steps=1) as envs:\n"
        "    envs.reset()\n"
        "    envs.step(envs.action_space.sample())\n"
        "print({'jax', 'torch', 'brax'} & set(sys.modules))"
    )
    assert run_python(code).stdout.split() == ["set()"]


def test_actions_are_recorded_as_they_were_given(tmp_path: Path) -> None:
    """Record the policy's own dtype, and end the recording where a later action would lose digits."""
    envs = wrap(walks(2, 3, "SameStep"), tmp_path / "a.mcap", steps=2)
    envs.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-1, 1, (2, 2, 2))
    for action in actions:
        envs.step(action)
    envs.close()
    assert np.array_equal(open_recording(tmp_path / "a.mcap").state("env", "action")[1:, :, 0], actions)
    envs = wrap(walks(2, 3, "NextStep"), tmp_path / "b.mcap", steps=2)
    envs.reset(seed=1)
    envs.step(actions[0].astype(np.float32))
    with pytest.raises(UsageError, match="action is float64, and was recorded as float32 before"):
        envs.step(actions[1])
    envs.close()
    assert open_recording(tmp_path / "b.mcap").status == "failed"


def test_what_the_commands_say(tmp_path: Path) -> None:
    """Count episodes, compare runs by bits, and name what differs by its own name and without a unit."""
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        played(tmp_path / f"{name}.mcap", 3, 4, "SameStep", 40, seed)
    recording = open_recording(tmp_path / "a.mcap")
    every = list(episodes(recording))
    ended = [e for e in every if e.ended]
    counts = count_episodes(recording)
    assert (counts.steps, counts.ended, counts.cut) == (120, len(ended), len(every) - len(ended))
    assert (counts.terminated, counts.truncated) == (sum(e.terminated for e in every), sum(e.truncated for e in every))
    assert counts.mean_length == pytest.approx(np.mean([len(e) for e in ended]))
    assert counts.mean_return == pytest.approx(np.mean([e.rewards.sum() for e in ended]))
    info = call("gsb-info", tmp_path / "a.mcap", "--all")
    said = " ".join(info.stdout.split())
    assert f"episodes {counts.ended} ended ({counts.terminated} terminated, {counts.truncated} truncated)" in said
    assert "rad" not in info.stdout.replace("gradual", "")
    document = json.loads(call("gsb-info", tmp_path / "a.mcap", "--json", "-").stdout)
    assert document["files"][0]["episodes"]["ended"] == counts.ended
    same = call("gsb-diff", tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert (same.returncode, same.stdout.splitlines()[0]) == (0, "The two recordings are bit-identical.")
    other = call("gsb-diff", tmp_path / "a.mcap", tmp_path / "c.mcap", code=4)
    assert "from step 0 (0 s) on, first in env 0: env/observation_at[0]: " in " ".join(other.stdout.split())
    assert "unknown and" not in other.stdout
    curves = call("gsb-view", tmp_path / "a.mcap", "--no-open", "--out", tmp_path / "view.html", code=0)
    assert "shows rewards, actions and observations as curves" in " ".join(curves.stderr.split())
    found = call("gsb-eval", tmp_path / "a.mcap", tmp_path / "b.mcap", code=0)
    assert found.stdout.startswith("gymnasium: all 2 runs are bit-identical")
    whole = [tmp_path / f"{name}.mcap" for name in "ac"]
    call("gsb-eval", *whole, "--html", tmp_path / "page", "--tables", tmp_path / "tables", "--format", "csv", code=0)
    other_counts = count_episodes(open_recording(whole[1]))
    rows = list(csv.reader((tmp_path / "tables" / "episodes.csv").read_text(encoding="utf-8").splitlines()))
    assert {row[2] for row in rows[1:]} == {"120"}
    assert {row[3] for row in rows[1:]} == {str(counts.ended), str(other_counts.ended)}
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert f"{counts.ended + other_counts.ended} episodes ended" in page
    assert f"{counts.mean_return:.4g}" in page
    everything = call("gsb-eval", tmp_path / "a.mcap", tmp_path / "b.mcap", "--all").stdout
    assert "seeds and actions of environments differ by design" in " ".join(everything.split())
    assert call("gsb-check", *sorted(tmp_path.glob("*.mcap"))).returncode == 0


def test_episodes_of_other_recordings(small: Path) -> None:
    """Count none where nothing of that kind was recorded."""
    assert count_episodes(open_recording(small)) is None
    assert json.loads(call("gsb-info", small, "--json", "-").stdout)["files"][0]["episodes"] is None


def test_episodes_of_a_file_that_was_cut_short(tmp_path: Path) -> None:
    """Count what is there, wherever the file ends."""
    played(tmp_path / "whole.mcap", 2, 4, "SameStep", 300)
    whole = (tmp_path / "whole.mcap").read_bytes()
    complete = [said(episode) for episode in episodes(open_recording(tmp_path / "whole.mcap"))]
    found = []
    for tenths in (3, 5, 7):
        path = tmp_path / f"{tenths}.mcap"
        path.write_bytes(whole[: len(whole) * tenths // 10])
        recording = open_recording(path)
        assert recording.status == "incomplete"
        counts = count_episodes(recording)
        found.append(counts.steps)
        part = [said(episode) for episode in episodes(recording)]
        assert sum(len(one["rewards"]) for one in part) == counts.steps
        ended = [one for one in part if any(one["ended"])]
        assert all(one in complete for one in ended)
        assert "not read" not in call("gsb-info", path, "--all").stdout
    assert found == sorted(found) and 0 < found[-1] < 600


@pytest.mark.parametrize("numbers", [[0, 7, 7, 7], [0, -1, 0, 0], [0, 0.5, 0, 0], [0, np.inf, 0, 0]])
def test_episodes_that_cannot_be(numbers: list[float], tmp_path: Path) -> None:
    """Refuse numbers of episodes that no environment has; the rest of the file is still shown."""
    ones = np.ones((4, 1), dtype=np.float64)
    with RecordingWriter(
        tmp_path / "a.mcap", simulator="mine", version="1", scene="task", n_env=1, dt=0.1, steps=3,
        fields=[array_field(name, "float64") for name in NEEDED],
    ) as log:  # fmt: skip
        log.append(*(np.array(numbers, dtype=np.float64)[:, None] if name == "episode" else ones for name in NEEDED))
    with pytest.raises(DamagedRecording, match="not numbered from 0 on"):
        count_episodes(open_recording(tmp_path / "a.mcap"))
    shown = call("gsb-info", tmp_path / "a.mcap").stdout
    assert "episodes are not numbered from 0 on" in " ".join(shown.split())


def test_an_observation_that_is_not_finite(tmp_path: Path) -> None:
    """Name the array that a user looks at, and not the copy of it from before a reset."""
    envs = wrap(gymnasium.vector.SyncVectorEnv([lambda: Breaking(99)] * 2), tmp_path / "x.mcap")
    play(envs, 5)
    envs.close()
    found = open_recording(tmp_path / "x.mcap")
    assert (found.status, found.reason) == ("invalid", "a state is not finite: step 3, env 0, env/observation_at")
