"""gsb-replay: recorded actions, fed open loop to environments that are made again."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import UsageError, open_recording, wrap
from gpusimbench.evaluator.read.episodes import At, Episode, episodes
from gpusimbench.evaluator.replays.comparison import compare
from gpusimbench.evaluator.replays.document import verdict as sentence
from gpusimbench.evaluator.replays.document import warnings
from gpusimbench.evaluator.replays.verdict import EpisodeVerdict, judge
from gpusimbench.evaluator.statistics.cases import wilson
from gpusimbench.recorder.vector.open_loop import replay
from gpusimbench.recorder.vector.origin import GivenEpisode
from gpusimbench.replay.origin import given, origin_of
from gpusimbench.replay.parts import infos_of, parts_of, seed_of
from tests.conftest import call, made_once, run_python
from tests.recorder.test_wrap import MODES, acted, play, walks

gymnasium = pytest.importorskip("gymnasium")

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
_STEPS = 40


def record(task: str, path: Path, *, n_env: int = 2, seed: Any = 3, nudged: int | None = None, **keywords: Any) -> None:
    """Drawn actions; that of step `nudged` is one unit in the last place larger in its first number."""
    envs = wrap(gymnasium.make_vec(task, num_envs=n_env, **keywords), path, steps=_STEPS)
    envs.reset(seed=seed)
    envs.action_space.seed(3)
    for step in range(1, _STEPS + 1):
        action = envs.action_space.sample()
        if step == nudged:
            action[0, 0] = np.nextafter(action[0, 0], np.inf)
        envs.step(action)
    envs.close()


def recording_of(task: str) -> Path:
    """Of episodes of at most 15 steps, made once; must not be written to."""
    name = f"replayed-{task}"
    return made_once(name, lambda at: record(task, at / "a.mcap", max_episode_steps=15)) / "a.mcap"


def replayed(path: Path, tmp_path: Path, *arguments: object, code: int) -> dict[str, Any]:
    """What gsb-replay says of it, as JSON."""
    made = tmp_path / "replay.mcap"
    made.unlink(missing_ok=True)
    out = () if "--against" in arguments else ("--out", made)
    return json.loads(call("gsb-replay", path, "--json", "-", *out, *arguments, code=code).stdout)


def counts(found: dict[str, Any]) -> dict[str, int]:
    """Episodes by verdict, those that there are."""
    return {one["verdict"]: one["episodes"] for one in found["shares"] if one["episodes"]}


@pytest.mark.parametrize("task", ["Reacher-v5", "CartPole-v1", "HalfCheetah-v5", "Hopper-v5"])
def test_the_same_version_replays_bit_for_bit(task: str, tmp_path: Path) -> None:
    """Replay every episode of tasks with and without contacts, and of a vector environment of the task's own."""
    path = recording_of(task)
    found = replayed(path, tmp_path, code=0)
    n = len(list(episodes(open_recording(path))))
    assert n >= 6 and counts(found) == {"bit-identical": n}
    assert found["shares"][0]["ci95"] == list(wilson(n, n))
    assert found["began_otherwise"] == 0
    (tmp_path / "again").mkdir()
    again = replayed(tmp_path / "replay.mcap", tmp_path / "again", code=0)  # one whose user resets it
    assert set(counts(again)) == {"bit-identical"}


def test_another_option_is_another_outcome(tmp_path: Path) -> None:
    """Say from which step on bits differ, and at which step the outcome leaves the original."""
    found = replayed(recording_of("HalfCheetah-v5"), tmp_path, "--set", "frame_skip=4", code=4)
    assert counts(found).get("other outcome", 0) >= 4 and "bit-identical" not in counts(found)
    for one in found["episodes"]:
        assert one["began_alike"] and (one["first"]["step"], one["first"]["env"]) == (1, one["env"])
        assert one["verdict"] != "other outcome" or 1 <= one["left_at"] <= one["steps"][0]
    assert {"options.env_kwargs"} == {one["name"] for one in found["settings"]}
    shown = call("gsb-replay", recording_of("HalfCheetah-v5"), "--against", tmp_path / "replay.mcap", code=4).stdout
    assert "end with another outcome in the replay" in shown and '"frame_skip": 4' in shown


