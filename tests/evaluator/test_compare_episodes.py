"""gsb-compare on recordings of tasks: episodes of head beside those of base, with environments as units."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording, wrap
from gpusimbench.evaluator.cli.compare import main
from gpusimbench.evaluator.compare.episodes import _compared
from gpusimbench.evaluator.compare.finding import Change, Finding, Settings
from gpusimbench.evaluator.episodes.comparison import compare as compare_policies
from gpusimbench.evaluator.episodes.comparison import difference_of
from gpusimbench.evaluator.episodes.side import choose, read_side
from gpusimbench.evaluator.read.episodes import At
from gpusimbench.evaluator.statistics.cases import PERMUTATIONS
from tests.conftest import call, made_once
from tests.scripts import example

pytest.importorskip("gymnasium")
search = example("search")


def recorded(policy: str, n_env: int, per_env: int, copy: int = 0, seed: int = 0) -> Path:
    """A recording with that many episodes of each environment, made once for each copy."""
    name = f"compared-{policy}-{n_env}-{per_env}-{copy}-{seed}"
    folder = made_once(name, lambda at: search.record(policy, at / f"{name}.mcap", n_env, per_env, seed))
    return folder / f"{name}.mcap"


def compared(*arguments: object, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any], dict[str, Any]]:
    """Exit code, the one configuration of the JSON, and its findings by name."""
    code = main([*map(str, arguments), "--no-cache", "--json", "-"])
    (configuration,) = json.loads(capsys.readouterr().out)["compared"]
    return code, configuration, {finding["name"]: finding for finding in configuration["findings"]}


def test_a_policy_that_is_worse(capsys: pytest.CaptureFixture[str]) -> None:
    """Fail the gate of episodes by the differences that gsb-episodes finds, and pass it the other way round."""
    near, sweep = recorded("near", 64, 4), recorded("sweep", 64, 4)
    policies = [choose(read_side([open_recording(path)]), 4, "success", At.LAST) for path in (sweep, near)]
    wanted = {one.name: one for one in compare_policies(*policies).differences}
    code, _, found = compared(near, sweep, capsys=capsys)
    assert code == 4
    for name, one in wanted.items():
        assert found[name]["change"] == "regression" and found[name]["fails"]
        assert found[name]["head"] - found[name]["base"] == pytest.approx(one.difference)
        assert found[name]["difference_ci95"] == pytest.approx(one.ci95)
        assert found[name]["p_value"] == one.p_value
    assert "began alike" in found["return"]["method"]
    assert found["length"]["change"] == "changed" and not found["length"]["gated"]
    code, _, found = compared(sweep, near, "--gate", "episodes", capsys=capsys)
    assert code == 0 and found["return"]["change"] == found["success"]["change"] == "improvement"
    assert compared(sweep, near, "--gate", "lengths", capsys=capsys)[0] == 4


def test_success_is_in_per_cent(capsys: pytest.CaptureFixture[str]) -> None:
    """Print shares of success in per cent and their differences in percentage points, as gsb-episodes does."""
    near, sweep = recorded("near", 64, 4), recorded("sweep", 64, 4)
    assert main([str(near), str(sweep), "--no-cache"]) == 4
    (row,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("success of episodes"))
    assert re.search(r" 73\.4 % +57\.8 % +by \[-\d\d\.\d pp to -\d\.\d pp\] ", row), row


def test_one_run_twice(capsys: pytest.CaptureFixture[str]) -> None:
    """Say of two runs that agree in every bit that they do, in states and in episodes, without a test."""
    code, _, found = compared(
        recorded("near", 64, 4), recorded("near", 64, 4, copy=1), "--gate", "episodes,lengths,bits", capsys=capsys
    )
    assert code == 0
    assert {found[name]["change"] for name in ("states", "success", "return", "length")} == {"same"}
    assert found["return"]["p_value"] is None


def test_repetitions_are_no_further_environments(capsys: pytest.CaptureFixture[str]) -> None:
    """Give copies of a run the same interval as the run: runs with one seed are means of their environments."""
    near, sweep = ([recorded(policy, 64, 4, copy) for copy in range(3)] for policy in ("near", "sweep"))
    once = compared(near[0], sweep[0], capsys=capsys)[2]["return"]
    thrice = compared("--base", *near, "--head", *sweep, capsys=capsys)[2]["return"]
    assert thrice["n"] == {"base": 3, "head": 3}
    assert thrice["difference_ci95"] == pytest.approx(once["difference_ci95"])
    assert thrice["p_value"] == once["p_value"]


def test_seeds_are_one_sample(capsys: pytest.CaptureFixture[str]) -> None:
    """Take several seeds as gsb-episodes does, in one configuration, and judge bits and repetition seed by seed.

    Gymnasium seeds environments with seed + number: those of seeds 0, 1 and 2 are 18, of which 15 are in several runs.
    """
    near, sweep = ([recorded(policy, 16, 4, seed=seed) for seed in range(3)] for policy in ("near", "sweep"))
    policies = [
        choose(read_side([open_recording(path) for path in side]), 4, "success", At.LAST) for side in (sweep, near)
    ]
    (wanted,) = [one for one in compare_policies(*policies).differences if one.name == "return"]
    gates = ("--gate", "episodes,determinism,bits")
    _, configuration, found = compared("--base", *near, "--head", *sweep, *gates, capsys=capsys)
    assert found["return"]["n"] == {"base": 3, "head": 3} and "18 environments" in found["return"]["method"]
    assert "began alike" in found["return"]["method"]
    assert found["return"]["head"] - found["return"]["base"] == pytest.approx(wanted.difference)
    assert found["return"]["difference_ci95"] == pytest.approx(wanted.ci95)
    assert found["return"]["p_value"] == wanted.p_value
    assert "3 seeds of base and 3 of head, 3 on both sides, are one sample" in configuration["notes"]
    assert found["distinct_runs"]["undecided"] and "differ from step" in found["states"]["undecided"]

    # two runs of each seed: neither repeats another seed, and both repeat their own
    again = [recorded("near", 16, 4, copy=1, seed=seed) for seed in range(2)]
    _, _, found = compared("--base", near[0], again[0], near[1], again[1], "--head",
                           *(recorded("near", 16, 4, copy, seed) for copy in (2, 3) for seed in range(2)),
                           capsys=capsys)  # fmt: skip
    for name in ("distinct_runs", "states"):
        assert found[name]["change"] == "same" and "of 2 seeds" in found[name]["note"]
    assert found["return"]["note"] == "the same in every episode"


def test_other_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    """Compare policies over seeds that are not the same, without pairs; bits are of no seed then."""
    near, sweep = recorded("near", 16, 4), [recorded("sweep", 16, 4, seed=seed) for seed in (1, 2)]
    _, configuration, found = compared("--base", near, "--head", *sweep, "--gate", "bits", capsys=capsys)
    assert "not paired" in found["return"]["method"] and "(16 and 17 environments" in found["return"]["method"]
    assert "1 seed of base and 2 of head, 0 on both sides, are one sample" in configuration["notes"]
    assert found["states"]["undecided"] == "base and head have no seed in common"


def test_more_runs_of_a_seed(capsys: pytest.CaptureFixture[str]) -> None:
    """Pair episodes seed by seed where a side has more runs of one: those that agree in every bit are the same."""

    def near(seed: int, copy: int = 0) -> Path:
        return recorded("near", 16, 4, copy, seed)

    _, configuration, found = compared("--base", near(0), near(0, 1), near(1), "--head", near(0, 2), near(1, 1),
                                       capsys=capsys)  # fmt: skip
    assert found["return"]["note"] == "the same in every episode"
    assert "2 seeds of base and 2 of head, 2 on both sides, are one sample" in configuration["notes"]
    sweep = [recorded("sweep", 16, 4, seed=seed) for seed in range(2)]
    even = compared("--base", near(0), near(1), "--head", *sweep, capsys=capsys)[2]["return"]
    uneven = compared("--base", near(0), near(0, 1), near(1), "--head", *sweep, capsys=capsys)[2]["return"]
    assert uneven["n"] == {"base": 3, "head": 2}
    assert uneven["p_value"] == even["p_value"]
    assert uneven["difference_ci95"] == pytest.approx(even["difference_ci95"])
    found = compared(near(0), "--head", near(0, 1), near(1, 1), capsys=capsys)[2]
    assert found["states"]["note"] == "in the only seed of both sides"


def test_runs_without_a_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say that they have none beside runs that have, and pair no episode of them."""
    search.record("near", tmp_path / "a.mcap", 16, 4, None)
    _, configuration, found = compared("--base", tmp_path / "a.mcap", "--head",
                                       *(recorded("near", 16, 4, seed=seed) for seed in range(2)),
                                       capsys=capsys)  # fmt: skip
    assert any(note.endswith("each run without a seed counts as another seed") for note in configuration["notes"])
    assert "not paired" in found["return"]["method"]


