"""What SAPIEN has once a process: PhysX's library for GPUs, which its wheel leaves out and it would fetch unasked;
settings that it reads when a system or a body is made, set anew for every simulator; and whether it computes with the
libraries that its makers released.

libsapien.so has PhysX for CPUs in it; PhysX for GPUs is a file of its own. A build of SAPIEN on another PhysX calls
itself by the same version, so the libraries are told by their hashes.
"""

from __future__ import annotations

import ctypes
import hashlib
import platform
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gpusimbench.recorder.scenes.base import Vector
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.schemas.errors import UsageError

PHYSX = "105.1-physx-5.3.1.patch0"
"""The PhysX that is published beside the releases of SAPIEN below."""

_LIBRARIES = {"3.0.3": frozenset({"57b9dbf776bd216a2a71c86c34fadeab12469cc9067f6bf2338234499d80f097"})}
"""SHA-256 of libsapien.so by release: of the wheels on PyPI, x86-64, the same for every Python."""


def library() -> Path | None:
    """The libsapien.so beside the installed package; None where there is none."""
    spec = find_spec("sapien")
    if spec is None or spec.origin is None:
        return None
    site = Path(spec.origin).parent.parent
    return next((path for path in (site / "sapien.libs").glob("libsapien*.so*")), None)


def sha256(path: Path | None) -> str:
    """The SHA-256 digest of a file, as hexadecimal digits; empty where there is no file."""
    if path is None or not path.is_file():
        return ""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def modification(version: str, physx: str, digest: str) -> str:
    """How what is installed differs from SAPIEN as released, a clause; empty where it is the release.

    version  of SAPIEN
    physx    the version of PhysX that it says it has
    digest   SHA-256 of libsapien.so, empty where it was not found
    """
    if version not in _LIBRARIES:
        return f"no release known here: SAPIEN {version} with PhysX {physx}; known: {', '.join(_LIBRARIES)}"
    if physx != PHYSX:
        return f"PhysX {physx}, where SAPIEN {version} is released with {PHYSX}"
    if digest not in _LIBRARIES[version]:
        found = f"has SHA-256 {digest[:12]}" if digest else "was not found"
        return f"libsapien.so {found}, which is not that of the released SAPIEN {version}"
    return ""


_PUBLISHED = "https://github.com/sapien-sim/physx-precompiled/releases/download"  # as in sapien/physx/__init__.py
_ARCHIVES = {"x86_64": "linux-so.zip", "amd64": "linux-so.zip", "aarch64": "linux-aarch64-so.zip"}
_DRIVER = "libcuda.so"


def library_path(version: str) -> Path:
    """Where SAPIEN looks for the library of that release of PhysX; only the variable HOME moves it."""
    return Path.home() / ".sapien" / "physx" / version / "libPhysXGpu_64.so"


def check_gpu() -> None:
    """Look for what PhysX needs to use a GPU, without turning it on.

    UsageError where something is missing that the user has to bring; nothing is downloaded.
    """
    from sapien import physx

    if find_spec("torch") is None:
        raise UsageError("on a GPU SAPIEN's memory is read through torch, which is not installed: pip install torch")
    if physx.is_gpu_enabled():
        return
    path = library_path(physx.version())
    if not path.is_file():
        whence = _whence(physx.version(), path.parent)
        raise UsageError(
            f"on a GPU SAPIEN needs PhysX's library {path}, which is not there; {whence}; "
            "this program downloads nothing"
        )
    try:
        ctypes.CDLL(_DRIVER, ctypes.RTLD_GLOBAL)
    except OSError as error:
        raise UsageError(
            f"on a GPU SAPIEN loads the driver's library by the name {_DRIVER}, without a number, which failed "
            f"({error}); on a machine with an NVIDIA driver a link of that name to libcuda.so.1 is enough"
        ) from None


def enable_gpu() -> None:
    """Let PhysX use a GPU, with a library that is there already: see check_gpu, and its errors."""
    from sapien import physx

    check_gpu()
    if not physx.is_gpu_enabled():
        physx.enable_gpu()


def _whence(version: str, folder: Path) -> str:
    if version != PHYSX:
        return (
            f"this SAPIEN has PhysX {version}, for which its makers publish none (they do for {PHYSX}): "
            "build it together with libsapien.so"
        )
    archive = _ARCHIVES.get(platform.machine().lower(), "linux-so.zip")
    return f"SAPIEN's makers publish it as {_PUBLISHED}/{version}/{archive}, to be unzipped into {folder}"


def configure(options: SapienOptions, *, gravity: Vector, enhanced_determinism: bool) -> None:
    """Set what the systems, bodies and shapes that are made from now on will have."""
    from sapien import physx

    physx.set_scene_config(
        gravity=np.array(gravity, dtype=np.float32),
        bounce_threshold=options.bounce_threshold,
        enable_pcm=options.enable_pcm,
        enable_tgs=options.enable_tgs,
        enable_ccd=options.enable_ccd,
        enable_enhanced_determinism=enhanced_determinism,
        enable_friction_every_iteration=options.enable_friction_every_iteration,
        cpu_workers=options.cpu_workers,
    )
    physx.set_body_config(
        solver_position_iterations=options.solver_position_iterations,
        solver_velocity_iterations=options.solver_velocity_iterations,
        sleep_threshold=options.sleep_threshold,
    )
    physx.set_shape_config(contact_offset=options.contact_offset, rest_offset=options.rest_offset)
