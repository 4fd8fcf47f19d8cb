"""What a user does with a file, and everything that he sees in it."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench import open_recording
from gpusimbench.evaluator.inputs.reader import Reader
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import GsbError

SECONDS_A_STEP = 120
"""No file of the soak's size may take longer over any one thing that is done with it."""

CODES = (0, 1, 3, 4, 5)
"""How a command may end whose own arguments are right; 2 where it says that the file is none for it."""


class Hang(BaseException):
    """Something took longer than SECONDS_A_STEP."""


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    """Raise Hang where the block does not come to its end."""

    def stop(*_: object) -> None:
        raise Hang(f"more than {SECONDS_A_STEP} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, SECONDS_A_STEP)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _feed(digest, getattr(value, field.name))
    elif isinstance(value, dict):
        for key in sorted(value):
            digest.update(repr(key).encode())
            _feed(digest, value[key])
    elif isinstance(value, (tuple, list)):
        digest.update(f"{len(value)} of".encode())
        for part in value:
            _feed(digest, part)
    else:
        digest.update(repr(value).encode())


def _fixed(value: Any) -> str:
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def parts(recording: Recording) -> dict[str, Callable[[], Any]]:
    """Everything that a recording holds, by name, read when called."""
    r = recording
    wanted: dict[str, Callable[[], Any]] = {
        name: (lambda name=name: getattr(r, name))  # type: ignore[misc]
        for name in (
            "provenance", "simulation", "status", "reason", "cause", "content_hash", "timing", "memory", "counts",
            "overflows", "action_streams", "events", "dropouts", "scene", "action_names",
        )
    }  # fmt: skip
    for phase in ("capture", "timed"):
        wanted[f"fingerprints {phase}"] = lambda phase=phase: r.fingerprints(phase)  # type: ignore[misc]
    for f in r.fields:
        wanted[f"state {f.name}"] = lambda f=f: _state(r, f.group, f.field)  # type: ignore[misc]
    for name in r.action_names:
        wanted[f"actions {name}"] = lambda name=name: r.actions(name)  # type: ignore[misc]
    for name in r.attachment_names():
        wanted[f"attachment {name}"] = lambda name=name: r.attachment(name)  # type: ignore[misc]
    return wanted


def _state(recording: Recording, group: str, field: str) -> Any:
    array = recording.state(group, field)
    return array.steps, np.asarray(array)


def seen(recording: Recording) -> dict[str, str]:
    """A digest of each of its parts. GsbError where one cannot be read."""
    return {name: _fixed(read()) for name, read in parts(recording).items()}


def first_states(recording: Recording, rows: int) -> dict[str, bytes]:
    """The states up to a row, as bytes, by field."""
    found = {}
    for field in recording.fields:
        array = recording.state(field.group, field.field)
        found[field.name] = b"".join(array[at].tobytes() for at, step in enumerate(array.steps) if step < rows)
    return found


def use(path: Path, other: Path, turn: int) -> None:
    """Do what a user can: read each part though others are damaged, evaluate, run a command.

    other  a good recording to hold it against
    turn   which of the ways to evaluate, and which of the commands

    Raises whatever is no GsbError.
    """
    with in_time(), contextlib.suppress(GsbError):
        recording = open_recording(path)
        for read in parts(recording).values():
            with contextlib.suppress(GsbError):
                read()
    with in_time(), contextlib.suppress(GsbError):
        read = [Reader(5.0, verify=False)(file) for file in ([path], [path, other])[turn % 2]]
        evaluate(read, reference=read[0] if isinstance(read[0], Run) else None)
    with tempfile.TemporaryDirectory(dir=path.parent) as out:
        calls = command_lines(path, other, Path(out))
        name, arguments = calls[turn % len(calls)]
        with in_time():
            code = _call(name, arguments)
    if code not in CODES and not (code == 2 and name == "share"):
        raise AssertionError(f"gsb-{name} {' '.join(arguments)} ended with {code}")


def command_lines(path: Path, other: Path, out: Path) -> list[tuple[str, list[str]]]:
    """Each command on the file, and each that compares on it and a good one; what they write goes to a folder."""
    return [
        ("eval", ["--json", "-", str(path)]),
        ("eval", [str(path), str(other), "--no-verify", "--reference", str(path)]),
        ("info", [str(path)]),
        ("info", ["--json", "-", str(path)]),
        ("check", [str(path)]),
        ("diff", [str(path), str(other)]),
        ("diff", [str(other), str(path)]),
        ("share", ["pack", str(path), "--out", str(out / "packed")]),
        ("share", ["unpack", str(path), "--out", str(out / "unpacked")]),
        ("share", ["recover", str(path), "--out", str(out / "recovered.mcap")]),
        ("share", ["viewer", str(path), "--out", str(out / "view.mcap")]),
        ("view", [str(path), "--no-open", "--out", str(out / "view.html")]),
    ]


def _call(name: str, arguments: list[str]) -> int:
    module = __import__(f"gpusimbench.evaluator.cli.{name}", fromlist=["main"])
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as complaints:
        try:
            code = int(module.main(arguments))
        except SystemExit as ended:
            raise AssertionError(f"gsb-{name} {arguments}: {ended.code} {complaints.getvalue()}") from None
    assert "Traceback" not in complaints.getvalue()
    return code
