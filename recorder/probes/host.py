"""The machine that records, and its clock."""

from __future__ import annotations

import os
import platform
import time
from pathlib import Path
from typing import Any

NUMERIC_ENVIRONMENT = (
    "CUDA_",
    "CUBLAS_",
    "GLIBC_TUNABLES",
    "GS_",
    "JAX_",
    "LD_PRELOAD",
    "MKL_",
    "MUJOCO_",
    "NPY_",
    "NVIDIA_TF32_OVERRIDE",
    "NVIDIA_VISIBLE_DEVICES",
    "OMP_",
    "OPENBLAS_",
    "PYTHONHASHSEED",
    "QD_",
    "TF_CUDNN",
    "TF_DETERMINISTIC",
    "TI_",
    "WARP_",
    "XLA_",
)
"""Prefixes of environment variables that can change numbers or speed."""


def describe_host() -> dict[str, Any]:
    """CPU, memory and operating system. No host name and no user: recordings are shared."""
    import psutil

    return {
        "cpu": _cpuinfo("model name") or platform.processor() or "unknown",
        "cpu_flags": _cpu_flags(),
        "cores": psutil.cpu_count(logical=False),
        "threads": psutil.cpu_count(),
        "usable_threads": len(os.sched_getaffinity(0)),
        "memory_bytes": psutil.virtual_memory().total,
        "machine": platform.machine(),
        "system": platform.system(),
        "kernel": platform.release().partition("-")[0],  # the rest names a site's own builds
        "libc": " ".join(platform.libc_ver()),
    }


def numeric_environment() -> dict[str, str]:
    """The environment variables of NUMERIC_ENVIRONMENT that are set."""
    return {k: v for k, v in sorted(os.environ.items()) if k.startswith(NUMERIC_ENVIRONMENT)}


def memory_bytes() -> int:
    """Memory that this process may use [bytes]: the machine's, or less where a container or a batch job has a limit."""
    import psutil

    total: int = psutil.virtual_memory().total
    return min([total, *_group_limits()])


def _group_limits() -> list[int]:
    # of the control group of this process and of those around it, as both versions of the kernel's interface say it
    root, groups = Path("/sys/fs/cgroup"), [Path("/")]
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers in ("", "memory"):
            groups += [Path(path), *Path(path).parents]
    limits = []
    for group in groups:
        for file in (root / f".{group}" / "memory.max", root / "memory" / f".{group}" / "memory.limit_in_bytes"):
            try:
                limits.append(int(file.read_text()))
            except (OSError, ValueError):  # there is none: "max"
                continue
    return [limit for limit in limits if limit > 0]


def peak_rss_bytes() -> int:
    """Largest resident set of this process so far [bytes]."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _cpuinfo(key: str) -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() == key:
                return value.strip()
    except OSError:
        pass
    return ""


def _cpu_flags() -> list[str]:
    # the vector units decide which kernels a maths library picks, and so the last bits of its results
    relevant = ("sse4_2", "avx", "avx2", "fma", "avx512f", "avx512vl", "avx512_bf16", "amx_tile", "asimd", "sve")
    present = set((_cpuinfo("flags") or _cpuinfo("Features")).split())
    return [flag for flag in relevant if flag in present]


LAST_NS = 2**63 - 1
"""The largest time that a recording holds [ns]: a moment in 2262."""


def calendar_ns() -> int:
    """UTC since the Unix epoch [ns]; 0 where the machine's clock stands before it, LAST_NS behind what can be held."""
    return min(max(0, time.time_ns()), LAST_NS)


def clock_problem() -> str:
    """What is wrong with the machine's clock, and what is recorded instead; empty where nothing is."""
    now = time.time_ns()
    if 0 <= now <= LAST_NS:
        return ""
    when, instead = ("before 1970", "1970-01-01T00:00:00Z") if now < 0 else ("behind 2262", "the last moment that fits")
    return (
        f"this machine's clock stands {when}: calendar times within the recording are {instead}; set the clock. "
        "No interval is measured by it"
    )
