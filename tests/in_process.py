"""The commands, run in the process of the tests: what a process of its own would print, write and end with."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, chdir, contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any, cast
from unittest import mock

_ROOT = Path(__file__).resolve().parents[1]
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)


@cache
def _entry_points() -> dict[str, str]:
    return tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]


def in_process(
    name: str, *arguments: object, cwd: str | os.PathLike[str] | None = None, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Call the entry point of an installed command; whatever it raises but SystemExit is raised here.

    env  the command's environment. Of what Python reads at its start, PYTHONPATH alone is obeyed.
    """
    module, _, function = _entry_points()[name].partition(":")
    given = [str(argument) for argument in arguments]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with ExitStack() as stack:
            if cwd is not None:
                stack.enter_context(chdir(cwd))
            if env is not None:
                stack.enter_context(_environment(env))
            stack.enter_context(_same_handlers())
            stack.enter_context(mock.patch.object(sys, "argv", [name, *given]))
            stack.enter_context(_redirected("stdout", 1, out))
            stack.enter_context(_redirected("stderr", 2, err))
            try:
                code = getattr(importlib.import_module(module), function)()
            except SystemExit as ended:
                code = ended.code
        assert isinstance(code, int), f"{name} ended with {code!r}"
        return subprocess.CompletedProcess([name, *given], code, _text(out), _text(err))


@contextmanager
def _redirected(name: str, descriptor: int, file: IO[bytes]) -> Iterator[None]:
    # the descriptor too: engines print by themselves, and child processes inherit it
    before = getattr(sys, name)
    before.flush()
    kept = os.dup(descriptor)
    os.dup2(file.fileno(), descriptor)
    stream = open(descriptor, "w", encoding="utf-8", closefd=False)  # noqa: PTH123, SIM115
    setattr(sys, name, stream)
    try:
        yield
    finally:
        setattr(sys, name, before)
        try:
            stream.close()
        finally:
            os.dup2(kept, descriptor)
            os.close(kept)


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode("utf-8").replace("\r\n", "\n")


@contextmanager
def _same_handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, cast(Any, handler))


@contextmanager
def _environment(env: dict[str, str]) -> Iterator[None]:
    # modules of a folder that only this environment names are forgotten with it
    folders = [folder for folder in env.get("PYTHONPATH", "").split(os.pathsep) if folder and folder not in sys.path]
    known = set(sys.modules)
    with mock.patch.dict(os.environ, env, clear=True), mock.patch.object(sys, "path", [*folders, *sys.path]):
        try:
            yield
        finally:
            for name in set(sys.modules) - known:
                file = getattr(sys.modules[name], "__file__", None) or ""
                if any(Path(file).is_relative_to(folder) for folder in folders):
                    del sys.modules[name]
