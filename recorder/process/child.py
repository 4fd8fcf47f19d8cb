"""The process of one run: ``python -m gpusimbench.recorder.process.child FD``, started by ``recorder.process.launch``.

Standard input holds the task as JSON; the file descriptor FD takes progress and then how the run ended, one JSON object
a line. The run works in a scratch folder, which holds what the engine prints as well. Whatever is there at the end
becomes an attachment of the recording.

The process begins with interruptions blocked; the run takes the first one once its recording has begun.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gpusimbench.schemas.errors import ExitCode, GsbError

_LOG_BYTES = 1 << 20  # of each file; an engine that warns at every step would fill a disk


def main() -> int:
    """Record the run that standard input describes; returns the exit code. Whatever goes wrong is reported."""
    report = _reporter(int(sys.argv[1]))
    scratch: Path | None = None
    try:
        task = json.load(sys.stdin)
        scratch = Path(task["scratch"])
        os.chdir(scratch)
        last = _record(task, report, scratch)
    except GsbError as error:
        last = {"error": str(error), "exit_code": int(error.exit_code)}
    except KeyboardInterrupt:
        last = {"error": "interrupted", "exit_code": int(ExitCode.FAILURE)}
    except BaseException as error:
        text = " ".join(str(error).split()) or "no message"
        last = {"error": f"{type(error).__name__}: {text}", "exit_code": int(ExitCode.FAILURE)}
    if scratch is not None:
        shutil.rmtree(scratch, ignore_errors=True)  # whoever started this may be there no more to do it
    report(last)
    return int(last.get("exit_code", ExitCode.OK))


def _record(task: dict[str, Any], report: Callable[[dict[str, Any]], None], scratch: Path) -> dict[str, Any]:
    from gpusimbench.recorder.interruption import MARK
    from gpusimbench.recorder.run.run import Run
    from gpusimbench.schemas.provenance import Provenance

    run = Run(
        Provenance.from_json(task["provenance"]),
        Path(task["path"]),
        progress=lambda phase, done, of: report({"phase": phase, "done": done, "of": of}),
        log=_log_of(scratch),
        interrupted=(scratch / MARK).exists,
        reserved=True,
        inputs={path.name: path.read_bytes() for path in Path(task["inputs"]).iterdir()} if task["inputs"] else {},
    )
    outcome = run.record()
    return {"status": outcome.status.lower(), "reason": outcome.reason, "cause": outcome.cause}


def _reporter(fd: int) -> Callable[[dict[str, Any]], None]:
    os.set_inheritable(fd, False)  # no process of the engine's keeps the recorder waiting for this one's end
    stream = os.fdopen(fd, "w", buffering=1)

    def report(record: dict[str, Any]) -> None:
        try:
            stream.write(json.dumps(record) + "\n")
        except OSError:
            # The recorder that started this run is gone: end the recording instead of computing for nobody.
            signal.raise_signal(signal.SIGINT)

    return report


def _log_of(scratch: Path) -> Callable[[], bytes]:
    def read() -> bytes:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        try:
            return b"".join(_head(path) for path in sorted(scratch.iterdir()) if path.is_file() and path.stat().st_size)
        except OSError as error:  # systems remove old temporary files by themselves: no reason to lose a recording
            return f"--- what was printed cannot be read: {error.strerror}\n".encode()

    return read


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return f"--- {path.name}\n".encode() + stream.read(_LOG_BYTES) + b"\n"


if __name__ == "__main__":
    sys.exit(main())
