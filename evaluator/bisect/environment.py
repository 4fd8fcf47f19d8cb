"""Environments of releases, by venv and pip, one release each; and what gsb-record records of each."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import as_path
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.writing import write_file

RECORDING = ("lz4", "mcap", "numpy", "protobuf", "psutil", "zstandard")
"""Distributions that a run of gsb-record needs whatever its engine is."""

_DONE = "gsb-bisect.txt"  # in an environment: what was asked of pip, once all of it is there
_ELSEWHERE = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PIP_USER", "PIP_TARGET", "PIP_PREFIX", "PIP_ROOT")
"""Variables that would lead Python or pip into another environment."""


class NotInstalled(GsbError):
    """A release that cannot be installed here."""


def is_version(text: str) -> bool:
    """Whether a text can be a version, and so the name of a folder and an argument of pip."""
    return re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+!-]*", text) is not None


def releases(package: str) -> tuple[str, ...]:
    """Versions of a package that pip can install into this Python, the oldest first; no pre-releases.

    UsageError where pip knows none.
    """
    text = _call([sys.executable, "-m", "pip", "index", "versions", "--disable-pip-version-check", package])
    found = re.search(r"^Available versions: (.+)$", text, re.MULTILINE)
    if found is None:
        raise UsageError(f"pip lists no versions of '{package}'; name the package with --package")
    return tuple(reversed([version.strip() for version in found[1].split(",")]))


def between(versions: tuple[str, ...], good: str, bad: str) -> tuple[str, ...]:
    """Those from good to bad; UsageError where one is not there, or bad is not later."""
    for option, version in (("--good", good), ("--bad", bad)):
        if version not in versions:
            known = f"; there are {versions[0]} to {versions[-1]}" if versions else ""
            raise UsageError(f"{option} {version}: there is no such release{known}{did_you_mean(version, versions)}")
    first, last = versions.index(good), versions.index(bad)
    if first >= last:
        raise UsageError(f"--bad {bad} is not later than --good {good}")
    return versions[first : last + 1]


def environment_of(folder: Path, package: str, version: str) -> Path:
    """The virtual environment in a folder, made unless it is there; its Python.

    Whatever else a run needs has the version that it has in this Python, so that nothing but the release changes. Where
    the release does not take that, pip chooses. NotInstalled where pip fails.
    """
    wanted = f"{package}=={version}"
    python = folder / "bin" / "python"
    done = folder / _DONE
    if done.is_file() and done.read_text(encoding="utf-8") == f"{wanted}\n" and python.exists():
        return python
    if folder.exists() and not (folder / "pyvenv.cfg").is_file():
        raise UsageError(f"{folder} is no environment that gsb-bisect made; name another folder with --out")
    shutil.rmtree(folder, ignore_errors=True)
    _call([sys.executable, "-m", "venv", str(folder)])
    pip = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--quiet"]
    try:
        _call([*pip, wanted, *(name if name == package else _pinned(name) for name in RECORDING)])
    except GsbError:
        try:
            _call([*pip, wanted, *RECORDING])
        except GsbError as error:
            raise NotInstalled(str(error)) from None
    write_file(done, f"{wanted}\n")
    return python


def _pinned(name: str) -> str:
    try:
        return f"{name}=={metadata.version(name)}"
    except metadata.PackageNotFoundError:
        return name


def _call(command: list[str]) -> str:
    environment = {k: v for k, v in os.environ.items() if k not in _ELSEWHERE} | {"PYTHONSAFEPATH": "1"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=environment)
    except OSError as error:
        raise GsbError(f"cannot start {command[0]}: {error.strerror}") from None
    if done.returncode:
        said = [text for text in done.stderr.splitlines() if text.startswith("ERROR")] or done.stderr.splitlines()
        raise GsbError(f"{' '.join(command[1:5])} ... failed: {said[-1] if said else 'it did not say why'}")
    return done.stdout


@dataclass(frozen=True)
class Plan:
    """The runs of every release.

    options  NAME=VALUE, with those by which every release of the engine steps in the same way
    steps    that are captured
    runs     of each release
    timed    whether there is a timed phase
    """

    simulator: str
    scene: str
    options: tuple[str, ...]
    n_env: int
    steps: int
    seed: int
    runs: int
    timed: bool

    def arguments(self, python: Path, runs: int, out: Path) -> list[str]:
        """Arguments of gsb-record for so many runs by that Python."""
        given = ["--sim", self.simulator, "--scene", self.scene, "--python", as_path(python)]
        given += [f"--option={option}" for option in self.options]
        given += ["--n-env", str(self.n_env), "--runs", str(runs), "--seed", str(self.seed)]
        given += ["--steps", str(self.steps)]
        given += ["--phases", "timed,capture" if self.timed else "capture"]
        return [*given, "--no-view", "--compression", "zstd", "--out", as_path(out)]

    def has(self, c: RunConfiguration) -> bool:
        """Whether a run is what this plan asks for."""
        found = (c.simulator, c.scene, c.n_env, c.seed, c.steps, "timed" in c.phases, c.option_words)
        return found == (
            self.simulator, self.scene, self.n_env, self.seed, self.steps, self.timed, sorted(self.options)
        )  # fmt: skip


def with_options(asked: tuple[str, ...], common: dict[str, str]) -> tuple[str, ...]:
    """The options that were asked for, after those that make releases step alike; the former decide."""
    given = {name for name, _, _ in (option.partition("=") for option in asked)}
    return (*(f"{name}={value}" for name, value in common.items() if name not in given), *asked)