def test_other_numbers_of_environments(capsys: pytest.CaptureFixture[str]) -> None:
    """Compare across n_env without pairs; leave what too few environments cannot show to nobody's guess."""
    code, configuration, found = compared(
        recorded("near", 64, 4), recorded("sweep", 16, 4), "--across", "n_env", "--gate", "episodes", capsys=capsys
    )
    assert "n_env: 64 -> 16" in configuration["differs"] and "not paired" in found["return"]["method"]
    low, high = found["return"]["difference_ci95"]
    assert low < found["return"]["head"] - found["return"]["base"] < high
    code, _, found = compared(recorded("near", 2, 4), recorded("sweep", 2, 4), "--gate", "episodes", capsys=capsys)
    assert code == 5
    assert found["return"]["undecided"] == "too few environments" and found["return"]["least_p"] == 0.5


def test_episodes_that_did_not_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Decide nothing where an environment has no finished episode; name the environment."""
    import gymnasium

    envs = wrap(gymnasium.vector.SyncVectorEnv([search.Search] * 64), tmp_path / "a.mcap", steps=2, infos=("success",))
    envs.reset(seed=0)
    for _ in range(2):
        envs.step(np.zeros(64, dtype=np.int64))
    envs.close()
    code, _, found = compared(tmp_path / "a.mcap", recorded("near", 64, 4), "--gate", "episodes", capsys=capsys)
    assert code == 5
    assert found["return"]["change"] == "not compared"
    assert "no episode of environment" in found["return"]["undecided"]


def test_single_runs_that_part(capsys: pytest.CaptureFixture[str]) -> None:
    """Print the first step at which two single runs differ, though two runs do not decide a gate of bits."""
    main([str(recorded("near", 64, 4)), str(recorded("sweep", 64, 4)), "--no-cache"])
    said = " ".join(capsys.readouterr().out.split())
    assert "states of head and base: they differ from step 1 on" in said
    assert "return of episodes" in said and "REGRESSION" in said


def test_a_history_has_no_episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a gate that nothing would decide, instead of passing it."""
    assert main(["--history", str(tmp_path), "--gate", "throughput,episodes"]) == 2
    assert "--history has no curves of episodes" in capsys.readouterr().err


