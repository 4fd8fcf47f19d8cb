"""The software that records: versions, commit, installed packages."""

from __future__ import annotations

import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from gpusimbench import schemas

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
