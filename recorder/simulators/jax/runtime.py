"""What every adapter on JAX needs: the device, its allocator, XLA's flags, the compilation cache.

XLA reads its flags once, when a process first uses a device; they are set in the environment before anything of JAX is
imported (``Simulator.environment``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench.recorder.options import one_of
from gpusimbench.schemas.errors import UsageError

DEVICES = ("auto", "cpu", "cuda")

_AUTOTUNE = "--xla_gpu_autotune_level=0"
_EXCLUDE = "--xla_gpu_exclude_nondeterministic_ops=true"
_DETERMINISTIC = "--xla_gpu_deterministic_ops=true"

_FLAGS: dict[str, tuple[str, ...]] = {
    "default": (),
    "no-autotune": (_AUTOTUNE,),
    "exclude-nondeterministic": (_EXCLUDE,),
    "run-to-run": (_DETERMINISTIC, _AUTOTUNE),
}

LEVELS = {
    "default": "the engine as it ships: XLA times candidates and chooses among them, operations may be atomic",
    "no-autotune": f"XLA_FLAGS={_AUTOTUNE}: no choice by timing; operations may be atomic",
    "exclude-nondeterministic": f"XLA_FLAGS={_EXCLUDE}: no operation whose result depends on order; choices by timing",
    "run-to-run": f"XLA_FLAGS={_DETERMINISTIC} {_AUTOTUNE}: both. Kernels of Warp (impl=warp) know none of these flags",
}
"""Determinism levels of adapters on JAX; between them they tell whether timing or operations make runs differ."""

LEVELS_OF_GPUS = tuple(level for level in LEVELS if level != "default")
"""Those that set flags of XLA's compiler for GPUs."""


@dataclass(frozen=True)
class JaxOptions:
    """Options of engines on JAX.

    device         auto (JAX's default), cpu or cuda
    ring           states that a capture keeps on the device before they are copied; 0: as many as 256 MB hold, 50 at
                   most
    compile_cache  folder in which JAX keeps compiled programs; empty: none. With it, a later process runs the very
                   program that an earlier one compiled, choices by timing included
    """

    device: str = "auto"
    ring: int = 0
    compile_cache: str = ""

    def __post_init__(self) -> None:
        one_of("device", self.device, DEVICES)
        if self.compile_cache and not Path(self.compile_cache).is_absolute():
            raise ValueError("compile_cache is an absolute path: a run works in a folder of its own, which it removes")
        if self.ring < 0:
            raise ValueError("ring is 0 (what fits) or a positive number")


def environment(options: JaxOptions, determinism: str) -> dict[str, str]:
    """What must be set before JAX is imported.

    Memory is taken as it is needed, not three quarters of the device at once: else no reading of it would mean
    anything. On the CPU no other device is touched.
    """
    wanted = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    if flags := _FLAGS[determinism]:
        wanted["XLA_FLAGS"] = " ".join(flags)
    if options.device == "cpu":
        wanted["JAX_PLATFORMS"] = "cpu"
    return wanted


def start(options: JaxOptions) -> Any:
    """The jax.Device that steps, made the default one; UsageError where there is none of that kind."""
    import jax

    if options.compile_cache:
        folder = Path(options.compile_cache).absolute()
        jax.config.update("jax_compilation_cache_dir", str(folder))
    try:
        found = (jax.devices() if options.device == "auto" else jax.devices(options.device))[0]
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise UsageError(f"option 'device': JAX has no '{options.device}' here: {reason}") from None
    jax.config.update("jax_default_device", found)
    return found


def name_of(device: Any) -> str:
    """As a recording names it."""
    return "cpu" if device.platform == "cpu" else str(device.device_kind)


def switches(determinism: str) -> dict[str, Any]:
    """What decides which numbers JAX comes to."""
    import jax

    return {
        "precision": "float32",
        "determinism": determinism,
        "jax": jax.__version__,
        "matmul_precision": jax.config.jax_default_matmul_precision or "default",
        "xla_flags_of_level": " ".join(_FLAGS[determinism]),
    }


def allocator_bytes(device: Any) -> tuple[int, int] | None:
    """Bytes in use and their peak in JAX's allocator of a GPU; None on the CPU, which keeps no such count."""
    stats = device.memory_stats()
    if not stats or "bytes_in_use" not in stats:
        return None
    return int(stats["bytes_in_use"]), int(stats.get("peak_bytes_in_use", stats["bytes_in_use"]))
