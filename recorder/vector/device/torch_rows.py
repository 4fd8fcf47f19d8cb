"""Rows of torch's tensors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import cycle
from typing import Any

import numpy as np

from gpusimbench.recorder.vector.device.rows import Arrays, Columns, Rows

_HOST_BLOCKS = 3  # being copied to the host, waiting to be written, being written


class TorchRows(Rows):
    """A block on the device of the tensors.

    Of a GPU, full blocks are copied in the order of the stream into pinned memory of the host, and the block is used
    again; on the host, a full block is handed over, and a new one made.
    """

    def __init__(self) -> None:
        super().__init__()
        self._block: dict[str, Any] = {}
        self._pinned = cycle([dict[str, Any]() for _ in range(_HOST_BLOCKS)])

    @staticmethod
    def described(array: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """See Rows.described; bfloat16 comes as float32."""
        name = str(array.dtype).removeprefix("torch.")
        return np.dtype(np.float32 if name == "bfloat16" else name), tuple(array.shape)

    def last(self, names: Iterable[str]) -> Callable[[], Columns]:
        """See Rows.last."""
        row = {name: self._block[name][self.filled - 1].clone() for name in names}
        return lambda: {name: tensor.cpu().numpy() for name, tensor in row.items()}

    def _put(self, row: Arrays, at: int) -> None:
        import torch

        for name, array in row.items():
            tensor = torch.as_tensor(array).detach()
            if name not in self._block:
                dtype = torch.float32 if tensor.dtype is torch.bfloat16 else tensor.dtype
                self._block[name] = torch.empty((self._most, *tensor.shape), dtype=dtype, device=tensor.device)
            self._block[name][at].copy_(tensor)

    def _take(self, filled: int) -> Callable[[], Columns]:
        import torch

        events: list[Any] = []
        host, pinned = dict[str, Any](), next(self._pinned)
        for name, block in self._block.items():
            if block.is_cuda:
                if name not in pinned:
                    pinned[name] = torch.empty(block.shape, dtype=block.dtype, pin_memory=True)
                host[name] = pinned[name][:filled]
                host[name].copy_(block[:filled], non_blocking=True)
                if not events:
                    events.append(torch.cuda.Event())
                    stream = torch.cuda.current_stream(block.device)
            else:
                host[name] = block[:filled]
        for event in events:
            event.record(stream)
        self._block = {name: block for name, block in self._block.items() if block.is_cuda}

        def arrived() -> Columns:
            for event in events:
                event.synchronize()
            return {name: tensor.numpy() for name, tensor in host.items()}

        return arrived
