"""Rows of torch's tensors on their way to the host, on every device of torch that is there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import torch

from gpusimbench import UsageError
from gpusimbench.recorder.vector.device.torch_rows import TorchRows


def kept(device: str) -> Any:
    """A device of torch; the test is skipped where there is none."""
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no GPU of CUDA")
    return torch.device(device)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_rows_come_as_they_were_kept(device: str) -> None:
    """Keep what tensors had, whatever is written into them later, while blocks are still on their way to the host."""
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
