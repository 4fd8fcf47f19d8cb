"""Whether SAPIEN computes with the libraries that its makers released, or with others of the same names.

libsapien.so has PhysX for CPUs in it; PhysX for GPUs is a file of its own. A build of SAPIEN on another PhysX calls
itself by the same version, so the libraries are told by their hashes.
"""

from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path

PHYSX = "105.1-physx-5.3.1.patch0"
"""The PhysX that is published beside the releases of SAPIEN below."""

_LIBRARIES = {"3.0.3": frozenset({"57b9dbf776bd216a2a71c86c34fadeab12469cc9067f6bf2338234499d80f097"})}
"""SHA-256 of libsapien.so by release: of the wheels on PyPI, x86-64, the same for every Python."""


def library() -> Path | None:
    """The libsapien.so beside the installed package; None where there is none."""
    spec = importlib.util.find_spec("sapien")
    if spec is None or spec.origin is None:
        return None
    site = Path(spec.origin).parent.parent
    return next((path for path in (site / "sapien.libs").glob("libsapien*.so*")), None)


def sha256(path: Path | None) -> str:
    """Of a file, as hexadecimal digits; empty where there is no file."""
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
