"""The process of one run on a node of a cluster: ``python -m gpusimbench.recorder.cluster.node``.

The first line of standard input says what is wanted, as JSON; what happens is said on standard output, one JSON object
a line. A further line is how often the user has interrupted by now. The end of standard input means that nobody waits
any more: a run in progress is killed, the folder with its files is removed, and the process ends.

    said                 when
    {"where": ...}       no run was asked for: machine and software, as of recorder.sets.finished
    {"phase": ...}       as the run's process reports it
    {"result": ...}      the run has ended; its "files" stay until the end of standard input
    {"error": ...}       nothing can be made here, and why; with an exit code
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench import recorder, schemas
from gpusimbench.recorder.environments.choice import check_known, interpreter_for
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.host import describe_software
from gpusimbench.recorder.process.launch import Interruptions, make
from gpusimbench.recorder.process.planned_run import PlannedRun
from gpusimbench.recorder.sets.finished import where_am_i
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.scratch import OUTPUT, scratch_folder

_READ = (".py", ".binpb")


@dataclass(frozen=True)
class Code:
    """This project's code that a Python imports: two machines agree where it is equal.

    version  of the package
    commit   of the checkout that it is imported from; empty where it is installed
    sha256   of the names and contents of all its modules that record
    """

    version: str
    commit: str
    sha256: str

    def __str__(self) -> str:
        commit = f", commit {self.commit[:12]}" if self.commit else ""
        return f"gpusimbench {self.version}{commit}, modules {self.sha256[:12]}"


def code() -> Code:
    """The version, commit and digest of the recorder that this process imports."""
    total = hashlib.sha256()
    for package in (recorder, schemas):
        root = Path(package.__path__[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in _READ):
            total.update(f"{package.__name__}/{path.relative_to(root).as_posix()}\n".encode())
            total.update(hashlib.sha256(path.read_bytes()).digest())
    told: dict[str, Any] = describe_software()["recorder"]
    return Code(schemas.__version__, told.get("commit") or "", total.hexdigest())


Say = Callable[[dict[str, Any]], None]

KILLING = 2
"""Interruptions, the last of which kills a run."""

_ORDER = "CUDA_DEVICE_ORDER"


def main() -> int:
    """Do what standard input asks for; returns the exit code. Whatever goes wrong is said."""
    if child := os.fork():  # Ray kills its worker's children before these can put anything in order, but not theirs
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    say = _sayer()
    wanted = json.loads(sys.stdin.readline())
    interruptions, left = Interruptions(), threading.Event()
    threading.Thread(target=_listen, args=(interruptions, left), daemon=True).start()
    with ExitStack() as stack:
        try:
            folder, _ = stack.enter_context(scratch_folder())
            _serve(wanted, folder, interruptions, say)
            ended = ExitCode.OK
        except GsbError as error:
            ended = error.exit_code
            say({"error": str(error), "exit_code": int(ended)})
        except Exception as error:
            ended = ExitCode.FAILURE
            say({"error": f"{type(error).__name__}: {error}", "exit_code": int(ended)})
        finally:
            left.wait()  # until the files have been read
    return int(ended)


def _serve(wanted: dict[str, Any], folder: Path, interruptions: Interruptions, say: Say) -> None:
    here = code()
    if here.sha256 != wanted["code"]:
        raise UsageError(f"it has other code of this project than the command: {here}")
    _number_gpus_as_nvml_does()
    python = Path(wanted["python"]) if wanted["python"] else None
    interpreter = interpreter_for(find_simulator(wanted["simulator"]), python)
    if wanted["run"] is None:
        check_known(interpreter, wanted["simulator"], wanted["scene"])
        say({"where": where_am_i(interpreter)})
        return

    def report(phase: str, done: int, of: int) -> None:
        say({"phase": phase, "done": done, "of": of})

    result = make(PlannedRun.from_json(wanted["run"]), folder, interpreter, report, interruptions)
    say(
        {
            "result": {
                "status": result.status,
                "reason": result.reason,
                "cause": result.cause,
                "exit_code": int(result.exit_code),
                "died": result.died,
                "file": result.path.name if result.path else None,
            },
            "folder": str(folder),
            "files": [_described(path) for path in sorted(folder.iterdir()) if path.is_file() and path.name != OUTPUT],
        }
    )


def _described(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return {"name": path.name, "size": path.stat().st_size, "sha256": digest}


def _number_gpus_as_nvml_does() -> None:
    # Ray counts GPUs as NVML does. CUDA does so by itself only where all are of one model, and a run would step on
    # another GPU than the one that was given to it, and than the one whose memory is read.
    if _ORDER in os.environ:
        return
    with Gpus(hidden=True) as gpus:
        if len({gpu.get("name") for gpu in gpus.describe()}) > 1:
            os.environ[_ORDER] = "PCI_BUS_ID"


def _listen(interruptions: Interruptions, left: threading.Event) -> None:
    for line in sys.stdin:
        _interrupt(interruptions, int(line))
    _interrupt(interruptions, KILLING)
    left.set()


def _interrupt(interruptions: Interruptions, count: int) -> None:
    while interruptions.count < min(count, KILLING):
        interruptions.add()


def _sayer() -> Say:
    # what libraries print goes elsewhere, and half a line of it spoils none of ours
    stream = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def say(record: dict[str, Any]) -> None:
        try:
            stream.write("\n" + json.dumps(record) + "\n")
        except OSError:  # whoever listened is gone, and standard input says so, too
            return

    return say


if __name__ == "__main__":
    sys.exit(main())