@pytest.mark.parametrize("sides", [(1, 5), (5, 1), (1, 1)])
def test_one_environment(sides: tuple[int, int], capsys: pytest.CaptureFixture[str]) -> None:
    """Say that one environment beside others cannot show a difference; SciPy has no test of it."""
    base, head = recorded("near", sides[0], 4), recorded("sweep", sides[1], 4)
    code, _, found = compared(base, head, "--across", "n_env", "--gate", "episodes", capsys=capsys)
    assert code == 5
    ways = max(2, *sides) + (sides[0] != sides[1])
    assert found["return"]["undecided"] == "too few environments"
    assert found["return"]["least_p"] == pytest.approx(2 / ways)


def test_the_least_p_of_many_environments(capsys: pytest.CaptureFixture[str]) -> None:
    """Be that of all drawn permutations and the arrangement that was recorded, from both sides."""
    _, _, found = compared(recorded("near", 64, 4), recorded("sweep", 64, 4), capsys=capsys)
    assert found["return"]["least_p"] == pytest.approx(2 / (PERMUTATIONS + 1), rel=1e-9)


def test_the_value_of_one_environment() -> None:
    """Rank one environment among all of both sides: the exact permutation test, from either side."""
    one, others = np.array([[9.0]]), np.arange(7.0)[:, None]
    for first, second in ((one, others), (others, one)):
        assert difference_of("return", "1", first, second, together=False).p_value == 2 / 8
    assert difference_of("return", "1", np.array([[3.0]]), others, together=False).p_value == 1.0


@pytest.mark.parametrize(
    ("envs", "head", "change"),
    [
        ((3, 3), 2.0, Change.IMPROVEMENT),
        ((3, 4), 0.5, Change.REGRESSION),
        ((2, 2), 1.04, Change.SMALL),
        ((2, 2), 1.0, Change.SAME),
        ((1, 1), 1.0, Change.SAME),
    ],
)
def test_values_without_spread_need_no_test(envs: tuple[int, int], head: float, change: Change) -> None:
    """Judge two values by the threshold of 5 % where all episodes of a side have one."""
    sides = np.full((envs[0], 2), 1.0), np.full((envs[1], 2), head)
    found = _compared("return", *sides, (1, 1), Settings(gates=frozenset()), together=False, even=True)
    assert found.change is change
    assert f"({envs[0] if envs[0] == envs[1] else f'{envs[0]} and {envs[1]}'} environments; not paired)" in found.method


@pytest.mark.parametrize("envs", [(1, 3), (3, 1), (1, 1)])
def test_one_environment_without_spread_is_no_verdict(envs: tuple[int, int]) -> None:
    """Ask a test where a side is one environment, whose episodes may be alike by chance."""
    sides = np.full((envs[0], 2), 1.0), np.full((envs[1], 2), 2.0)
    found = _compared("return", *sides, (1, 1), Settings(gates=frozenset()), together=False, even=True)
    assert not isinstance(found, Finding)


def test_returns_without_bound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Compare no returns whose differences are no numbers; name the first of them, by both commands."""
    import gymnasium

    class Search(search.Search):  # type: ignore[misc,name-defined]
        def step(self, action: object) -> Any:
            observation, _, terminated, truncated, info = super().step(action)
            return observation, 1e308, terminated, truncated, info

    path = tmp_path / "a.mcap"
    envs = gymnasium.vector.SyncVectorEnv([Search] * 64)
    with wrap(envs, path, steps=200, infos=("success",)) as log:
        log.reset(seed=0)
        for _ in range(200):
            log.step(np.zeros(64, dtype=np.int64))
    code, _, found = compared(recorded("near", 64, 4), path, "--gate", "episodes", capsys=capsys)
    assert code == 5
    said = "is inf; only returns up to 1e+100 are evaluated"
    assert said in found["return"]["undecided"]
    assert said in call("gsb-episodes", path, code=5).stderr
