"""What every adapter on NVIDIA Warp needs: the device, its allocator, its determinism mode."""

from __future__ import annotations

from typing import Any

from gpusimbench.schemas.errors import UsageError

DEVICES = "auto, cpu or cuda"

# names of warp.DeterministicMode, in the words of an option
MODES = {"off": "NOT_GUARANTEED", "run-to-run": "RUN_TO_RUN", "gpu-to-gpu": "GPU_TO_GPU"}


def start(device: str, mode: str = "off") -> Any:
    """Warp's device of that name, "auto" being the first GPU or else the CPU; to be called before any kernel is built.

    mode  one of MODES: whether Warp orders the atomic operations of the kernels that it builds from here on
    """
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    wp.config.deterministic = wp.DeterministicMode[MODES[mode]]
    wp.init()
    if device == "auto":
        device = "cuda:0" if wp.is_cuda_available() else "cpu"
    if device.startswith("cuda:") and device != "cuda:0":
        # memory is read from the first GPU that CUDA shows
        raise UsageError(f"option 'device' is {DEVICES}, not '{device}': choose a GPU with CUDA_VISIBLE_DEVICES")
    try:
        found = wp.get_device(device)
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"option 'device' is {DEVICES}; Warp has no '{device}' here: {error}") from None
    wp.set_device(found)
    return found


def has_mode(mode: str) -> bool:
    """Whether kernels of modules that are imported already were made under this mode."""
    import warp as wp

    return bool(wp.config.deterministic == wp.DeterministicMode[MODES[mode]])


def name_of(device: Any) -> str:
    """As a recording names it."""
    return str(device.name) if device.is_cuda else "cpu"


def allocator_bytes(device: Any) -> tuple[int, int] | None:
    """Bytes in use and their peak in Warp's memory pool of a GPU; None on the CPU, or where there is no pool."""
    import warp as wp

    if not device.is_cuda or not device.is_mempool_supported:
        return None
    return int(wp.get_mempool_used_mem_current(device)), int(wp.get_mempool_used_mem_high(device))
