"""gsb-probe and gsb-eval of recordings of tasks, whose environments have seeds of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gpusimbench import open_recording, wrap
from gpusimbench.evaluator.metrics.levels import EqualityLevel
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import arms_of
from gpusimbench.evaluator.probe.finding import Answer
from gpusimbench.evaluator.probe.pairs import Pairs, compare_pairs
from gpusimbench.evaluator.probe.questions import answers
from tests.conftest import Command

gymnasium = pytest.importorskip("gymnasium")


def _recorded(path: Path, n_env: int, seed: int = 1) -> Path:
    envs = wrap(gymnasium.make_vec("CartPole-v1", num_envs=n_env), path, steps=6)
    envs.reset(seed=seed)
    for _ in range(6):
        envs.step(np.zeros(n_env, int))
    envs.close()
    return path


def test_environments_of_a_task_are_not_meant_to_be_alike(tmp_path: Path, gsb_probe: Command) -> None:
    """Do not ask whether environments stay equal that were reset with different seeds; say what compares them."""
    paths = [_recorded(tmp_path / f"{n}.mcap", n) for n in (2, 4)]
    (arms,) = arms_of(list(map(open_recording, paths)))
    found = {finding.key: finding for finding in answers(arms)}["envs"]
    assert found.answer is Answer.NOT_ASKED
    assert found.reason == "seeds and actions of environments differ by design"
    assert "gsb-diff A B compares the environments" in gsb_probe(*paths, code=5).stderr


def test_no_distance_without_positions(tmp_path: Path) -> None:
    """Call observations different that are not equal: there is no tolerance in metres or rad for them."""
    a, b = (open_recording(_recorded(tmp_path / f"{seed}.mcap", 2, seed)) for seed in (1, 2))
    found = compare_pairs(Pairs(a, b, ((0, 0),)))
    assert not isinstance(found, Missing)
    assert (found.level, found.unit, found.max_distance) == (EqualityLevel.DIFFERENT, "", 0.0)


def test_the_first_page_of_tasks(tmp_path: Path, gsb_eval: Command) -> None:
    """Say how many episodes ended, and what evaluates them; speak of no positions, which tasks do not record."""
    for n in (2, 4, 8):
        _recorded(tmp_path / f"{n}.mcap", n)
    shown = " ".join(gsb_eval(tmp_path, "--html", tmp_path / "report").stdout.split())
    assert "[n_env=2]: episodes: none ended within the 6 recorded steps of 2 environments" in shown
    assert "with intervals: gsb-episodes, by number of environments with --across n_env." in shown
    assert "N_env^max" not in shown  # nothing was timed, so no limit of the simulator was looked for
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert "3 recordings, 1 simulator, 1 scene, 1 device." in page
