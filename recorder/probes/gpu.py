"""GPUs as NVML shows them. Absent NVML, an absent driver and no GPU all mean: no GPUs."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

_NOT_SUPPORTED = 3  # NVML_ERROR_NOT_SUPPORTED


@dataclass(frozen=True)
class Processes:
    """What NVML tells of the processes on a device; None is unknown, and never zero.

    own_bytes    of this process, as NVML lists it among those that compute
    others       processes beside this one and those that it started
    other_bytes  of them all; None also where NVML does not tell the bytes of one
    """

    own_bytes: int | None = None
    others: int | None = None
    other_bytes: int | None = None


class Gpus:
    """The GPUs that CUDA shows to this process; a context manager that holds NVML open.

    problems  one sentence for each GPU that is there and does not answer; it is left out
    """

    def __init__(self, *, hidden: bool = False) -> None:
        """hidden  those too that CUDA does not show, in NVML's order"""
        self._hidden = hidden
        self.problems: list[str] = []
        self._nvml: Any = None
        self._handles: list[Any] = []
        self._descends: dict[int, bool] = {}

    def __enter__(self) -> Gpus:
        try:
            import pynvml
        except ImportError:
            return self
        try:
            pynvml.nvmlInit()
        except pynvml.NVMLError:  # no driver, or no GPU
            return self
        self._nvml = pynvml
        try:
            count = pynvml.nvmlDeviceGetCount()
        except pynvml.NVMLError as error:
            self.problems.append(f"NVML does not say how many GPUs there are: {error}")
            return self
        for index in self._visible(count):
            try:
                self._handles.append(pynvml.nvmlDeviceGetHandleByIndex(index))
            except pynvml.NVMLError as error:
                self.problems.append(f"GPU {index} is left out, it does not answer: {error}")
        return self

    def _visible(self, count: int) -> list[int]:
        # In the order in which CUDA numbers them, so that GPU 0 here is the one that engines step on by default. CUDA
        # and NVML number the GPUs of a machine alike where CUDA_DEVICE_ORDER is PCI_BUS_ID or all are of one model.
        named = os.environ.get("CUDA_VISIBLE_DEVICES")
        if named is None or self._hidden:
            return list(range(count))
        found = []
        for name in (word.strip() for word in named.split(",")):
            index = int(name) if name.isdecimal() else self._index_of(name, count)
            if index is None or index >= count:
                break  # CUDA ignores this one and all behind it
            found.append(index)
        return found

    def _index_of(self, name: str, count: int) -> int | None:
        for index in range(count):
            try:
                uuid = self._nvml.nvmlDeviceGetUUID(self._nvml.nvmlDeviceGetHandleByIndex(index))
            except self._nvml.NVMLError:
                continue
            if name and (uuid.decode() if isinstance(uuid, bytes) else uuid).startswith(name):
                return index
        return None

    def __exit__(self, *details: object) -> None:
        if self._nvml:
            with suppress(self._nvml.NVMLError):  # the run is over, and nothing depends on it
                self._nvml.nvmlShutdown()
            self._nvml, self._handles = None, []

    def __len__(self) -> int:
        return len(self._handles)

    def describe(self) -> tuple[dict[str, Any], ...]:
        """Name, driver, memory, clocks and modes of each GPU; what a GPU does not tell is left out."""
        nvml = self._nvml
        described = []
        for handle in self._handles:
            queries: dict[str, Callable[[Any], Any]] = {
                "name": lambda h: nvml.nvmlDeviceGetName(h),
                "driver": lambda h: nvml.nvmlSystemGetDriverVersion(),
                "cuda_driver": lambda h: nvml.nvmlSystemGetCudaDriverVersion_v2(),
                "memory_bytes": lambda h: nvml.nvmlDeviceGetMemoryInfo(h).total,
                "compute_capability": lambda h: list(nvml.nvmlDeviceGetCudaComputeCapability(h)),
                "sm_clock_max_mhz": lambda h: nvml.nvmlDeviceGetMaxClockInfo(h, nvml.NVML_CLOCK_SM),
                "sm_clock_mhz": lambda h: nvml.nvmlDeviceGetClockInfo(h, nvml.NVML_CLOCK_SM),
                "memory_clock_mhz": lambda h: nvml.nvmlDeviceGetClockInfo(h, nvml.NVML_CLOCK_MEM),
                "power_limit_mw": lambda h: nvml.nvmlDeviceGetEnforcedPowerLimit(h),
                "ecc": lambda h: bool(nvml.nvmlDeviceGetEccMode(h)[0]),
                "mig": lambda h: bool(nvml.nvmlDeviceGetMigMode(h)[0]),
                "persistence_mode": lambda h: bool(nvml.nvmlDeviceGetPersistenceMode(h)),
            }
            record: dict[str, Any] = {}
            for key, query in queries.items():
                try:
                    value = query(handle)
                except (nvml.NVMLError, AttributeError):  # not on this GPU, or not in this version of the bindings
                    continue
                record[key] = value.decode(errors="replace") if isinstance(value, bytes) else value
            described.append(record)
        return tuple(described)

    def device_memory(self, index: int) -> tuple[int, int]:
        """Bytes in use on the whole device, and its capacity."""
        info = self._nvml.nvmlDeviceGetMemoryInfo(self._handles[index])
        return int(info.used), int(info.total)

    def reserved_memory(self, index: int) -> int | None:
        """Bytes of those in use that the driver keeps for itself; None where it does not tell."""
        try:
            info = self._nvml.nvmlDeviceGetMemoryInfo(self._handles[index], version=self._nvml.nvmlMemory_v2)
        except (self._nvml.NVMLError, AttributeError, TypeError):  # of older drivers, or of older bindings
            return None
        return int(info.reserved)

    def hardware(self, index: int) -> tuple[dict[str, int], dict[str, str]]:
        """How fast a GPU could run at this moment, by field of a HardwareSample; and by field why it is not known."""
        nvml, handle = self._nvml, self._handles[index]
        queries: dict[str, Callable[[], int]] = {
            "sm_clock_mhz": lambda: nvml.nvmlDeviceGetClockInfo(handle, nvml.NVML_CLOCK_SM),
            "memory_clock_mhz": lambda: nvml.nvmlDeviceGetClockInfo(handle, nvml.NVML_CLOCK_MEM),
            "power_mw": lambda: nvml.nvmlDeviceGetPowerUsage(handle),
            "temperature_c": lambda: nvml.nvmlDeviceGetTemperature(handle, nvml.NVML_TEMPERATURE_GPU),
            "throttle_reasons": lambda: self._throttle_reasons(handle),
            "utilisation_percent": lambda: nvml.nvmlDeviceGetUtilizationRates(handle).gpu,
        }
        told, not_known = dict[str, int](), dict[str, str]()
        for name, query in queries.items():
            try:
                told[name] = int(query())
            except nvml.NVMLError as error:
                not_known[name] = f"NVML: {error}"
            except AttributeError as error:
                not_known[name] = f"not in this version of the bindings: {error}"
        return told, not_known

    def _throttle_reasons(self, handle: Any) -> int:
        # older bindings have the older name alone, and older drivers answer to it alone
        nvml = self._nvml
        try:
            return int(nvml.nvmlDeviceGetCurrentClocksEventReasons(handle))
        except (nvml.NVMLError, AttributeError):
            return int(nvml.nvmlDeviceGetCurrentClocksThrottleReasons(handle))

    def processes(self, index: int, *, before_engine: bool) -> Processes:
        """What NVML attributes to the processes on the device, at this moment.

        In a container, NVML may list processes by numbers of another namespace, or none at all. So the others can be
        told from this process only where this process is listed, or where it cannot be: `before_engine`.
        """
        compute = self._listed("nvmlDeviceGetComputeRunningProcesses", index)
        if compute is None:
            return Processes()
        pid = os.getpid()
        own = compute.get(pid)
        graphics = self._listed("nvmlDeviceGetGraphicsRunningProcesses", index)
        if graphics is None or not (before_engine or pid in compute):
            return Processes(own)
        found = {**graphics, **compute}  # a process that does both is listed twice with the same bytes
        others = [used for other, used in found.items() if other != pid and not self._started_here(other)]
        told = [used for used in others if used is not None]
        return Processes(own, len(others), sum(told) if len(told) == len(others) else None)

    def _listed(self, query: str, index: int) -> dict[int, int | None] | None:
        # bytes by process number, None for bytes that NVML does not tell; None where it does not list
        nvml = self._nvml
        try:
            found = getattr(nvml, query)(self._handles[index])
        except AttributeError:  # not in this version of the bindings
            return None
        except nvml.NVMLError as error:
            # a device that draws nothing has no such processes
            draws = "Graphics" not in query or getattr(error, "value", None) != _NOT_SUPPORTED
            return None if draws else {}
        return {p.pid: p.usedGpuMemory for p in found}

    def _started_here(self, pid: int) -> bool:
        if pid not in self._descends:
            self._descends[pid] = _is_descendant(pid)
        return self._descends[pid]


def _is_descendant(pid: int) -> bool:
    import psutil

    try:
        return any(parent.pid == os.getpid() for parent in psutil.Process(pid).parents())
    except psutil.Error:  # it ended, or its number is of another namespace
        return False
