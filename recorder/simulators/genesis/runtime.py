"""Genesis itself, which a process initialises once at a time: its device, precision and array mode."""

from __future__ import annotations

import gc
import sys
from typing import Any

from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.schemas.errors import GsbError, UsageError

_SEEDS = 1 << 31  # NumPy and Quadrants take 32-bit seeds, the latter signed


def start(options: GenesisOptions, *, deterministic: bool | None, seed: int) -> Any:
    """The genesis module, initialised; stop() comes before the next.

    deterministic  its switch use_deterministic_algorithms; None leaves it to the engine
    seed           of its random generators and of those of torch, NumPy and Python, folded to 31 bits; stepping draws
                   nothing
    """
    _refuse_other_kernels(options)
    hook = sys.excepthook
    import genesis
    import torch

    sys.excepthook = hook  # Genesis puts one in its place that prints to standard output
    wanted = options.device
    if wanted == "auto":
        wanted = "cuda" if torch.cuda.is_available() else "cpu"
    elif wanted == "cuda" and not torch.cuda.is_available():
        raise UsageError("option 'device' is auto, cpu or cuda; torch sees no CUDA GPU here")
    genesis.init(
        backend=genesis.cuda if wanted == "cuda" else genesis.cpu,
        precision=str(options.precision),
        seed=seed % _SEEDS,
        performance_mode=options.performance_mode,
        use_deterministic_algorithms=deterministic,
        logging_level="warning",
    )
    return genesis


def stop() -> None:
    """Destroy what start initialised, scenes and device memory included. Nothing may refer to its arrays any more."""
    gc.collect()
    genesis = sys.modules.get("genesis")
    if genesis is not None:
        genesis.destroy()


def synchronise(genesis: Any) -> None:
    """Wait until the device has done all that it was given."""
    if genesis.device.type == "cuda":
        import torch

        torch.cuda.synchronize()


def device_name(genesis: Any) -> str:
    """As a recording names it."""
    if genesis.device.type == "cpu":
        return "cpu"
    import torch

    return str(torch.cuda.get_device_name(genesis.device))


def switches(genesis: Any) -> dict[str, Any]:
    """What decides which numbers come out, as the initialised engine has it."""
    import quadrants
    import torch

    compiled = quadrants.lang.impl.current_cfg()
    return {
        "precision": f"float{genesis.np_float().itemsize * 8}",
        "use_deterministic_algorithms": bool(genesis.use_deterministic_algorithms),
        "array_mode": "ndarray" if genesis.use_ndarray else "static (performance mode)",
        "fast_math": bool(compiled.fast_math),
        "cpu_threads": int(compiled.cpu_max_num_threads),
        "quadrants": ".".join(map(str, quadrants.__version__)),
        "torch": str(torch.__version__),
    }


def _refuse_other_kernels(options: GenesisOptions) -> None:
    # kernels are declared for one array mode and one precision, at import
    genesis = sys.modules.get("genesis")
    if genesis is None or genesis.use_ndarray is None:
        return
    if genesis.use_ndarray == options.performance_mode or genesis.np_float().itemsize * 8 != options.precision:
        raise GsbError(
            "performance_mode and precision of Genesis must be chosen before it is first initialised: "
            "use a fresh process"
        )
