"""A Python that runs are made with: this one, or another that need not have this project installed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from gpusimbench import schemas
from gpusimbench.recorder.probes.host import describe_software
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.scratch import scratch_folder

RECORDING = ("google.protobuf", "lz4", "mcap", "numpy", "psutil", "zstandard")
"""Import names that a run needs whatever its engine is."""

_PROBE_TIMEOUT_S = 120  # a first start may compile, or read a slow disk

_PROBE = """
import json, sys
from importlib.util import find_spec
def missing(name):
    try:
        found = find_spec(name)
    except Exception:  # of a package whose parent is missing, or cannot be imported
        return True
    return found is None or found.origin is None  # a folder of that name is no package
print()
print(json.dumps({"version": list(sys.version_info[:3]), "missing": [n for n in sys.argv[1:] if missing(n)]}))
"""

_SOFTWARE = """
import json
from gpusimbench import schemas
from gpusimbench.recorder.probes.host import describe_software
print(json.dumps(describe_software()))
"""


@dataclass(frozen=True)
class Interpreter:
    """A Python executable, and how a process of it finds this project's code.

    python  absolute path; symbolic links are kept, since a virtual environment is known by them
    """

    python: Path

    @property
    def own(self) -> bool:
        """Whether it is the one that this process runs in."""
        return self.python == Path(sys.executable)

    def version(self) -> tuple[int, int, int]:
        """The version of Python. UsageError where it does not run."""
        return _probe(self.python, ())[0]

    def missing(self, names: Iterable[str]) -> tuple[str, ...]:
        """Those import names that it does not have; but for parents of dotted ones, none is imported.

        UsageError where it does not run.
        """
        return _probe(self.python, tuple(names))[1]

    def command(self, *arguments: str) -> list[str]:
        """A command line for one of its processes, which imports nothing from the folder it happens to start in."""
        return [str(self.python), "-P", *arguments]

    def environment(self, folder: Path) -> dict[str, str]:
        """Environment variables with which its processes import this very code, and nothing else of this Python.

        folder  empty, or used for the same before; it must stay as long as the processes
        """
        given = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
        root = _package().parent
        if not self.own:
            root = _only_our_package(folder)
        paths = [str(root), *map(os.path.abspath, given)]  # a run works in a folder of its own
        theirs = {k: v for k, v in os.environ.items() if self.own or k != "PYTHONHOME"}
        return {**theirs, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}

    def software(self) -> dict[str, Any]:
        """What recorder.probes.host says there."""
        if self.own:
            return describe_software()
        with scratch_folder() as (folder, _):
            said = _run(self.command("-c", _SOFTWARE), self.environment(folder))
        described: dict[str, Any] = json.loads(said)
        return described


def own() -> Interpreter:
    """The Python of this process."""
    return Interpreter(Path(sys.executable))


def at(path: Path) -> Interpreter:
    """The Python at that path, of that name on PATH, or of the virtual environment in that folder.

    UsageError where there is none that runs.
    """
    python = path / "bin" / "python" if path.is_dir() else path
    if len(path.parts) == 1 and not path.exists():
        python = Path(shutil.which(path) or path)
    interpreter = Interpreter(Path(os.path.abspath(python)))
    version = interpreter.version()
    if version < (3, 11):
        raise UsageError(f"{path} is Python {'.'.join(map(str, version))}, and 3.11 is the oldest that can record")
    return interpreter


def forget() -> None:
    """Look anew at what Pythons have: something was installed."""
    _probe.cache_clear()


def _only_our_package(folder: Path) -> Path:
    # Installed, the parent of the package is all of site-packages: a link to the package leaves the rest behind.
    code = folder / "code"
    code.mkdir(exist_ok=True)
    link = code / _package().name
    if not link.is_symlink():
        link.symlink_to(_package())
    return code


def _package() -> Path:
    # in a checkout schemas is a link, and what it lies in is found by where the link is
    return Path(os.path.abspath(schemas.__path__[0])).parent


@cache
def _probe(python: Path, names: tuple[str, ...]) -> tuple[tuple[int, int, int], tuple[str, ...]]:
    # by variable and not by -P, so that Pythons that are too old to know it still tell their version
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONHOME"} | {"PYTHONSAFEPATH": "1"}
    answer = _run([str(python), "-c", _PROBE, *names], environment)
    try:
        said = json.loads(answer.splitlines()[-1])
        major, minor, micro = said["version"]
    except (ValueError, LookupError, TypeError):
        raise UsageError(f"{python} is no Python that runs: it did not answer") from None
    return (major, minor, micro), tuple(said["missing"])


def _run(command: list[str], environment: Mapping[str, str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=_PROBE_TIMEOUT_S)
    except OSError as error:
        raise UsageError(f"{command[0]} is no Python that runs: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise UsageError(f"{command[0]} did not answer within {_PROBE_TIMEOUT_S} s") from None
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["it said nothing"]
        raise UsageError(f"{command[0]} is no Python that runs: {said[-1]}")
    return done.stdout
