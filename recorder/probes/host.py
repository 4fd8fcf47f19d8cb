"""The machine that records, its clock and its software: versions, commit, installed packages."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

from gpusimbench import schemas

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


NUMERIC_PACKAGES = (
    "brax",
    "genesis-world",
    "isaaclab",
    "jax",
    "jaxlib",
    "mani-skill",
    "mcap",
    "mujoco",
    "mujoco-mjx",
    "mujoco-warp",
    "newton",
    "numpy",
    "ovphysx",
    "ovstage",
    "playground",
    "protobuf",
    "quadrants",
    "sapien",
    "taichi",
    "torch",
    "warp-lang",
)
"""Distributions whose version can change a number; the whole list is attached as pip-freeze.txt."""


def describe_software() -> dict[str, Any]:
    """Versions of Python, of the recorder and of NUMERIC_PACKAGES."""
    return {
        "python": sys.version.split()[0],
        "implementation": platform.python_implementation(),
        "recorder": {"version": schemas.__version__, **_commit()},
        "packages": {name: version for name in NUMERIC_PACKAGES if (version := _version(name))},
    }


def package_list() -> str:
    """Every installed distribution, one "name==version" a line; of several versions of one, that which is imported."""
    versions: dict[str, str | None] = {}
    for found in metadata.distributions():  # in the order in which Python looks for modules
        name, version = _name_and_version(found)
        versions.setdefault(name, version)
    return "".join(f"{name}=={versions[name]}\n" for name in sorted(versions, key=lambda n: (n.lower(), n)))


def _version(distribution: str) -> str | None:
    try:
        return _name_and_version(metadata.distribution(distribution))[1]
    except metadata.PackageNotFoundError:
        return None


def _name_and_version(found: metadata.Distribution) -> tuple[str, str | None]:
    # importlib.metadata parses the description, too, a page of each package: half of the time of a short run
    try:
        text = found.read_text("METADATA") or found.read_text("PKG-INFO")
    except UnicodeDecodeError:  # of another package, which is no reason to record nothing
        return "?", None
    if text is None:  # a file alone, as distutils left it
        return found.metadata["Name"] or "?", found.version
    fields: dict[str, str] = {}
    for line in text.partition("\n\n")[0].split("\n"):  # splitlines() also splits values, at U+2028 and its like
        field, _, value = line.partition(":")
        fields.setdefault(field.lower(), value.strip())
    return fields.get("name") or "?", fields.get("version")


def _commit() -> dict[str, Any]:
    root = Path(schemas.__file__).resolve().parent.parent
    # only a checkout of this project itself: an installed package may lie inside somebody else's repository
    if not ((root / ".git").exists() and (root / "pyproject.toml").exists()):
        return {"commit": None}
    try:
        commit = _git(root, "rev-parse", "HEAD")
        changed = _git(root, "status", "--porcelain", "--untracked-files=no", "--", "schemas", "recorder")
    except (OSError, subprocess.SubprocessError):
        return {"commit": None}
    return {"commit": commit, "modified": bool(changed)}


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()
