"""The process of one run: ``python -m recorder.child``, started by ``recorder.launch``.

Standard input holds the task as JSON; the file descriptor named there takes progress, one JSON object a line. The run
works in a scratch folder. Whatever the engine prints, and whatever log files it leaves there, becomes an attachment of
the recording.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from recorder import interruption
from schemas.configuration import RunConfiguration
from schemas.errors import ExitCode, GsbError

_LOG_BYTES = 1 << 20  # of each file; an engine that warns at every step would fill a disk


def main() -> int:
    """Record the run that standard input describes; returns the exit code."""
    interruption.install()
    task = json.load(sys.stdin)
    report = _reporter(task["report_fd"])
    with tempfile.TemporaryDirectory(prefix="gsb-run-") as scratch:
        os.chdir(scratch)
        return _record(task, report, _capture_output(Path(scratch)))


def _record(task: dict[str, Any], report: Callable[[dict[str, Any]], None], log: Callable[[], bytes]) -> int:
    try:
        from recorder.run import Run

        run = Run(
            RunConfiguration.from_json(task["configuration"]),
            Path(task["path"]),
            run_id=task["run_id"],
            argv=tuple(task["argv"]),
            created=task["created"],
            progress=lambda phase, done, of: report({"phase": phase, "done": done, "of": of}),
            log=log,
        )
        outcome = run.record()
    except GsbError as error:
        report({"error": str(error), "exit_code": int(error.exit_code)})
        return int(error.exit_code)
    except KeyboardInterrupt:
        report({"error": "interrupted", "exit_code": int(ExitCode.FAILURE)})
        return int(ExitCode.FAILURE)
    report({"status": outcome.status.lower(), "reason": outcome.reason})
    return int(ExitCode.OK)


def _reporter(fd: int) -> Callable[[dict[str, Any]], None]:
    stream = os.fdopen(fd, "w", buffering=1)

    def report(record: dict[str, Any]) -> None:
        try:
            stream.write(json.dumps(record) + "\n")
        except OSError:
            # The recorder that started this run is gone: end the recording instead of computing for nobody.
            signal.raise_signal(signal.SIGINT)

    return report


def _capture_output(scratch: Path) -> Callable[[], bytes]:
    file = (scratch / "output").open("w+b")  # lives as long as the process
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(file.fileno(), 1)
    os.dup2(file.fileno(), 2)

    def read() -> bytes:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        return b"".join(_head(path) for path in sorted(scratch.iterdir()) if path.is_file() and path.stat().st_size)

    return read


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return f"--- {path.name}\n".encode() + stream.read(_LOG_BYTES) + b"\n"


if __name__ == "__main__":
    sys.exit(main())
