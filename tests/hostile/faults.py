"""Make every write, flush, renaming, link, creation and removal of a command fail in turn, and see what it leaves.

    python -m tests.hostile.faults
    python -m tests.hostile.faults --scenario eval-html --most 3

A call fails once (ENOSPC, EIO or EACCES), the disk is full from a call on, or the process is killed in it. Whatever
happens, the folder has the earlier result or the new one, each whole, and nothing beside; the exit code is documented,
and there is one message and no traceback. Prints one JSON object; the exit code is 1 where that is broken.

Not covered: allocations that fail and file systems without hard links.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.runs.validation import verify

SHIM = Path(__file__).with_name("faults.c")
KINDS = ("write", "fsync", "rename", "link", "create", "unlink", "mkdir")
_WRITE, _UNLINK = KINDS.index("write"), KINDS.index("unlink")
_FAIL, _FULL, _KILL = range(3)
MODES = ("fails", "and all later ones fail", "kills")
_ERRORS = {"write": errno.ENOSPC, "create": errno.EACCES, "mkdir": errno.EACCES}
_PATIENCE_S = 300
_CODES = (0, 1, 3, 4)  # 4: the synthetic recordings of a card break rules

Files = dict[str, bytes]


@dataclass(frozen=True)
class Scenario:
    """A command that writes into OUT.

    command    of the command's own name and its arguments; IN is the folder of recordings
    earlier    runs before it, whose results the command replaces; empty where it replaces none
    recording  what is written is a recording, in which times differ
    """

    command: tuple[str, ...]
    earlier: tuple[str, ...] = ()
    recording: bool = False


_CARD = ("share", "card", "OUT", "--licence", "CC-BY-4.0", "--author", "Doe, Jane", "--update", "--title")
_TRIALS = ("record", "--sim", "real", "--scene", "inclined-collision", "--trials", "IN/trials.csv", "--unit", "m")


def _twice(*command: str) -> Scenario:
    return Scenario(command, tuple("IN/b.mcap" if word == "IN/a.mcap" else word for word in command))


SCENARIOS = {
    "record": Scenario((*_TRIALS, "--out", "OUT/runs"), recording=True),
    "eval-json": _twice("eval", "IN/a.mcap", "--no-cache", "--json", "OUT/r.json"),
    "eval-html": _twice("eval", "IN/a.mcap", "--no-cache", "--html", "OUT/html"),
    "eval-tables": _twice("eval", "IN/a.mcap", "--no-cache", "--tables", "OUT", "--format", "csv,md"),
    "eval-figures": _twice("eval", "IN/a.mcap", "--no-cache", "--figures", "OUT"),
    "view": _twice("view", "IN/a.mcap", "--no-open", "--with", "page", "--out", "OUT/v.html"),
    "pack": Scenario(("share", "pack", "IN/a.mcap", "--out", "OUT/packed")),
    "unpack": Scenario(("share", "unpack", "IN/packed.mcap", "--out", "OUT/unpacked")),
    "recover": Scenario(("share", "recover", "IN/cut.mcap", "--out", "OUT/whole.mcap")),
    "viewer": Scenario(("share", "viewer", "IN/a.mcap", "--out", "OUT/viewer.mcap")),
    "card": Scenario((*_CARD, "Another name"), (*_CARD, "A name")),
}


def prepare(folder: Path) -> None:
    """Make the recordings that the commands read."""
    from gpusimbench.evaluator.cli import share
    from tests.synthetic import grid, write_recording

    write_recording(folder, grid(2), name="a.mcap")
    write_recording(folder, grid(2) + 0.01, run=1, name="b.mcap")
    whole = (folder / "a.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    (folder / "trials.csv").write_text("trial,cube,x,y\n" + "".join(f"a,{cube},0.1,0.2\n" for cube in range(27)))
    assert share.main(["pack", str(folder / "a.mcap"), "--out", str(folder / "packed")]) == 0
    (folder / "packed" / "a.mcap").rename(folder / "packed.mcap")


class Faults:
    """Runs commands with faults, in processes of their own that this one is copied to."""

    def __init__(self, shim: Path, folder: Path) -> None:
        from gpusimbench.evaluator.cli import eval as evaluate
        from gpusimbench.evaluator.cli import share, view
        from gpusimbench.recorder import cli as record

        self._mains: dict[str, Callable[[list[str]], int]] = {
            "eval": evaluate.main, "share": share.main, "view": view.main, "record": record.main,
        }  # fmt: skip
        self._shim = ctypes.CDLL(str(shim))
        self._shim.faults_seen.restype = ctypes.c_long
        self._given = folder / "in"
        self._given.mkdir()
        prepare(self._given)
        self._folder = folder

    def try_all(self, name: str, most: int) -> Iterator[dict[str, Any]]:
        """Every fault of a scenario, at most so many of a kind; what was broken, and a count of all that was tried."""
        scenario = SCENARIOS[name]
        earlier = self._earlier(scenario)
        out, code, said, counts = self._run(scenario, earlier, None)
        new = contents(out)
        if code not in _CODES or said.count("Traceback"):
            raise RuntimeError(f"{name} fails by itself: {said}")
        tried = 0
        for kind, count in enumerate(counts):
            for k in sorted({1 + i * (count - 1) // max(1, min(most, count) - 1) for i in range(min(most, count))}):
                for mode in (_FAIL, _FULL, _KILL) if kind == _WRITE else (_FAIL, _KILL):
                    out, ended, said, _ = self._run(scenario, earlier, (kind, k, mode))
                    tried += 1
                    for broken in judge(scenario, earlier, new, code, out, ended, said, mode, kind):
                        yield {"scenario": name, "call": f"{KINDS[kind]} {k}", "how": MODES[mode], "broken": broken}
        yield {"scenario": name, "tried": tried}

    def _earlier(self, scenario: Scenario) -> Files:
        if not scenario.earlier:
            return {}
        given = contents(self._given, "*.mcap") if "card" in scenario.earlier else {}
        if "card" in scenario.earlier:
            del given["cut.mcap"]
        out, code, said, _ = self._run(Scenario(scenario.earlier), given, None)
        if code not in (0, 4):
            raise RuntimeError(f"{' '.join(scenario.earlier)}: {said}")
        return contents(out)

    def _run(
        self, scenario: Scenario, earlier: Files, fault: tuple[int, int, int] | None
    ) -> tuple[Path, int, str, list[int]]:
        out, log, tally = self._folder / "out", self._folder / "log", self._folder / "tally"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        for path, data in earlier.items():
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            (out / path).write_bytes(data)
        words = [word.replace("IN/", f"{self._given}/").replace("OUT", str(out)) for word in scenario.command]
        tally.unlink(missing_ok=True)
        child = os.fork()
        if not child:
            self._child(words, out, log, tally, fault)
        _, status = os.waitpid(child, 0)
        said = log.read_text(errors="replace")
        counts, modules = json.loads(tally.read_text()) if tally.exists() else ([], [])
        if fault is None:
            _import(modules)
        return out, os.waitstatus_to_exitcode(status), said, counts

    def _child(self, words: list[str], out: Path, log: Path, tally: Path, fault: tuple[int, int, int] | None) -> None:
        code = 99
        try:
            signal.alarm(_PATIENCE_S)
            nowhere = os.open(os.devnull, os.O_RDWR)
            os.dup2(nowhere, 1)
            os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
            sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
            kind, k, mode = fault or (-1, 0, 0)
            error = _ERRORS.get(KINDS[kind], errno.EIO) if fault else 0
            self._shim.faults_arm(os.fsencode(out), kind, ctypes.c_long(k), mode, error)
            try:
                code = self._mains[words[0]](words[1:])
            except BaseException:
                import traceback

                traceback.print_exc()
            sys.stderr.flush()
            counts = [self._shim.faults_seen(one) for one in range(len(KINDS))]
            tally.write_text(json.dumps([counts, list(sys.modules)]))
        finally:
            os._exit(code)


def _import(modules: Iterable[str]) -> None:
    """Import what a command imported, so that its next processes need not: it is most of their time."""
    for name in modules:
        with suppress(ImportError):
            importlib.import_module(name)


def contents(folder: Path, pattern: str = "*") -> Files:
    """Every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob(pattern) if path.is_file()}