@pytest.mark.parametrize("task", ["Reacher-v5", "HalfCheetah-v5"])
def test_one_unit_in_the_last_place_of_an_action(task: str, tmp_path: Path) -> None:
    """Name the action that differs, and the step; without contacts the outcome stays the same."""
    record(task, tmp_path / "nudged.mcap", nudged=7, max_episode_steps=15)
    found = replayed(recording_of(task), tmp_path, "--against", tmp_path / "nudged.mcap", code=4)
    (first,) = [one for one in found["episodes"] if one["verdict"] != "bit-identical"][:1]
    assert (first["env"], first["number"], first["first"]["step"]) == (0, 0, 7)
    assert first["first"]["number"]["field"] == "action" and first["first"]["number"]["ulp"] == 1
    if task == "Reacher-v5":
        assert counts(found) == {"bit-identical": 5, "same outcome": 1}
        assert 0 < first["largest"]["distance"] < 1e-3
        replayed(
            recording_of(task), tmp_path, "--against", tmp_path / "nudged.mcap", "--require", "same-outcome", code=0
        )
        shown = call("gsb-replay", recording_of(task), "--against", tmp_path / "nudged.mcap", code=4).stdout
        assert "step 7 of episode 0 of env 0: action[0]: 1 ULP" in shown


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("again", MODES)
def test_modes(mode: str, again: str, tmp_path: Path) -> None:
    """Feed what one autoreset mode recorded to environments of another: the same episodes, bit for bit."""
    envs = wrap(walks(3, 4, mode), tmp_path / "a.mcap", steps=_STEPS)
    play(envs, _STEPS, [5, 99, 2])
    envs.close()
    original = open_recording(tmp_path / "a.mcap")
    parts, seed = parts_of(original), seed_of(original)
    assert seed == [5, 99, 2]
    replay(walks(3, 4, again), tmp_path / "b.mcap", parts, seed=seed, dt=original.configuration.dt)
    there = {(one.env, one.number): one for one in episodes(open_recording(tmp_path / "b.mcap"))}
    found = [judge(one, there.get((one.env, one.number)), None, 0.0) for one in episodes(original)]
    assert len(found) > 3 * _STEPS / 5 and {one.verdict for one in found} == {EpisodeVerdict.IDENTICAL}
    assert open_recording(tmp_path / "b.mcap").status == "complete"


def test_episodes_that_their_user_cut(tmp_path: Path) -> None:
    """Reset where the user did, in the middle of episodes."""
    envs = wrap(walks(3, 9, "Disabled"), tmp_path / "a.mcap", steps=_STEPS)
    observation, _ = envs.reset(seed=1)
    cut = np.random.default_rng(0).random((_STEPS, 3)) < 0.3
    for mask in cut:
        observation, _, terminated, truncated, _ = envs.step(acted(observation))
        if (over := mask | terminated | truncated).any():
            observation, _ = envs.reset(options={"reset_mask": over})
    envs.close()
    original = open_recording(tmp_path / "a.mcap")
    replay(walks(3, 9, "Disabled"), tmp_path / "b.mcap", parts_of(original), seed=1, dt=0.1)
    there = {(one.env, one.number): one for one in episodes(open_recording(tmp_path / "b.mcap"))}
    found = [judge(one, there.get((one.env, one.number)), None, 0.0) for one in episodes(original)]
    assert sum(one.ends[0] == "cut" for one in found) > 5
    assert {one.verdict for one in found} == {EpisodeVerdict.IDENTICAL}
    replay(walks(3, 9, "NextStep"), tmp_path / "c.mcap", parts_of(original), seed=1, dt=0.1)  # which nobody can cut
    there = {(one.env, one.number): one for one in episodes(open_recording(tmp_path / "c.mcap"))}
    lost = [judge(one, there.get((one.env, one.number)), None, 0.0).verdict for one in episodes(original)]
    assert EpisodeVerdict.ABSENT in lost and lost[0] is EpisodeVerdict.IDENTICAL


