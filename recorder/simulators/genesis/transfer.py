"""Slots of torch's tensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gpusimbench.recorder.simulators.slots import Shapes, Slot, Slots


class TorchSlot(Slot):
    """A slot on a torch device."""

    def __init__(self, first: int, arrays: Mapping[str, Any], host: Mapping[str, Any], copying: Any) -> None:
        """copying  the stream that copies; None on the CPU"""
        super().__init__(first, arrays, host)
        self._copying = copying
        self._copied: Any = None

    def begin_copy(self, rows: int) -> None:
        """See Slot.begin_copy."""
        if self._copying is None:
            return
        import torch

        self._copying.wait_stream(torch.cuda.current_stream(self._copying.device))
        with torch.cuda.stream(self._copying):
            for name, array in self.arrays.items():
                self._host[name][:rows].copy_(array[:rows], non_blocking=True)
        # a thread that waits for a blocking event leaves the processor to those that write
        self._copied = self._copying.record_event(self._copied or torch.cuda.Event(blocking=True))

    def wait(self) -> None:
        """See Slot.wait."""
        if self._copied is not None:
            self._copied.synchronize()


class TorchSlots(Slots):
    """Slots on a torch device."""

    def __init__(self, device: Any, shapes: Shapes) -> None:
        """device  torch.device
        shapes  with torch's dtypes
        """
        import torch

        on_gpu = device.type == "cuda"
        self._device = device
        self._copying = torch.cuda.Stream(device) if on_gpu else None
        super().__init__(shapes, pinned=on_gpu)

    def _allocated(self, shape: tuple[int, ...], dtype: Any, *, pinned: bool) -> Any:
        import torch

        return torch.empty(shape, dtype=dtype, device="cpu" if pinned else self._device, pin_memory=pinned)

    def _slot(self, first: int, arrays: Mapping[str, Any], host: Mapping[str, Any]) -> TorchSlot:
        return TorchSlot(first, arrays, host, self._copying)
