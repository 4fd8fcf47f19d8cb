"""What every adapter on NVIDIA Warp needs: the device, its allocator, its determinism mode; and a scene's actions,
drawn or copied on the device step by step, bit for bit those of ``schemas.action_generator``."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.actions import table
from gpusimbench.schemas.action_generator import JointTargets, Streams
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


class DeviceActions:
    """Where actions come from on Warp's present device, by kernels that a graph may capture.

    step  number of the next step, an array of one
    """

    def __init__(self, actions: JointTargets, seed: int, streams: Streams) -> None:
        """seed, streams  as of JointTargets.draw"""
        import warp as wp

        self.step = wp.zeros(1, dtype=wp.int32)
        self._streams = [wp.array(a, dtype=wp.uint32) for a in (streams.env, streams.begun)]
        rows = table(actions)
        self._rows = None if rows is None else wp.array(rows, dtype=wp.float32)
        if self._rows is not None:
            return
        kinds = (wp.int32, wp.uint32, wp.float32)
        self._range = [wp.array(a, dtype=kind) for a, kind in zip(actions.grid(), kinds, strict=True)]
        self._seed_word = wp.uint32(actions.seed_word(seed))

    def follow(self, streams: Streams) -> None:
        """Go by these streams from now on, also in graphs that were captured before."""
        for array, numbers in zip(self._streams, (streams.env, streams.begun), strict=True):
            array.assign(numbers)

    def enqueue(self, ctrl: Any) -> None:
        """Write the actions of the next step into ctrl [env, action], and go on to the step after it."""
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        if self._rows is not None:
            inputs = [self.step, *self._streams, self._rows]
            wp.launch(kernels.give_row, dim=ctrl.shape, inputs=inputs, outputs=[ctrl])
        else:
            inputs = [self._seed_word, self.step, *self._streams, *self._range]
            wp.launch(kernels.draw_targets, dim=ctrl.shape, inputs=inputs, outputs=[ctrl])
        wp.launch(kernels.advance, dim=1, inputs=[self.step])
