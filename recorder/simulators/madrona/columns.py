"""Exported columns of a Madrona simulator: live tensors, read on the host or kept on the device until a batch is full.

A tensor offers DLPack (``__dlpack__``), or ``to_torch()`` as Madrona's own ``py::Tensor`` does. On the CPU, DLPack
needs nothing but numpy; on a GPU both need PyTorch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.madrona.module import breach
from gpusimbench.schemas.errors import UsageError

_RING_ROWS = 50
_RING_BYTES = 256 << 20

Ring = dict[str, Any]
"""Rows of each column, by its name: arrays [row, *shape]."""


class HostColumns:
    """Columns in host memory, as numpy arrays that share it."""

    def __init__(self, tensors: dict[str, Any], module: str) -> None:
        """Look at the tensors, by name. UsageError where one is not in host memory."""
        self._arrays = {name: _host_array(tensor, name, module) for name, tensor in tensors.items()}
        self.rows: int | None = None  # that a ring can have; None: as many as one likes
        self.device = "cpu"

    def described(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """Shape and dtype of each column."""
        return {name: (array.shape, str(array.dtype)) for name, array in self._arrays.items()}

    def ring(self, rows: int) -> Ring:
        """Room for so many rows."""
        return {name: np.empty((rows, *array.shape), dtype=array.dtype) for name, array in self._arrays.items()}

    def store(self, ring: Ring, row: int) -> None:
        """Copy the present columns to a row."""
        for name, array in self._arrays.items():
            ring[name][row] = array

    def fetch(self, ring: Ring, rows: int) -> dict[str, NDArray[Any]]:
        """The first rows, on the host."""
        return {name: array[:rows] for name, array in ring.items()}


class TorchColumns:
    """Columns as PyTorch tensors that share their memory, on a GPU."""

    def __init__(self, tensors: dict[str, Any], module: str) -> None:
        """Look at the tensors, by name. UsageError where PyTorch is missing."""
        self._tensors = {name: _torch_tensor(tensor, name, module) for name, tensor in tensors.items()}
        row = sum(tensor.numel() * tensor.element_size() for tensor in self._tensors.values())
        self.rows: int | None = max(1, min(_RING_ROWS, _RING_BYTES // row))
        self._where = next(iter(self._tensors.values())).device
        self.device = str(self._where)
        if self._where.type == "cuda":
            import torch

            self.device = torch.cuda.get_device_name(self._where)

    def described(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """See HostColumns.described."""
        return {
            name: (tuple(tensor.shape), str(tensor.dtype).removeprefix("torch."))
            for name, tensor in self._tensors.items()
        }

    def ring(self, rows: int) -> Ring:
        """See HostColumns.ring; on the device."""
        return {name: tensor.new_empty((rows, *tensor.shape)) for name, tensor in self._tensors.items()}

    def store(self, ring: Ring, row: int) -> None:
        """See HostColumns.store. Returns when the device is done: Madrona steps on a stream of its own."""
        for name, tensor in self._tensors.items():
            ring[name][row].copy_(tensor)
        if self._where.type == "cuda":
            import torch

            torch.cuda.current_stream(self._where).synchronize()

    def fetch(self, ring: Ring, rows: int) -> dict[str, NDArray[Any]]:
        """See HostColumns.fetch; copied from the device at once."""
        return {name: tensor[:rows].cpu().numpy() for name, tensor in ring.items()}


def _host_array(tensor: Any, name: str, module: str) -> NDArray[Any]:
    if not hasattr(tensor, "__dlpack__"):
        shared = _to_torch(tensor, name, module)
        if shared.device.type != "cpu":
            raise breach(module, name, f"{name}() is on {shared.device}, and ExecMode.CPU was asked for")
        return np.asarray(shared.numpy())
    try:
        return np.from_dlpack(tensor)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:  # such as memory of a GPU
        raise breach(module, name, f"{name}() cannot be read as host memory by DLPack: {error}") from None


def _torch_tensor(tensor: Any, name: str, module: str) -> Any:
    if hasattr(tensor, "to_torch"):
        return _to_torch(tensor, name, module)
    if not hasattr(tensor, "__dlpack__"):
        raise breach(module, name, f"{name}() offers neither __dlpack__ nor to_torch()")
    torch = _torch(module)
    return torch.from_dlpack(tensor)


def _to_torch(tensor: Any, name: str, module: str) -> Any:
    if not hasattr(tensor, "to_torch"):
        raise breach(module, name, f"{name}() offers neither __dlpack__ nor to_torch()")
    _torch(module)
    return tensor.to_torch()


def _torch(module: str) -> Any:
    try:
        import torch
    except ImportError:
        raise UsageError(
            f"madrona module '{module}': its tensors need PyTorch, which is not installed: pip install torch "
            "(on the CPU, tensors that offer __dlpack__ do without)"
        ) from None
    return torch
