"""gsb-episodes: as many episodes of every environment, and what stopping at the first finished ones would have said."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gpusimbench import NothingComparable, open_recording, wrap
from gpusimbench.evaluator.cli.episodes import main as episodes
from gpusimbench.evaluator.episodes import clusters, dependence, document
from gpusimbench.evaluator.episodes.comparison import compare, difference_of
from gpusimbench.evaluator.episodes.document import warnings
from gpusimbench.evaluator.episodes.outcome import FinishOrder, Outcome, outcome, profiles
from gpusimbench.evaluator.episodes.side import Choice, Episodes, choose, read_side, with_common_clusters
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.episodes import At
from gpusimbench.evaluator.statistics.cases import mcnemar, rate_interval, wilson
from gpusimbench.recorder.vector.device.log import About, HostLog
from gpusimbench.recorder.vector.modes import Mode
from tests.conftest import call, made_once
from tests.scripts import ROOT, example, script

gymnasium = pytest.importorskip("gymnasium")
search = example("search")
TRUTH = search.TRIES / search.PLACES


def recording_of(policy: str, n_env: int, per_env: int, seed: int = 0) -> Path:
    """A recording of that many episodes per environment at least, made once; must not be written to."""
    name = f"search-{policy}-{n_env}-{per_env}-{seed}"
    folder = made_once(name, lambda at: search.record(policy, at / f"{name}.mcap", n_env, per_env, seed))
    return folder / f"{name}.mcap"


def episodes_of(*paths: Path, per_env: int, at: At = At.LAST) -> Episodes:
    """Their first episodes."""
    return choose(read_side(list(map(open_recording, paths))), per_env, "success", at)


def outcome_of(*paths: Path, per_env: int) -> Outcome:
    """What they come to."""
    return outcome(episodes_of(*paths, per_env=per_env), Choice.GIVEN, "success", At.LAST)


def finish_orders(of: Outcome) -> dict[str, FinishOrder]:
    """What stopping early would have said, by quantity."""
    return {quantity.name: quantity.finish_order for quantity in of.quantities}


def stepped_alone(policy: str, env: int, per_env: int, seed: int) -> list[tuple[bool, int]]:
    """Successes and lengths of the first episodes of an environment that is stepped without others."""
    task, found = search.Search(), []
    for number in range(per_env):
        observation, _ = task.reset(seed=seed + env if number == 0 else None)
        ended = False
        while not ended:
            (action,) = search.POLICIES[policy](observation[None])
            observation, _, terminated, truncated, info = task.step(action)
            ended = terminated or truncated
        found.append((info["success"], task.tries))
    return found


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_episodes_are_those_of_each_environment(mode: str, tmp_path: Path) -> None:
    """Take the first episodes of every environment as it goes through them alone, in each autoreset mode."""
    vector = gymnasium.vector.SyncVectorEnv([search.Search] * 5, autoreset_mode=gymnasium.vector.AutoresetMode(mode))
    envs = wrap(vector, tmp_path / "a.mcap", steps=40, infos=("success",))
    observation, _ = envs.reset(seed=3)
    for _ in range(40):
        observation, _, terminated, truncated, _ = envs.step(search.near(observation))
        if mode == "Disabled" and (terminated | truncated).any():
            observation, _ = envs.reset(options={"reset_mask": terminated | truncated})
    envs.close()
    found = episodes_of(tmp_path / "a.mcap", per_env=3)
    truth = [stepped_alone("near", env, 3, 3) for env in range(5)]
    assert found.success.tolist() == [[success for success, _ in env] for env in truth]
    assert found.lengths.tolist() == [[length for _, length in env] for env in truth]
    assert (found.returns == -found.lengths).all() and (found.terminated == found.success).all()


def test_stopping_early_is_biased_by_the_number_of_environments() -> None:
    """Of 64 episodes, the first to finish succeed the more often the more environments there are; ours do not."""
    rates = []
    for n_env, seed in ((64, 0), (64, 100), (64, 200), (64, 300), (1, 0)):
        of = outcome_of(recording_of("sweep", n_env, 64 // n_env, seed), per_env=64 // n_env)
        assert of.episodes == 64
        rates.append((of.quantities[0].mean, finish_orders(of)["success"].mean))
    assert rates[-1][0] == rates[-1][1]  # one environment finishes its episodes in order
    ours, early = np.mean(rates[:-1], axis=0)
    error = (TRUTH * (1 - TRUTH) / 256) ** 0.5
    assert abs(ours - TRUTH) < 3 * error
    assert early > TRUTH + 4 * error


def test_a_bias_is_said() -> None:
    """Warn of the mean over the first to finish where it is off, and by how much; of none where it is not."""
    of = outcome_of(recording_of("sweep", 64, 1), per_env=1)
    early = finish_orders(of)["success"]
    assert early.biased and early.difference == pytest.approx(early.mean - of.quantities[0].mean)
    assert not isinstance(early.ci95, Missing)
    assert 0 < early.ci95[0] < early.difference < early.ci95[1]
    said = " ".join(warnings(of))
    assert f"finished first is {100 * early.mean:.1f} %, off by +{100 * early.difference:.1f} pp" in said
    long = outcome_of(recording_of("sweep", 16, 1), recording_of("sweep", 16, 1, 50), per_env=1)
    assert long.n_env == 32 and len(long.files) == 2
    alone = outcome_of(recording_of("sweep", 1, 64), per_env=64)
    assert not any(one.biased for one in finish_orders(alone).values())
    assert isinstance(finish_orders(alone)["success"].ci95, Missing)


def test_what_a_reader_gets(tmp_path: Path) -> None:
    """Print the number of episodes, both quantities and what is visible; the same as JSON."""
    path = recording_of("sweep", 64, 4)
    target = tmp_path / "found.json"
    shown = call("gsb-episodes", path, "--per-env", 3, "--success", "success", "--json", target, code=0).stdout
    policy = json.loads(target.read_text())["policy"]
    lost = policy["n_left_out"]
    assert f"192: the first 3 of each of 64 environments; {lost} finished episodes are left out" in shown
    success, returned = policy["quantities"]
    counts = round(192 * success["mean"])
    low, high = wilson(counts, 192)
    assert success["ci95"][0] <= low < high <= success["ci95"][1]
    assert f"{100 * success['mean']:.1f} %" in shown and f"{returned['mean']:.4g}" in shown
    found = episodes_of(path, per_env=3)
    assert returned["iqm"] == pytest.approx(float(np.sort(found.returns.ravel())[48:144].mean()))
    assert returned["iqm_ci95"][0] < returned["iqm"] < returned["iqm_ci95"][1]
    by_env = found.returns.mean(axis=1)
    shown_with = stats.t.ppf(0.975, 126) + stats.t.ppf(0.8, 126)
    assert returned["least_shown"] == pytest.approx(shown_with * (2 * by_env.var(ddof=1) / 64) ** 0.5)
    assert policy["distinct_starts"] == 192 and policy["chosen"] == "given"
    largest = json.loads(call("gsb-episodes", path, "--json", "-", code=0).stdout)["policy"]
    assert (largest["per_env"], largest["chosen"]) == (4, "largest that every environment has")
    assert [one["name"] for one in largest["quantities"]] == ["return"]
    assert any("choose --per-env before you record" in one for one in largest["warnings"])


def test_too_few_episodes_are_refused(tmp_path: Path) -> None:
    """Say how many environments have too few, and which has the fewest; end with the code of nothing measured."""
    path = recording_of("near", 16, 2)
    finished = read_side([open_recording(path)]).finished
    asked = int(np.median(finished)) + 1
    said = call("gsb-episodes", path, "--per-env", asked, code=5).stderr
    assert f"{(finished < asked).sum()} of 16 environments have fewer than {asked} finished episodes" in said
    assert f"environment {finished.argmin()} of {path} has the fewest, {finished.min()}" in said
    assert f"at most {finished.min()}" in said
    assert "--per-env is at least 1" in call("gsb-episodes", path, "--per-env", 0, code=2).stderr
    short = wrap(gymnasium.vector.SyncVectorEnv([search.Search] * 2), tmp_path / "short.mcap", steps=2)
    observation, _ = short.reset(seed=1)
    for _ in range(2):
        observation, *_ = short.step(search.sweep(observation))
    short.close()
    assert "no episode of environment" in call("gsb-episodes", tmp_path / "short.mcap", code=5).stderr


def test_episodes_that_a_reset_cut_do_not_count(tmp_path: Path) -> None:
    """Count the episodes before the first that was cut: what came of it is not known."""
    modes = gymnasium.vector.AutoresetMode
    vector = gymnasium.vector.SyncVectorEnv([search.Search] * 3, autoreset_mode=modes.DISABLED)
    envs = wrap(vector, tmp_path / "a.mcap", steps=60)
    observation, _ = envs.reset(seed=0)
    for step in range(60):
        observation, _, terminated, truncated, _ = envs.step(np.full(3, 99))
        done = terminated | truncated
        if step == 29:  # in the middle of the third episode, of one environment
            done = np.array([False, True, False])
        if done.any():
            observation, _ = envs.reset(options={"reset_mask": done})
    envs.close()
    assert read_side([open_recording(tmp_path / "a.mcap")]).finished.tolist() == [5, 2, 5]


class Flagged(gymnasium.Env):  # type: ignore[misc,name-defined]
    """Episodes of three steps, with infos that say what the test wants of each step."""

    metadata = {"render_fps": 10}  # noqa: RUF012
    observation_space = gymnasium.spaces.Box(0, 9, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, infos: Sequence[dict[str, Any]]) -> None:
        self.infos = infos

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> Any:
        self.steps += 1
        return np.zeros(1, np.float32), 0.0, self.steps == 3, False, self.infos[self.steps - 1]


def flagged(path: Path, *infos: dict[str, Any]) -> Path:
    """A recording of two environments with these infos in each episode."""
    envs = wrap(gymnasium.vector.SyncVectorEnv([lambda: Flagged(infos)] * 2), path, steps=8, infos=("ok", "odd"))
    envs.reset(seed=0)
    for _ in range(8):
        envs.step(np.zeros(2, int))
    envs.close()
    return path


def test_performance_profiles() -> None:
    """Give the share of episodes above each threshold, the same thresholds for both policies, within its band."""
    sides = [episodes_of(recording_of(policy, 64, 4), per_env=4) for policy in ("near", "sweep")]
    found = profiles(sides)
    pooled = np.concatenate([side.returns.ravel() for side in sides])
    assert (found.thresholds[0], found.thresholds[-1]) == (pooled.min(), pooled.max())
    for side, profile in zip(sides, found.policies, strict=True):
        assert profile.share == tuple(float((side.returns > at).mean()) for at in found.thresholds)
        assert profile.low is not None and profile.high is not None
        assert all(low <= at <= high for low, at, high in zip(profile.low, profile.share, profile.high, strict=True))
        assert profile.share[-1] == 0 and profile.low[20] < profile.high[20]
    few = profiles([episodes_of(recording_of("sweep", 1, 64), per_env=64)]).policies[0]
    assert few.low is None and few.high is None and len(few.share) == len(found.thresholds)
    document = json.loads(call("gsb-episodes", recording_of("near", 64, 4), "--json", "-", code=0).stdout)
    assert len(document["profiles"]["policies"]) == 1


def test_where_success_counts(tmp_path: Path) -> None:
    """Count a flag at the last step, or at any; refuse what was not given, what is no flag, and what is not there."""
    passing = flagged(tmp_path / "passing.mcap", {"ok": True}, {"ok": True, "odd": 0.5}, {"ok": False})
    for at, rate in (("last", 0), ("any", 1)):
        document = json.loads(
            call("gsb-episodes", passing, "--success", "ok", "--success-at", at, "--json", "-", code=0).stdout
        )
        assert document["policy"]["quantities"][0]["mean"] == rate
    silent = flagged(tmp_path / "silent.mcap", {"ok": False}, {"ok": True}, {})
    said = call("gsb-episodes", silent, "--success", "ok", code=5).stderr
    assert "4 of 4 episodes" in said and "have no ok in the info of their last step" in said
    shown = call("gsb-episodes", silent, "--success", "ok", "--success-at", "any", code=0).stdout
    assert "100.0 %" in shown and "1 distinct first observations among 4 episodes" in " ".join(shown.split())
    said = call("gsb-episodes", passing, "--success", "odd", code=2).stderr
    assert "takes a flag; info_odd" in said and "is 0.5 in environment 0, row 2" in said
    said = call("gsb-episodes", passing, "--success", "won", code=2).stderr
    assert "has no info won; it has ok, odd" in said
    assert "100.0 %" in call("gsb-episodes", passing, "--success", "terminated", code=0).stdout


def test_policies_are_compared_by_pairs() -> None:
    """Pair episodes that began alike: McNemar's test for one of each environment, environments as units for several."""
    sides = [recording_of(policy, 64, 4) for policy in ("near", "sweep")]
    near, sweep = (episodes_of(path, per_env=1) for path in sides)
    found = compare(near, sweep)
    assert found.pairs.formed and found.pairs.pairs == 64
    success, returned = found.differences
    assert near.success is not None and sweep.success is not None
    both = np.array([near.success[:, 0], sweep.success[:, 0]])
    only = [int((both[0] & ~both[1]).sum()), int((~both[0] & both[1]).sum())]
    assert not isinstance(success.discordant, Missing)
    assert [success.discordant.only_first, success.discordant.only_second] == only
    assert success.test == "McNemar, exact" and success.p_value == mcnemar(*only)
    assert success.difference == pytest.approx((only[0] - only[1]) / 64)
    assert returned.adjusted_p >= returned.p_value and success.adjusted_p <= 2 * success.p_value + 1e-12
    several = compare(*(episodes_of(path, per_env=4) for path in sides))
    assert several.pairs.formed and several.pairs.pairs == 256
    better = several.differences[0]
    assert better.differs and better.difference > 0 and "environment" in better.test
    one = [difference.least_shown for difference in (success, better)]
    assert isinstance(one[0], float) and isinstance(one[1], float) and one[1] < one[0]


