"""Rows of torch's tensors on their way to the host, on every device of torch that is there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import torch

from gpusimbench import UsageError, open_recording, wrap
from gpusimbench.recorder.vector.device import rows as blocks
from gpusimbench.recorder.vector.device.torch_rows import TorchRows


def kept(device: str) -> Any:
    """A device of torch; the test is skipped where there is none."""
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no GPU of CUDA")
    return torch.device(device)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_rows_come_as_they_were_kept(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what tensors had, whatever is written into them later, while blocks are still on their way to the host."""
    monkeypatch.setattr(blocks, "_WAIT_S", 0.0)  # blocks of 50 rows, whatever time the steps take
    rows, generator = TorchRows(), np.random.default_rng(0)
    given = generator.normal(size=(333, 64, 9)).astype(np.float32)
    tensor = torch.zeros(64, 9, device=kept(device))
    flags = torch.zeros(64, dtype=torch.bool, device=tensor.device)
    on_host, waiting, found = torch.zeros(64, 2), [], []
    for row in given:
        if rows.full:
            waiting.append(rows.take())
        if len(waiting) == 2:
            found.append(waiting.pop(0)())
            found[-1] = {name: array.copy() for name, array in found[-1].items()}
        tensor.copy_(torch.from_numpy(row))
        torch.gt(tensor[:, 0], 0, out=flags)
        on_host.copy_(torch.from_numpy(row[:, :2]))
        rows.keep({"seen": tensor, "flags": flags, "action": on_host, "half": tensor.to(torch.bfloat16)})
    tensor.zero_()
    found += [one() for one in (*waiting, rows.take())]
    columns = {name: np.concatenate([one[name] for one in found]) for name in found[0]}
    assert len(found) == 7
    assert np.array_equal(columns["seen"], given)
    assert np.array_equal(columns["flags"], given[:, :, 0] > 0)
    assert np.array_equal(columns["action"], given[:, :, :2])
    assert columns["half"].dtype == np.float32
    assert np.allclose(columns["half"], given, rtol=0.01)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_last_row_is_replaced_in_part(device: str) -> None:
    """Replace some arrays of the last row, of which a copy may be kept before; refuse another layout."""
    rows, ones = TorchRows(), torch.ones(3, 2, device=kept(device))
    rows.keep({"seen": ones, "reward": ones[:, 0]})
    rows.keep({"seen": ones * 2, "reward": ones[:, 0] * 2})
    before = rows.last(["seen"])
    rows.replace({"seen": ones * 3})
    with pytest.raises(UsageError, match=r"reward is torch.float64 \(3,\), and was torch.float32 \(3,\) before"):
        rows.keep({"seen": ones, "reward": ones[:, 0].double()})
    found = rows.take()()
    assert (before()["seen"] == 2).all()
    assert found["seen"][:, 0, 0].tolist() == [1, 3] and found["reward"][:, 0].tolist() == [1, 2]


N_ENV = 3


class Counting:
    """Environments on the host that count their steps; their user resets some by the option env_idx.

    fails  the step that raises an error once
    """

    device = torch.device("cpu")
    num_envs = N_ENV
    dt = 0.1
    metadata = {"autoreset_mode": "Disabled"}

    def __init__(self, fails: int = -1, **returned: Any) -> None:
        self._steps, self._fails, self._returned = torch.zeros(N_ENV), fails, returned

    def reset(self, options: Any = None) -> Any:
        self._steps[slice(None) if options is None else options["env_idx"]] = 0
        return self._steps[:, None].clone(), {}

    def step(self, action: Any) -> Any:
        if self._steps.max() == self._fails:
            self._fails = -1
            raise RuntimeError("the arm is stuck")
        self._steps += 1
        never = torch.zeros(N_ENV, dtype=torch.bool)
        found = {
            "obs": self._steps[:, None].clone(),
            "reward": torch.ones(N_ENV),
            "term": never,
            "cut": never,
            "info": {},
        }
        return tuple({**found, **self._returned}.values())

    def close(self) -> None:
        pass


def stepped(env: Any, path: Path, action: Any = None, resets: Any = ()) -> None:
    """Six steps of an environment, with resets before the fourth."""
    with wrap(env, path, steps=6, infos=("success",)) as recorded:
        recorded.reset()
        for step in range(6):
            for options in resets if step == 3 else ():
                recorded.reset(options=options)
            recorded.step(torch.zeros(N_ENV, 1) if action is None else action)


@pytest.mark.parametrize(
    ("resets", "begun"),
    [([{"env_idx": [0]}, {"env_idx": [2]}], [1, 0, 1]), ([{"env_idx": [0]}, None], [1, 1, 1])],
)
def test_resets_between_two_steps_add_up(resets: Any, begun: Any, tmp_path: Path) -> None:
    """Begin an episode in each environment that was reset, whichever of the resets between two steps did it."""
    stepped(Counting(), tmp_path / "a.mcap", resets=resets)
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.status == "complete"
    assert recording.state("env", "episode")[-1].ravel().tolist() == begun
    assert recording.state("env", "observation")[-1].ravel().tolist() == [3 if new else 6 for new in begun]


@pytest.mark.parametrize(
    ("returned", "action", "said"),
    [
        (
            {"term": torch.zeros(N_ENV, 1, dtype=torch.bool)},
            None,
            r"terminated has shape \(3, 1\); a truth value for each",
        ),
        ({"cut": False}, None, r"truncated has shape \(\); a truth value"),
        ({"reward": 1.0}, None, r"reward has shape \(\)"),
        ({"reward": torch.ones(N_ENV) * 1j}, None, "reward is torch.complex64; arrays of real numbers"),
        ({"obs": None}, None, "observation is NoneType, and no array"),
        ({"info": {"success": "yes"}}, None, "info success is str, and no array"),
        ({"more": 1}, None, "step returned 6 values, not observation"),
        ({}, "up", "action is str, and no array"),
        ({}, torch.zeros(N_ENV + 1, 1), r"action has shape \(4, 1\); a row for each of 3"),
    ],
)
def test_what_is_no_array_of_all_environments(returned: Any, action: Any, said: str, tmp_path: Path) -> None:
    """Say at the first step what is wrong, and leave no file."""
    with pytest.raises(UsageError, match=said):
        stepped(Counting(**returned), tmp_path / "a.mcap", action)
    assert not list(tmp_path.iterdir())


def test_a_first_step_that_fails(tmp_path: Path) -> None:
    """Begin no recording behind a step that is missing: a reset is wanted first."""
    with wrap(Counting(fails=0), tmp_path / "a.mcap", steps=2) as recorded:
        recorded.reset()
        with pytest.raises(RuntimeError, match="stuck"):
            recorded.step(torch.zeros(N_ENV, 1))
        with pytest.raises(UsageError, match="reset before it is stepped, and after a first step that failed"):
            recorded.step(torch.zeros(N_ENV, 1))
        recorded.reset()
        for _ in range(2):
            recorded.step(torch.zeros(N_ENV, 1))
    assert open_recording(tmp_path / "a.mcap").status == "complete"
