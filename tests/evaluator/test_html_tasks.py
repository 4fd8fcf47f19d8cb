"""What the report says of recordings of tasks: what fits them, and nothing of sweeps, bodies and the benchmark."""

from __future__ import annotations

import numpy as np
import pytest

from gpusimbench import wrap
from tests.conftest import call

gymnasium = pytest.importorskip("gymnasium")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Runs of a task with three numbers of environments: what gsb-eval prints, and its page."""
    folder = tmp_path_factory.mktemp("tasks")
    for n_env in (1, 2, 3):
        for run in (0, 1):
            envs = gymnasium.make_vec("CartPole-v1", num_envs=n_env, vectorization_mode="sync")
            envs = wrap(envs, folder / f"{n_env}-{run}.mcap")
            observation, _ = envs.reset(seed=0)
            for _ in range(30):
                observation, *_ = envs.step((observation[:, 2] > 0).astype(np.int64))
            envs.close()
    printed = call("gsb-eval", folder, "--html", folder / "page").stdout
    return printed, (folder / "page" / "index.html").read_text(encoding="utf-8")


def test_a_task_has_no_scaling(page: tuple[str, str]) -> None:
    """Show no sweep where nothing was timed and no number of environments failed."""
    assert "Scaling over the number of environments" not in page[1]
    assert "<h1>Does gymnasium repeat itself?</h1>" in page[1]
    assert "3 of 3 groups with several runs repeat bit for bit" in page[1]


@pytest.mark.parametrize("noise", ["o distance to real", "protocol-2", "W1 compares", "off the board", "sunk"])
def test_a_task_is_asked_for_nothing_of_bodies(page: tuple[str, str], noise: str) -> None:
    """Speak of no real trials, no protocol of the benchmark and no distance of bodies."""
    body = page[1].partition('id="provenance"')[0]
    assert "distinct runs" in body
    assert noise not in page[0] and noise not in body


def test_a_task_misses_no_section(page: tuple[str, str]) -> None:
    """List no section as left out that no recording of a task could have."""
    assert 'id="left-out"' not in page[1]
