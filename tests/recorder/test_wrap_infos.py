"""Infos in gpusimbench.wrap: which numbers are recorded, of which steps, in every autoreset mode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import UsageError, open_recording, wrap
from gpusimbench.evaluator.read.episodes import episode_table
from gpusimbench.recorder.vector.fields import info_arrays
from gpusimbench.recorder.vector.modes import Mode
from tests.reading import verified

gymnasium = pytest.importorskip("gymnasium")
MODES = ("NextStep", "SameStep", "Disabled")


class Told(gymnasium.Env):  # type: ignore[misc,name-defined]
    """Episodes of 2, 3, 2, 3, ... steps; the infos of each step and of each reset say which they are of."""

    metadata = {"render_fps": 20}  # noqa: RUF012
    observation_space = gymnasium.spaces.Box(0, 99, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, env: int) -> None:
        self.env, self.episode = env, -1

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.episode, self.steps = self.episode + 1, 0
        return np.zeros(1, np.float32), {"success": True, "score": -1.0, "arm": {"force": -1.0}}

    def step(self, action: Any) -> Any:
        self.steps += 1
        last = self.steps == 2 + self.episode % 2
        info: dict[str, Any] = {"score": 100.0 * self.env + 10 * self.episode + self.steps}
        if last:
            info |= {"success": np.bool_(self.episode % 3 == 0), "arm": {"force": self.steps}}
        return np.full(1, self.steps, np.float32), 1.0, last, False, info


def vector(n_env: int, mode: str) -> Any:
    """Such environments as a vector of that mode."""
    return gymnasium.vector.SyncVectorEnv(
        [lambda env=env: Told(env) for env in range(n_env)], autoreset_mode=gymnasium.vector.AutoresetMode(mode)
    )


def play(envs: Any, steps: int) -> None:
    """Step as a user of its mode does."""
    envs.reset(seed=0)
    for _ in range(steps):
        _, _, terminated, truncated, _ = envs.step(np.zeros((envs.num_envs, 1), np.float32))
        if envs.metadata["autoreset_mode"].value == "Disabled" and (terminated | truncated).any():
            envs.reset(options={"reset_mask": terminated | truncated})
    envs.close()


@pytest.mark.parametrize("mode", MODES)
def test_infos_are_those_of_the_steps(mode: str, tmp_path: Path) -> None:
    """Record what the info of a step said, never that of the reset behind it, and whether it said anything."""
    play(wrap(vector(3, mode), tmp_path / "a.mcap", steps=20, infos=("success", "score", "arm/force", "never")), 20)
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "complete"
    arrays = {
        field.field: recording.state("env", field.field)[:, :, 0, 0]
        for field in recording.fields
        if field.field.startswith("info")
    }
    assert [name for name in arrays if not name.endswith("_given")] == [
        "info_success", "info_score", "info_arm_force", "info_never",
    ]  # fmt: skip
    table = episode_table(recording)
    stepped = recording.state("env", "stepped")[:, :, 0, 0] != 0
    assert np.array_equal(arrays["info_score_given"] != 0, stepped)
    assert (arrays["info_score"][~stepped] == 0).all()
    for i in np.flatnonzero(table.ended):
        env, number, row = table.env[i], table.number[i], table.last_row[i]
        assert table.length[i] == 2 + number % 2
        assert arrays["info_score"][row, env] == 100 * env + 10 * number + table.length[i]
        assert arrays["info_success"][row, env] == (number % 3 == 0)
        assert arrays["info_arm_force"][row, env] == table.length[i]
    ends = np.zeros_like(stepped)
    ends[table.last_row[table.ended], table.env[table.ended]] = True
    assert ends.sum() > 15
    for name in ("info_success", "info_arm_force"):
        assert np.array_equal(arrays[f"{name}_given"] != 0, ends)
        assert (arrays[name][~ends] == 0).all()
    assert not arrays["info_never"].any() and not arrays["info_never_given"].any()
    units = {field.field: field.unit for field in recording.fields}
    assert (units["info_score"], units["info_score_given"]) == ("unknown", "1")


def test_infos_without_masks() -> None:
    """Take an info without a mask as said by all environments; a mask of a dictionary holds for what is in it."""
    done, stepped = np.array([False, True, False]), np.array([True, True, False])
    info = {"success": np.array([[1], [1], [1]]), "cost": {"energy": [4, 5, 6], "_energy": [True, True, False]}}
    found = info_arrays(("success", "cost/energy"), info, Mode.DISABLED, done, stepped)
    assert {name: array.tolist() for name, array in found.items()} == {
        "info/success": [1, 1, 0], "info/success_given": [True, True, False],
        "info/cost/energy": [4, 5, 0], "info/cost/energy_given": [True, True, False],
    }  # fmt: skip
    info |= {"final_info": {"success": np.array([0, 7, 0])}, "_final_info": np.array([False, True, False])}
    found = info_arrays(("success", "cost/energy"), info, Mode.SAME_STEP, done, np.ones(3, dtype=bool))
    assert found["info/success"].tolist() == [1, 7, 1]
    assert found["info/cost/energy_given"].tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("value", "match"),
    [
        (np.zeros(2), "a number for each of 2 environments is recorded: give each component a name"),
        ("yes", "arrays of real numbers or truth values"),
    ],
)
def test_infos_that_cannot_be_recorded(value: Any, match: str, tmp_path: Path) -> None:
    """End the recording with the reason where an info is no scalar or no number."""

    class Odd(Told):
        def step(self, action: Any) -> Any:
            *others, info = super().step(action)
            return (*others, info | {"odd": value})

    envs = wrap(
        gymnasium.vector.SyncVectorEnv([lambda: Odd(0)] * 2), tmp_path / "a.mcap", steps=4, infos=["odd"]
    )  # fmt: skip
    with pytest.raises(UsageError, match=match):
        play(envs, 4)
    envs.close()
    assert open_recording(tmp_path / "a.mcap").status == "failed"
    with pytest.raises(UsageError, match=r"a list of names, such as \(\"odd\",\)"):
        wrap(vector(1, "NextStep"), tmp_path / "b.mcap", steps=4, infos="odd")