def test_policies_are_not_paired_where_episodes_began_otherwise() -> None:
    """Exchange whole environments between policies of other seeds or numbers of environments, and say so."""
    near = episodes_of(recording_of("near", 64, 4), per_env=4)
    for other in (recording_of("sweep", 64, 4, 900), recording_of("sweep", 16, 4)):
        found = compare(near, episodes_of(other, per_env=4))
        assert not found.pairs.formed
        success = found.differences[0]
        assert isinstance(success.discordant, Missing) and success.test.startswith("environments exchanged")
        assert not isinstance(success.ci95, Missing)
        assert success.ci95[0] < success.difference < success.ci95[1]
        assert 0 < success.p_value <= success.adjusted_p <= 1


def test_what_a_comparison_says(tmp_path: Path) -> None:
    """Begin with the verdict, and refuse a recording against itself, another task, and a recording without episodes."""
    near, sweep = recording_of("near", 64, 4), recording_of("sweep", 64, 4)
    shown = call("gsb-episodes", near, "--success", "success", "--per-env", 4, "--against", sweep, code=0).stdout
    assert re.match(r"success of the first policy is higher by [\d.]+ pp;", shown)
    assert "pp: percentage points." in shown
    assert "paired: the 256 pairs of the same environment and episode number began alike, bit for bit" in " ".join(
        shown.split()
    )
    same = tmp_path / "same.mcap"
    same.write_bytes(near.read_bytes())
    assert "are the same recording" in call("gsb-episodes", near, "--against", same, code=2).stderr
    other = flagged(tmp_path / "other.mcap", {}, {}, {})
    assert "one task is evaluated at a time" in call("gsb-episodes", near, "--against", other, code=2).stderr
    alike = call("gsb-episodes", near, "--against", recording_of("near", 64, 4, 900), "--per-env", 1, code=0).stdout
    assert "return: no difference can be told" in " ".join(alike.split())
    assert "0 of 64 pairs of the same environment and episode number began alike" in " ".join(alike.split())