def test_another_seed_is_named(tmp_path: Path) -> None:
    """Say that episodes began otherwise where no seed was recorded."""
    record("Reacher-v5", tmp_path / "a.mcap", seed=None, max_episode_steps=15)
    found = replayed(tmp_path / "a.mcap", tmp_path, code=4)
    assert found["began_otherwise"] == len(found["episodes"]) == 6
    assert any("began with another observation" in one for one in found["warnings"])


@pytest.mark.parametrize("mode", MODES)
def test_recorded_physics_replaces_a_seed(mode: str, tmp_path: Path) -> None:
    """Begin each episode in the recorded state of MuJoCo, where no seed was given."""
    vector = {"autoreset_mode": gymnasium.vector.AutoresetMode(mode)}
    made = gymnasium.make_vec("Hopper-v5", num_envs=3, max_episode_steps=15, vector_kwargs=vector)
    envs = wrap(made, tmp_path / "a.mcap", steps=_STEPS, physics=True)
    envs.reset()
    envs.action_space.seed(3)
    for _ in range(_STEPS):
        _, _, terminated, truncated, _ = envs.step(envs.action_space.sample())
        if mode == "Disabled" and (over := terminated | truncated).any():
            envs.reset(options={"reset_mask": over})
    envs.close()
    recording = open_recording(tmp_path / "a.mcap")
    seen, qpos = (recording.state("env", name)[:, :, 0] for name in ("observation", "physics_qpos"))
    assert (seen[..., :5] == qpos[..., 1:]).all()  # Hopper's observation begins with the joint positions but the first
    found = replayed(tmp_path / "a.mcap", tmp_path, code=0)
    assert set(counts(found)) == {"bit-identical"} and len(found["episodes"]) >= 8
    with pytest.raises(UsageError, match="MuJoCo tasks"):
        wrap(walks(2, 4, mode), tmp_path / "b.mcap", steps=1, physics=True)


def test_a_function_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Import the named module from the present folder, and nothing that a file names."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = tmp_path / "a.mcap"
    envs = wrap(walks(2, 4, "SameStep"), path, steps=_STEPS)
    play(envs, _STEPS, 5)
    envs.close()
    (tmp_path / "my_walks.py").write_text(
        "from tests.recorder.test_wrap import walks\n\n\ndef make(n_env):\n    return walks(n_env, 4, 'NextStep')\n"
    )
    done = call("gsb-replay", path, "--make", "my_walks:make", code=0, cwd=tmp_path)
    assert "replay bit for bit" in done.stdout and (tmp_path / "a-replay.mcap").exists()
    assert "a-replay.mcap exists" in call("gsb-replay", path, "--make", "my_walks:make", code=2, cwd=tmp_path).stderr
    assert "give --env, or --make" in call("gsb-replay", path, "--out", "b.mcap", code=2, cwd=tmp_path).stderr
    (tmp_path / "my_odds.py").write_text("import sys\n\nfive = sys.exit\n\n\ndef none(n_env):\n    pass\n")
    for made, said in (
        ("my_walks:nothing", "failed: AttributeError"),
        ("my_odds:five", "failed: SystemExit: 2"),
        ("my_odds:none", "made NoneType, and no VectorEnv"),
    ):
        failed = call("gsb-replay", path, "--make", made, "--out", "b.mcap", code=2, cwd=tmp_path).stderr
        assert f"--make {made} {said}" in failed
    for name in ("my_walks", "my_odds"):
        sys.modules.pop(name)