def judge(
    scenario: Scenario, earlier: Files, new: Files, good: int, out: Path, code: int, said: str, mode: int, kind: int
) -> Iterator[str]:
    """What is wrong with what a command left and said."""
    found = contents(out)
    killed = mode == _KILL
    if killed and code != -signal.SIGKILL:
        yield f"it ended with {code} where it was to be killed"
    strays = [path for path in found if path.endswith(".partial")]
    if killed or (kind == _UNLINK) or scenario.recording:  # what cannot be removed stays, under a name that says so
        found = {path: data for path, data in found.items() if path not in strays}
    if scenario.recording:
        whole = [path for path in found if _is_whole(out / path)]
        if len(whole) < len(found):
            yield f"not whole: {sorted(set(found) - set(whole))}"
        changed = bool(whole)
    elif found == new:
        changed = True
    elif found == earlier:
        changed = False
    elif killed and all(found.get(path) in (earlier.get(path), new.get(path)) for path in {*found, *earlier, *new}):
        changed = False  # killed between two names: each file is whole
    else:
        beside = sorted(set(found) - {*earlier, *new})
        torn = sorted(path for path in found if found[path] not in (earlier.get(path), new.get(path)))
        yield f"neither the earlier result nor the new one; beside them {beside}, torn {torn}"
        return
    if killed:
        return
    if code not in _CODES:
        yield f"exit code {code}"
    if code == good and not changed:
        yield "it said that all is well, and the result is not there"
    if "Traceback" in said or (code != good and not said.strip()):
        yield f"it said {said[-500:]!r}"