def test_recordings_without_episodes(tmp_path: Path) -> None:
    """Refuse what has no episodes, and what ended before its time."""
    with pytest.raises(NothingComparable, match="has no episodes; gpusimbench.wrap records them"):
        read_side([open_recording(ROOT / "recordings" / "mujoco-amd-r0.mcap")])
    envs = wrap(gymnasium.vector.SyncVectorEnv([search.Search] * 2), tmp_path / "a.mcap", steps=99)
    envs.reset(seed=0)
    envs.step(np.zeros(2, int))
    envs.close()
    with pytest.raises(NothingComparable, match="is failed: states end at step 1 of 99"):
        read_side([open_recording(tmp_path / "a.mcap")])


def test_no_interval_of_what_never_differs(tmp_path: Path) -> None:
    """Give no interval of returns that are all the same: resampling them would claim that there can be no other."""
    task = gymnasium.vector.SyncVectorEnv([lambda: Flagged([{}] * 3)] * 9)
    envs = wrap(task, tmp_path / "a.mcap", steps=8)
    envs.reset(seed=0)
    for _ in range(8):
        envs.step(np.zeros(9, int))
    envs.close()
    document = json.loads(
        call("gsb-episodes", tmp_path / "a.mcap", "--success", "truncated", "--json", "-", code=0).stdout
    )
    success, returned = document["policy"]["quantities"]
    assert returned["ci95"] is None and returned["ci95_missing"] == "all environments have the same mean"
    assert returned["least_shown"] is None
    low, high = wilson(0, 18)
    assert success["ci95"] == [low, high] and high > 0.1