def test_a_task_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Import the module before an id from the present folder, as --make does."""
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", str(tmp_path))])
    (tmp_path / "my_tasks.py").write_text(
        "import gymnasium\n\ngymnasium.register('Mine-v0', 'gymnasium.envs.mujoco.half_cheetah_v5:HalfCheetahEnv')\n"
    )
    path = recording_of("HalfCheetah-v5")
    try:
        task = ("--env", "my_tasks:Mine-v0", "--set", "max_episode_steps=15")
        done = call("gsb-replay", path, *task, "--out", "b.mcap", code=0, cwd=tmp_path)
    finally:
        gymnasium.registry.pop("Mine-v0", None)
        sys.modules.pop("my_tasks", None)
    assert "replaying in 2 environments my_tasks:Mine-v0" in done.stderr
    assert "replay bit for bit" in done.stdout


def test_what_cannot_be_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Say in a line what is wrong: other actions, no such keyword, an environment that fails, no episodes."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = recording_of("HalfCheetah-v5")

    def complaint(*arguments: object, code: int) -> str:
        said = call("gsb-replay", *arguments, "--out", "b.mcap", code=code, cwd=tmp_path).stderr
        return next(line for line in reversed(said.splitlines()) if line.startswith("gsb-replay: "))

    assert "the environment takes action of shape (3,), and 6 numbers" in complaint(path, "--env", "Hopper-v5", code=2)
    assert "Hopper-v5 cannot be made" in complaint(recording_of("Hopper-v5"), "--set", "legs=2", code=2)
    unknown = complaint(path, "--env", "Nothing-v0", code=2)
    assert "Nothing-v0 cannot be made" in unknown
    assert unknown.endswith("; for a task that your program registers, give --make MODULE:FUNCTION")
    (tmp_path / "fails.py").write_text(
        "import gymnasium\n\n\nclass Fails(gymnasium.vector.VectorWrapper):\n    def step(self, actions):\n"
        "        raise RuntimeError('no power')\n\n\ndef make(n_env):\n"
        "    return Fails(gymnasium.make_vec('HalfCheetah-v5', num_envs=n_env))\n"
    )
    assert "the environment failed: RuntimeError: no power" in complaint(path, "--make", "fails:make", code=1)
    sys.modules.pop("fails")
    failed = open_recording(tmp_path / "b.mcap")  # which says why, and stays
    assert (failed.status, failed.reason) == ("failed", "RuntimeError: no power")
    begun = failed.path.rename(tmp_path / "begun.mcap")
    assert "begun.mcap has no step of an episode" in complaint(begun, code=5)
    assert "gsb-audit replays runs of gsb-record" in complaint(next(RECORDINGS.glob("*.mcap")), code=5)
    assert "--episodes is of data sets" in complaint(path, "--episodes", 3, code=2)
    assert "--set is of environments of Gymnasium" in complaint(path, "--make", "a:b", "--set", "c=1", code=2)
    refused = call("gsb-replay", path, "--against", path, "--set", "c=1", code=2).stderr
    assert "--against replays nothing" in refused


def test_nothing_of_a_file_is_executed(tmp_path: Path) -> None:
    """Refuse ids with a module, and keywords that may name files, until the user names them."""

    class Foreign:
        path = "theirs.mcap"

        class configuration:  # noqa: N801
            options = {"env_id": "their_module:Task-v0", "env_kwargs": "{}"}  # noqa: RUF012

    with pytest.raises(UsageError, match="give --env, or --make"):
        origin_of(Foreign, None, {})  # type: ignore[arg-type]
    assert "their_module" not in sys.modules
    Foreign.configuration.options = {"env_id": "Hopper-v5", "env_kwargs": json.dumps({"a": [{"xml_file": "/x.xml"}]})}
    with pytest.raises(UsageError, match="keyword a of theirs.mcap may name a file"):
        origin_of(Foreign, None, {})  # type: ignore[arg-type]
    assert origin_of(Foreign, None, {"a": 1}).keywords == {"a": 1}  # type: ignore[arg-type]
    Foreign.configuration.options = {"env_id": "Hopper-v5", "env_kwargs": "{}", "env_wrappers": "Clip"}
    with pytest.raises(UsageError, match="recorded with the wrappers Clip"):
        origin_of(Foreign, None, {})  # type: ignore[arg-type]


def test_keywords_that_users_give() -> None:
    """Read JSON where a value is that, and a text otherwise."""
    assert given(["a=1", "b=false", "c=pole.xml", 'd="1"']) == {"a": 1, "b": False, "c": "pole.xml", "d": "1"}
    with pytest.raises(UsageError, match="NAME=VALUE"):
        given(["1=2"])


def episode(rewards: Any, *, terminated: bool = True, seen: Any = 0.0) -> Episode:
    """Of one observation, which is the same at all steps but the last."""
    rewards = np.asarray(rewards, dtype=np.float64)
    observations = np.zeros((len(rewards) + 1, 1))
    observations[-1] = seen
    return Episode(0, 0, {"observation": observations}, {}, rewards, terminated, False)


def test_what_counts_as_the_same_outcome() -> None:
    """Compare return up to the tolerance, length, end and success; name the step at which the outcome leaves."""
    one = episode([1.0, -1.0, 2.0])  # absolute rewards sum to 4
    cases = {
        (1.0, -1.0, 2.0): (EpisodeVerdict.IDENTICAL, None),
        (1.0, -1.0, 2.04): (EpisodeVerdict.SAME, None),
        (1.0, -1.0, 2.05): (EpisodeVerdict.OTHER, 3),
        (1.5, -1.0, 2.05): (EpisodeVerdict.OTHER, 1),
        (1.0, -1.0): (EpisodeVerdict.OTHER, 2),
        (1.0, -1.0, 2.0, 0.0): (EpisodeVerdict.OTHER, 3),
    }
    for rewards, (verdict, left_at) in cases.items():
        found = judge(one, episode(rewards), None, 0.0101)
        assert (found.verdict, found.left_at) == (verdict, left_at), rewards
    assert judge(one, episode(one.rewards, terminated=False), None, 1.0).left_at == 3
    assert judge(one, episode(one.rewards), (True, False), 1.0).verdict is EpisodeVerdict.OTHER
    assert judge(one, episode(one.rewards, seen=1e-9), (True, True), 0.0).verdict is EpisodeVerdict.SAME
    assert judge(one, episode(one.rewards, seen=np.nan), None, 0.0).verdict is EpisodeVerdict.SAME
    assert judge(one, None, None, 1.0).verdict is EpisodeVerdict.ABSENT
    cut = episode([1.0, -1.0], terminated=False)  # by the end of the recording: its steps alone count
    assert judge(cut, episode([1.0, -1.0, 2.0]), None, 0.0).verdict is EpisodeVerdict.IDENTICAL
    assert judge(cut, episode([1.0]), None, 0.0).verdict is EpisodeVerdict.OTHER


class _Late(gymnasium.Env[Any, Any]):
    """A task that succeeds at its fifth step, and ends never."""

    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin again."""
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Count."""
        self.steps += 1
        return np.full(1, self.steps / 100, np.float32), 1.0, False, False, {"success": self.steps >= 5}


@pytest.mark.parametrize("at", At)
def test_of_an_episode_that_was_cut_the_recorded_steps_alone_count(tmp_path: Path, at: At) -> None:
    """Hold no success of a longer replay against an episode that was recorded up to its third step, and say that the
    episodes did not end."""
    for name, steps in (("a", 3), ("b", 6)):
        made = gymnasium.vector.SyncVectorEnv([_Late] * 2)
        envs = wrap(made, tmp_path / f"{name}.mcap", steps=steps, dt=0.1, infos=["success"])
        envs.reset(seed=0)
        for _ in range(steps):
            envs.step(np.zeros((2, 1), np.float32))
        envs.close()
    original, longer = (open_recording(tmp_path / f"{name}.mcap") for name in "ab")
    found = compare(original, longer, success="success", at=at, tolerance=0.0)
    assert {one.verdict for one in found.episodes} == {EpisodeVerdict.IDENTICAL}
    assert sentence(found) == "All 2 episodes, as far as recorded, replay bit for bit."
    assert "2 episodes of the original have no end" in " ".join(warnings(found))
    found = compare(longer, longer, success="success", at=at, tolerance=0.0)
    assert {one.success for one in found.episodes} == {(True, True)}


def test_infos_of_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Record the infos that the original has, and hold successes against each other."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    from tests.scripts import example

    search = example("search")
    search.record("near", tmp_path / "a.mcap", 8, 2, 0)
    assert infos_of(open_recording(tmp_path / "a.mcap")) == ("success",)
    (tmp_path / "searches.py").write_text(
        "import gymnasium\n\nfrom tests.scripts import example\n\n\ndef make(n_env):\n"
        "    return gymnasium.vector.SyncVectorEnv([example('search').Search] * n_env)\n"
    )
    arguments = ("--make", "searches:make", "--json", "-")
    done = call("gsb-replay", tmp_path / "a.mcap", *arguments, code=0, cwd=tmp_path)
    found = json.loads(done.stdout)["episodes"]
    assert {tuple(one["success"]) for one in found} == {(True, True), (False, False)}
    sys.modules.pop("searches")


def test_what_cannot_work_is_said_before_it_is_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a flag that was not recorded, or that is not given in the first step, and a folder that is not there."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    from tests.scripts import example

    example("search").record("near", tmp_path / "a.mcap", 8, 2, 0)
    (tmp_path / "silent.py").write_text(
        "import gymnasium\n\nfrom tests.scripts import example\n\n\nclass Silent(example('search').Search):\n"
        "    def step(self, action):\n        return *super().step(action)[:4], {}\n\n\ndef make(n_env):\n"
        "    print('made')\n    return gymnasium.vector.SyncVectorEnv([Silent] * n_env)\n"
    )
    given = ("a.mcap", "--make", "silent:make")
    done = call("gsb-replay", *given, "--success", "nothing", code=2, cwd=tmp_path)
    assert "has no info nothing; it has success" in done.stderr and "made" not in done.stdout
    done = call("gsb-replay", *given, "--out", "none/b.mcap", code=2, cwd=tmp_path)
    assert "none/b.mcap is in no folder that exists" in done.stderr and "made" not in done.stdout
    done = call("gsb-replay", *given, code=2, cwd=tmp_path)
    assert "the environment gives no info success, which was recorded from the first step on" in done.stderr
    assert sorted(path.name for path in tmp_path.glob("*.mcap*")) == ["a.mcap"]
    sys.modules.pop("silent")


def test_actions_of_another_kind(tmp_path: Path) -> None:
    """Say in a sentence that a task takes other actions, and leave no file."""
    for task, path in (("MountainCarContinuous-v0", "real.mcap"), ("MountainCar-v0", "three.mcap")):
        envs = wrap(gymnasium.make_vec(task, num_envs=2, vectorization_mode="sync"), tmp_path / path, steps=9)
        envs.reset(seed=0)
        envs.action_space.seed(0)
        for _ in range(9):
            envs.step(envs.action_space.sample())
        envs.close()
    cases = {
        "real.mcap": "the environment takes integers as action, and real numbers were recorded",
        "three.mcap": "the environment has no action ",
    }
    for path, said in cases.items():
        done = call("gsb-replay", path, "--env", "CartPole-v1", code=2, cwd=tmp_path)
        assert said in done.stderr and "Error" not in done.stderr
    assert len(list(tmp_path.glob("*"))) == 2


def test_parts_have_a_length() -> None:
    """Count the actions of an episode."""
    assert len(GivenEpisode({"action": np.zeros((4, 2))})) == 4


def test_without_gymnasium_a_sentence_says_what_is_needed(tmp_path: Path) -> None:
    """Name what to install where Gymnasium is not there."""
    file = Path(__file__).parents[1] / "recordings" / "mujoco-amd-r0.mcap"
    script = (
        "import sys; sys.modules['gymnasium'] = None; from gpusimbench.replay.cli import main; "
        f"sys.exit(main([{str(file)!r}, '--out', {str(tmp_path / 'out.mcap')!r}]))"
    )
    done = run_python(script, code=2)
    assert done.stderr.strip().endswith("replaying needs Gymnasium: pip install 'gymnasium[mujoco]'")