def _is_whole(path: Path) -> bool:
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.schemas.errors import GsbError

    try:
        recording = Recording(path)
        verify(recording)
    except GsbError:
        return False
    return recording.status == "complete"


def build(folder: Path) -> Path | None:
    """Compile the shim; None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    shim = folder / "faults.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(shim), str(SHIM), "-ldl"], check=True)
    return shim


def main(argv: list[str] | None = None) -> int:
    """Entry point; the exit code is 1 where a promise was broken."""
    p = argparse.ArgumentParser(prog="python -m tests.hostile.faults", description=(__doc__ or "").splitlines()[0])
    p.add_argument("--scenario", action="append", choices=list(SCENARIOS), help="default: all of them")
    p.add_argument("--most", type=int, default=1 << 30, help="calls of a kind that fail (default: every one)")
    arguments = p.parse_args(argv)
    if "faults.so" not in os.environ.get("LD_PRELOAD", ""):
        with tempfile.TemporaryDirectory() as folder:
            shim = build(Path(folder))
            if shim is None:
                sys.exit("no C compiler is on PATH")
            command = [sys.executable, "-m", "tests.hostile.faults", *(sys.argv[1:] if argv is None else argv)]
            one = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
            return subprocess.run(command, env={**os.environ, **one, "LD_PRELOAD": str(shim)}).returncode
    found: dict[str, Any] = {"tried": {}, "broken": []}
    with tempfile.TemporaryDirectory() as folder:
        faults = Faults(Path(os.environ["LD_PRELOAD"]), Path(folder))
        for name in arguments.scenario or SCENARIOS:
            for one in faults.try_all(name, arguments.most):
                if "tried" in one:
                    found["tried"][name] = one["tried"]
                else:
                    found["broken"].append(one)
    json.dump(found, sys.stdout, indent=1)
    print()
    return 1 if found["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())