def test_what_depends_on_the_environment(tmp_path: Path) -> None:
    """Warn where environments, or the first and later episodes of all, differ by more than chance."""
    infos = [[{}, {}, {"ok": env % 2 == 0}] for env in range(10)]
    vector = gymnasium.vector.SyncVectorEnv([lambda told=told: Flagged(told) for told in infos])
    envs = wrap(vector, tmp_path / "a.mcap", steps=16, infos=("ok",))
    envs.reset(seed=0)
    for _ in range(16):
        envs.step(np.zeros(10, int))
    envs.close()
    found = outcome(
        choose(read_side([open_recording(tmp_path / "a.mcap")]), 4, "ok", At.LAST), Choice.GIVEN, "ok", At.LAST
    )
    success, returned = found.quantities
    assert success.mean == 0.5 and success.env_p == 0.001 and success.number_p == 1.0 and returned.env_p == 1.0
    assert "success depends on the environment (p = 0.001)" in " ".join(warnings(found))
    ordinary = outcome_of(recording_of("sweep", 64, 4), per_env=4).quantities[0]
    assert not isinstance(ordinary.env_p, Missing) and ordinary.env_p > 0.01


def test_the_page_shows_how_often_intervals_hold() -> None:
    """Draw again what the page shows of single episodes, which is quick."""
    making = script("make_episodes")
    ours, alone = making.held(64, 1, making.CORRELATIONS[0])
    assert ours == alone  # there is nothing to resample
    assert f"| 64 x 1 | {ours:.0%} ({alone:.0%}) | ".replace("%", " %") in making.PAGE.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_page_shows_what_both_rules_give() -> None:
    """Record again the recordings of 64 environments, and get the rates that the page shows."""
    making = script("make_episodes")
    assert making.row(64) in making.PAGE.read_text(encoding="utf-8")


def test_dependence_on_the_number_of_environments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tell no dependence of one policy; tell that of another policy under some numbers, and of which quantities."""
    small = [recording_of("sweep", 4, 4, seed) for seed in range(100, 116, 4)]
    large = recording_of("sweep", 64, 4)
    arguments = ["--success", "success", "--per-env", "4", "--across", "n_env"]
    assert episodes([*map(str, small), str(large), *arguments, "--json", str(tmp_path / "a.json")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "success: no dependence on the number of environments can be told" in said
    together = "recordings of 4, 64 environments are evaluated together; --across n_env tests whether results depend"
    assert together not in said
    assert episodes([*map(str, small), str(large), "--per-env", "4"]) == 0
    assert together in " ".join(capsys.readouterr().out.split())
    found = json.loads((tmp_path / "a.json").read_text())["across"]
    assert [(one["value"], one["policy"]["n_env"]) for one in found["settings"]] == [("4", 16), ("64", 64)]
    assert all(one["p_value"] > 0.05 and not one["depends"] for one in found["quantities"])
    other = recording_of("near", 16, 4, seed=300)
    assert episodes([str(other), str(large), *arguments, "--json", str(tmp_path / "b.json")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "return depends on the number of environments" in said
    first, second = (episodes_of(path, per_env=4) for path in (other, large))
    told = json.loads((tmp_path / "b.json").read_text())["across"]["quantities"]
    assert told[1]["largest"] == pytest.approx(abs(first.returns.mean() - second.returns.mean()))


@pytest.mark.slow
def test_the_test_of_dependence_has_its_level() -> None:
    """Reject in 5 % of draws where groups of other sizes are alike, and nearly always where a rate is another."""
    rng = np.random.default_rng(0)

    def p_value(*rates: float) -> float:
        groups = [rng.random((n_env, 2)) < rate for n_env, rate in zip((8, 24, 64), rates, strict=True)]
        return dependence._dependence("success", [one.mean(axis=1) for one in groups]).p_value

    draws = 60
    assert sum(p_value(0.6, 0.6, 0.6) <= 0.05 for _ in range(draws)) <= stats.binom.ppf(0.999, draws, 0.05)
    assert sum(p_value(0.6, 0.6, 0.9) <= 0.05 for _ in range(10)) >= 7


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--across", "n_env"], "all recordings have one n_env, 64: give recordings of two or more"),
        (["--across", "device", "--against", "b.mcap"], "leave --against out"),
    ],
)
def test_dependence_that_cannot_be_told(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse recordings of one value, and a second policy."""
    assert episodes([str(recording_of("sweep", 64, 4)), *words]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


def test_why_there_is_no_interval() -> None:
    """Say why a mean has no interval."""
    shown = " ".join(call("gsb-episodes", recording_of("near", 4, 4), code=0).stdout.split())
    assert "No interval of return: fewer than 8 environments." in shown
    assert "No interval" not in call("gsb-episodes", recording_of("near", 64, 4), code=0).stdout


def test_repeated_runs_count_once(tmp_path: Path) -> None:
    """Leave out recordings with the bits of another one: they would make intervals narrower and differences certain."""
    sides = {}
    for seed in (0, 900):
        sides[seed] = [tmp_path / f"{seed}-{run}.mcap" for run in range(6)]
        for path in sides[seed]:
            search.record("near", path, 8, 2, seed)
    document = json.loads(call("gsb-episodes", *sides[0], "--against", *sides[900], "--json", "-", code=0).stdout)
    alone = json.loads(call("gsb-episodes", sides[0][0], "--against", sides[900][0], "--json", "-", code=0).stdout)
    assert document["comparison"] == alone["comparison"]
    assert document["policy"]["quantities"] == alone["policy"]["quantities"]
    assert document["policy"]["repeats"] == [str(path) for path in sides[0][1:]] and alone["policy"]["repeats"] == []
    assert document["policy"]["warnings"][0].startswith("5 recordings left out, bit for bit the same")
    both = json.loads(call("gsb-episodes", sides[0][0], sides[900][0], "--json", "-", code=0).stdout)
    assert both["policy"]["n_env"] == 16 and both["policy"]["repeats"] == []


class Nearly(search.Search):  # type: ignore[misc,name-defined]
    """The task on an engine that does not repeat itself: numbers differ in their last bits from run to run."""

    noise = np.random.default_rng(0)

    def _seen(self) -> NDArray[np.float32]:
        return np.asarray(super()._seen() * (1 + 1e-6 * self.noise.normal()), dtype=np.float32)

    def step(self, action: int) -> Any:
        seen, reward, *rest = super().step(action)
        return seen, reward * (1 + 1e-6 * self.noise.normal()), *rest


class Alike(Nearly):
    """The same, but all environments begin alike, but for rounding."""

    def _seen(self) -> NDArray[np.float32]:
        return np.array([7 * (1 + 1e-6 * self.noise.normal()), self.tries], dtype=np.float32)


def nearly(path: Path, seed: int | None, n_env: int = 8, task: type[Nearly] = Nearly) -> Path:
    """A run of the policy "near" that no other run repeats bit for bit."""
    envs = wrap(gymnasium.vector.SyncVectorEnv([task] * n_env), path, steps=26, infos=("success",))
    observation, _ = envs.reset(seed=seed)
    for _ in range(26):
        observation, *_ = envs.step(search.near(observation))
    envs.close()
    return path


@pytest.mark.slow
def test_nearly_equal_runs_of_a_seed_are_one_cluster(tmp_path: Path) -> None:
    """Average runs of one seed by environment: ten runs a side make no difference of two seeds certain."""
    sides = [[nearly(tmp_path / f"{seed}-{run}.mcap", seed) for run in range(10)] for seed in (600, 800)]
    found = [episodes_of(*side, per_env=2) for side in sides]
    assert [(side.n_env, side.n_cluster) for side in found] == [(80, 8), (80, 8)]
    assert len(np.unique(found[0].starts)) > 100  # of 160: hardly any episode begins with the bits of another
    counted = difference_of("return", "", found[0].returns, found[1].returns, together=False)
    assert counted.p_value < 0.01  # what eighty environments a side would show
    command = ("--success", "success", "--per-env", "2", "--json", "-")
    document = json.loads(call("gsb-episodes", *sides[0], "--against", *sides[1], *command, code=0).stdout)
    alone = json.loads(call("gsb-episodes", sides[0][0], "--against", sides[1][0], *command, code=0).stdout)
    for ten, one in zip(*(of["comparison"]["differences"] for of in (document, alone)), strict=True):
        assert min(ten["p_value"], one["p_value"]) > 0.05
        assert np.ptp(ten["ci95"]) > 0.7 * np.ptp(one["ci95"])  # a third as wide, if eighty were counted
        assert ten["least_shown"] > 0.7 * one["least_shown"]
    for ten, one in zip(document["policy"]["quantities"], alone["policy"]["quantities"], strict=True):
        assert np.ptp(ten["ci95"]) > 0.7 * np.ptp(one["ci95"])
        assert np.ptp(ten["finish_order"]["ci95"]) > 0.7 * np.ptp(one["finish_order"]["ci95"])
    assert (document["policy"]["n_env"], document["policy"]["clusters"]) == (80, 8)
    told = "72 of 80 environments began as another one of their seed did: these repeats are averaged, so that 8 env"
    assert document["policy"]["warnings"][0].startswith(told)
    assert not any("began as another one" in warning for warning in alone["policy"]["warnings"])
    both = json.loads(call("gsb-episodes", *sides[0], *sides[1][:2], *command, code=0).stdout)["policy"]
    assert (both["n_env"], both["clusters"]) == (96, 16)
    mean = (found[0].returns.mean() + found[1].returns[:16].mean()) / 2
    assert both["quantities"][1]["mean"] == pytest.approx(mean)  # seeds count alike, however often recorded


def search_of_other_numbers(path: Path) -> Path:
    """A recording of a task that draws other numbers whatever the seed is."""

    class Deaf(search.Search):  # type: ignore[misc,name-defined]
        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            return super().reset(seed=None, options=options)

    envs = wrap(gymnasium.vector.SyncVectorEnv([Deaf] * 2), path, steps=13)
    observation, _ = envs.reset(seed=0)
    for _ in range(13):
        observation, *_ = envs.step(search.near(observation))
    envs.close()
    return path


def test_what_is_a_repeat(tmp_path: Path) -> None:
    """Join environments that have one seed and nearly one start, of overlapping seeds too; no others."""

    def found(*paths: Path) -> list[int]:
        return episodes_of(*paths, per_env=1).clusters.tolist()

    first, again = (nearly(tmp_path / f"{run}.mcap", 5, 3) for run in "ab")
    assert found(first, again, nearly(tmp_path / "c.mcap", 50, 3)) == [0, 1, 2, 0, 1, 2, 3, 4, 5]
    # seed + number seeds an environment of Gymnasium
    runs = [recording_of("near", 4, 1, seed) for seed in (20, 22)]
    assert found(*runs) == [0, 1, 2, 3, 2, 3, 4, 5]
    assert found(runs[0], recording_of("near", 2, 1, 20)) == [0, 1, 2, 3, 0, 1]
    assert found(*(nearly(tmp_path / f"none-{run}.mcap", None, 3) for run in range(2))) == [0, 1, 2, 3, 4, 5]
    # nearly equal starts of all environments tell none apart
    assert found(*(nearly(tmp_path / f"alike-{run}.mcap", None, 3, Alike) for run in range(2))) == [0, 1, 2, 3, 4, 5]
    fixed = [flagged(tmp_path / f"fixed-{run}.mcap", {}, {}, {}) for run in range(2)]
    assert choose(read_side(list(map(open_recording, fixed))), 1, None, At.LAST).clusters.tolist() == [0, 1, 0, 1]
    # a seed that the task ignores makes no repeats
    told = [open_recording(search_of_other_numbers(tmp_path / f"deaf-{run}.mcap")) for run in range(2)]
    assert choose(read_side(told), 1, None, At.LAST).clusters.tolist() == [0, 1, 2, 3]


def constant(path: Path, simulator: str, seed: int) -> Path:
    """A recording of two environments that always begin alike, of another simulator than Gymnasium maybe."""
    about = About(
        simulator=simulator, version="1", scene="constant", device="cpu", mode=Mode.DISABLED, hidden=False, options={},
        seed=seed,
    )  # fmt: skip
    rows = {
        "observation": np.zeros((2, 2, 1)),
        "action": np.zeros((2, 2, 1)),
        "reward": np.zeros((2, 2)),
        "terminated": np.array([[False] * 2, [True] * 2]),
        "truncated": np.zeros((2, 2), dtype=np.bool_),
    }
    log = HostLog(path, steps=1, dt=0.1, about=about)
    log.append(rows, {})
    log.end(None)
    return path


@pytest.mark.parametrize(("simulator", "joined"), [("gymnasium", [0, 1, 1, 2]), ("maniskill", [0, 1, 2, 3])])
def test_seeds_of_other_simulators_do_not_overlap(tmp_path: Path, simulator: str, joined: list[int]) -> None:
    """Take seed plus number for the seed of an environment in recordings of Gymnasium alone."""
    paths = [constant(tmp_path / f"{seed}.mcap", simulator, seed) for seed in (5, 6)]
    assert choose(read_side(list(map(open_recording, paths))), 1, None, At.LAST).clusters.tolist() == joined


def test_starts_of_any_size() -> None:
    """Compare starts that are zero, infinite, no numbers, or so large that their difference is infinite."""
    large = np.array([[3e38], [np.inf], [np.nan], [0.0], [3e38]], np.float32)
    other = np.array([[-3e38], [np.inf], [np.nan], [1e-6], [3e38]], np.float32)
    assert clusters._near({"observation": large}, {"observation": other}).tolist() == [False, True, True, True, True]
    assert not clusters._several({"observation": np.full((3, 2), np.nan)})


@pytest.mark.parametrize("step", [1.0, 0.2, 1 / 3])
def test_ties_count_whatever_the_returns_are(step: float) -> None:
    """Give returns of any size the p-values of the whole numbers that they stand for, whose sums are exact."""
    one, other = np.array([0, 1, 1, 0, 2.0]), np.array([1, 1, 0, 2, 2.0])

    def p_values(scale: float, shift: float) -> list[float]:
        first, second = scale * one + shift, scale * other + shift
        paired = [difference_of("", "", first[:, None], second[:, None], together=on).p_value for on in (False, True)]
        return [*paired, *(dependence._dependence("", [first, second], paired=on).p_value for on in (False, True))]

    whole = p_values(1.0, 0.0)
    assert min(whole) < 0.8
    for shift in (0.1, 200.1, 1e4 + 0.1, 1e6 + 0.1):
        assert p_values(step, shift) == pytest.approx(whole, abs=1e-9)


def test_uneven_repeats_are_no_difference() -> None:
    """Raise few false alarms where one policy was repeated ten times and the other, of few environments, was not."""
    rng = np.random.default_rng(0)

    def alarms(even: bool) -> list[int]:
        values = [(rng.normal(size=64) / 10**0.5, rng.normal(size=8)) for _ in range(12)]
        of_two = [difference_of("", "", a[:, None], b[:, None], together=False, even=even) for a, b in values]
        of_groups = [dependence._dependence("", pair, even=even) for pair in values]
        return [sum(one.p_value <= 0.05 for one in found) for found in (of_two, of_groups)]

    assert min(alarms(even=True)) >= 3
    assert max(alarms(even=False)) <= 2


def test_uneven_repeats_are_told(tmp_path: Path) -> None:
    """Compare by Welch's t if one policy was repeated more often; find no difference of one policy then."""
    often = [nearly(tmp_path / f"{run}.mcap", 600) for run in range(3)]
    once = nearly(tmp_path / "once.mcap", 800)
    returns = compare(episodes_of(*often, per_env=2), episodes_of(once, per_env=2)).differences[1]
    assert returns.test == "environments exchanged between policies, Welch t"
    assert returns.p_value > 0.05
    assert "Welch" not in compare(episodes_of(often[0], per_env=2), episodes_of(once, per_env=2)).differences[1].test


def test_groups_of_the_same_environments_are_paired() -> None:
    """Exchange environments that began alike under all values with each other alone, in whatever recordings."""
    small = [recording_of("near", 4, 1, seed) for seed in range(0, 16, 4)]
    whole, other = episodes_of(recording_of("near", 16, 1), per_env=1), recording_of("sweep", 16, 1)
    told = dependence.dependences([episodes_of(*small, per_env=1), whole])
    assert [(one.paired, one.p_value) for one in told] == [(True, 1.0), (True, 1.0)]  # the same episodes
    assert [one.clusters.tolist() for one in with_common_clusters([episodes_of(*small, per_env=1), whole])] == [
        list(range(16))
    ] * 2
    of_two = dependence.dependences([episodes_of(*small, per_env=1), episodes_of(other, per_env=1)])
    assert all(one.paired for one in of_two)
    some = dependence.dependences([episodes_of(*small[:2], per_env=1), whole])
    assert not any(one.paired for one in some)


def test_pairs_show_what_their_starts_hide() -> None:
    """Show a small difference of groups whose environments began alike, and keep the level there."""
    rng = np.random.default_rng(0)

    def p_value(difference: float, *, paired: bool) -> float:
        start = rng.normal(size=12)
        groups = [start + 0.3 * rng.normal(size=12) + shift for shift in (0.0, difference)]
        return dependence._dependence("", groups, paired=paired).p_value

    assert sum(p_value(0.5, paired=True) <= 0.05 for _ in range(8)) >= 6
    assert sum(p_value(0.5, paired=False) <= 0.05 for _ in range(8)) <= 2
    assert sum(p_value(0.0, paired=True) <= 0.05 for _ in range(20)) <= 4


def test_shares_of_repeats_have_the_interval_of_whole_numbers() -> None:
    """Give averaged repeats that agree the interval of one run, and others one that holds both neighbours'."""
    flags = np.array([[True], [False], [True], [True]])
    assert rate_interval(flags.astype(np.float64)) == rate_interval(flags) == wilson(3, 4)
    assert rate_interval(np.array([[0.5], [0.0], [1.0], [1.0]])) == (wilson(2, 4)[0], wilson(3, 4)[1])


def test_shares_are_not_rounded_to_all_or_none() -> None:
    """Print 100 % of all episodes alone, and a difference of zero where there is none."""
    assert [document.number(share, "success") for share in (0.0, 0.5, 1.0)] == ["0.0 %", "50.0 %", "100.0 %"]
    assert document.number(4095 / 4096, "success") == "99.98 %" and document.number(1 / 100_000, "success") == "0.001 %"
    assert document.difference(-1 / 4096, "success", sign=True) == "-0.02 pp"


def test_equal_returns_have_no_bias(tmp_path: Path) -> None:
    """Warn of no bias where all episodes have one return, whose mean rounds; say no more of flags than is known."""

    class Rewarded(search.Search):  # type: ignore[misc, name-defined]
        def step(self, action: Any) -> tuple[Any, ...]:
            observation, _, terminated, truncated, info = super().step(action)
            ended = terminated or truncated
            return observation, 0.1 * ended, ended, ended, info

    envs = wrap(gymnasium.vector.SyncVectorEnv([Rewarded] * 12), tmp_path / "a.mcap", steps=60)
    observation, _ = envs.reset(seed=0)
    for _ in range(60):
        observation, *_ = envs.step(search.near(observation))
    envs.close()
    found = outcome(
        choose(read_side([open_recording(tmp_path / "a.mcap")]), 3, None, At.LAST), Choice.GIVEN, None, At.LAST
    )
    early = finish_orders(found)["return"]
    assert found.n_left_out and early.difference == 0 and not early.biased
    assert "36 terminated, the other 0 truncated" in call("gsb-episodes", tmp_path / "a.mcap", "--per-env", 3).stdout
