"""Runs tests against mutants: a plugin of pytest, loaded by tests.mutants in a copy of the checkout.

Most of what a quick test costs is starting a process, importing, and collecting. So the tests are collected once, and
each mutant is a fork of this process in which the code objects of the changed functions are replaced. The file on disk
is changed too, for processes that tests start and for modules that are imported late. A mutant of what runs at import,
such as a constant or a default, and of code that is compiled to machine code, meets the tests in a new process.
"""

from __future__ import annotations

import functools
import gc
import importlib.util
import inspect
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

TASK = "GSB_MUTANTS_TASK"
"""Environment variable: the file of mutants to run, or nothing where this is the new process of a mutant."""

ORDER = "GSB_MUTANTS_ORDER"
"""Environment variable: the file that names the tests of a new process in their order, and those to leave out."""

SAY = "GSB_MUTANTS_SAY"
"""Environment variable: the descriptor that lines about tests are written to."""

LIMIT_BYTES = 8 << 30
"""Of memory, a process: a mutant that takes more fails its test and does not end what else runs on the machine."""

FIRST_S = 6.0
"""Seconds of a processor after which no other test begins for a mutant; those still alive get the rest afterwards."""

TEST_S = 30
"""Seconds of a processor that a test may take; no quick test takes as many. With a mutant that takes more, it loops."""

SILENT_S = 600
"""Seconds by the clock that a test may take: a mutant that waits for what never comes uses no processor."""

_SHORT_S = 0.3
_LONG_S = 1.0
_UNKNOWN_S = 0.2  # what a test takes that has not run yet

_Key = tuple[str, str, int]  # of a code object: its file, its qualified name, its first line


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool:
    """Run the mutants of the task, or the tests against the mutant that was imported."""
    task = os.environ.get(TASK)
    if task:
        _Runner(session, json.loads(Path(task).read_text(encoding="utf-8"))).run()
        return True
    say = int(os.environ[SAY])
    if session.testsfailed:
        _say(say, "failed", "the import of a file of tests")
        _say(say, "done", "")
        return True
    told = json.loads(Path(os.environ[ORDER]).read_text(encoding="utf-8"))
    order = {test: turn for turn, test in enumerate(told["order"])}
    items = [item for item in session.items if item.nodeid not in told["left_out"]]
    _test(sorted(items, key=lambda item: order.get(item.nodeid, len(order))), told["most_s"], say)
    return True


def _say(to: int, what: str, of: str) -> None:
    os.write(to, f"{what} {of}\n".encode())


def _test(items: Sequence[pytest.Item], most_s: float, say: int) -> None:
    # the tests in turn until one fails, or that many seconds of a processor are over
    begin = _processor()
    for item, following in zip(items, [*items[1:], None], strict=True):
        if _processor() - begin > most_s:
            break
        _say(say, "test", item.nodeid)
        before = _processor()
        signal.setitimer(signal.ITIMER_PROF, TEST_S)  # ends this process
        try:
            failed = any(report.failed for report in runtestprotocol(item, log=False, nextitem=following))
        except BaseException:  # a test that asks pytest to end
            failed = True
        signal.setitimer(signal.ITIMER_PROF, 0)
        if failed:
            _say(say, "failed", item.nodeid)
            break
        _say(say, "passed", f"{_processor() - before:.2f}")
    _say(say, "done", "")


def _processor() -> float:
    return sum(os.times()[:4])


class _Runner:
    def __init__(self, session: pytest.Session, task: Mapping[str, Any]) -> None:
        self._session = session
        self._task = task
        self._share = Path(task["folder"]) / "share"
        self._took: dict[str, float] = {}
        self._sound: dict[str, bool] = {}
        resource.setrlimit(resource.RLIMIT_DATA, (LIMIT_BYTES, LIMIT_BYTES))
        gc.collect()
        found = gc.get_objects()
        self._functions: dict[_Key, list[FunctionType]] = {}
        for function in found:
            if isinstance(function, FunctionType):
                self._functions.setdefault(_key(function.__code__), []).append(function)
        self._caches = [cache for cache in found if isinstance(cache, functools._lru_cache_wrapper)]
        gc.freeze()
        signal.signal(signal.SIGPROF, signal.SIG_DFL)

    def run(self) -> None:
        alive = self._task["mutants"]
        passed: dict[int, set[str]] = {mutant["number"]: set() for mutant in alive}
        for most_s in (FIRST_S, self._task["seconds"] - FIRST_S):
            mutants, alive = alive, []
            for mutant in mutants:
                result = self._judged(mutant, most_s, passed[mutant["number"]])
                os.write(int(os.environ[SAY]), f"{json.dumps(result)}\n".encode())
                if result["killed_by"] is None:
                    alive.append(mutant)

    def _judged(self, mutant: Mapping[str, Any], most_s: float, passed: set[str]) -> dict[str, Any]:
        # passed: tests that need not run again, and will not
        path = Path(mutant["path"])
        original = path.read_text(encoding="utf-8")
        patches = self._patches(mutant, original)
        items = self._ordered(mutant["tests"])
        unsound: set[str] = set()
        while True:
            left = [item for item in items if item.nodeid not in passed and self._sound.get(item.nodeid, True)]
            write(path, mutant["code"])
            try:
                if patches is None:
                    killed = self._in_process(left, passed, most_s, compiled=mutant["compiled"])
                else:
                    killed = self._in_fork(left, patches, passed, most_s, shared=path.parts[0] == "evaluator")
            finally:
                write(path, original)
            if killed is None or self._is_sound(killed[0]):
                test, how = killed or (None, "")
                return {"number": mutant["number"], "killed_by": test, "how": how, "unsound": sorted(unsound)}
            unsound.add(killed[0])

    def _ordered(self, files: Sequence[str]) -> list[pytest.Item]:
        order = {file: turn for turn, file in enumerate(files)}

        def turn(item: pytest.Item) -> tuple[bool, bool, int, float]:
            took = self._took.get(item.nodeid, _UNKNOWN_S)
            return (took > _LONG_S, took > _SHORT_S, order[_file(item)], took)

        return sorted((item for item in self._session.items if _file(item) in order), key=turn)

    def _is_sound(self, test: str) -> bool:
        # whether a test passes without a mutant, here and now
        if test not in self._sound:
            items = [item for item in self._session.items if item.nodeid == test]
            self._sound[test] = not items or self._in_fork(items, None, set(), 1.0, shared=True) is None
        return self._sound[test]

    def _patches(self, mutant: Mapping[str, Any], original: str) -> dict[_Key, CodeType] | None:
        """New code for functions; None where what is changed runs at import, or is compiled to machine code."""
        module = sys.modules.get("gpusimbench." + ".".join(Path(mutant["path"]).with_suffix("").parts))
        if mutant["compiled"]:
            return None
        if module is None or module.__file__ is None:
            return {}
        old, new = (compile(text, module.__file__, "exec", dont_inherit=True) for text in (original, mutant["code"]))
        found: dict[_Key, CodeType] = {}
        outermost: list[_Key] = []
        if not _differences(old, new, found, outermost) or not all(key in self._functions for key in outermost):
            return None
        return found

    def _in_fork(
        self,
        items: Sequence[pytest.Item],
        patches: Mapping[_Key, CodeType] | None,
        passed: set[str],
        most_s: float,
        *,
        shared: bool,
    ) -> tuple[str, str] | None:
        # patches: of a mutant, or None without one; shared: what tests without a mutant recorded is given
        folder = Path(tempfile.mkdtemp(dir=self._task["folder"]))
        share = self._share
        share.mkdir(exist_ok=True)
        if patches is not None:
            share = folder / "share"
            if shared:
                shutil.copytree(self._share, share, copy_function=os.link, ignore=shutil.ignore_patterns("results"))
            else:
                share.mkdir()
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.close(reading)
                os.setsid()
                _settle(folder, share)
                for cache in self._caches:
                    cache.cache_clear()
                for key, code in (patches or {}).items():
                    for function in self._functions.get(key, ()):
                        function.__code__ = code
                _test(items, most_s, writing)
                self._session._setupstate.teardown_exact(None)
            finally:
                os._exit(0)
        os.close(writing)
        return self._followed(reading, child, folder, passed)

    def _in_process(
        self, items: Sequence[pytest.Item], passed: set[str], most_s: float, *, compiled: bool
    ) -> tuple[str, str] | None:
        # compiled: machine code of callers has that of the mutated function in it, so nothing kept may be used
        folder = Path(tempfile.mkdtemp(dir=self._task["folder"]))
        reading, writing = os.pipe()
        env = {name: value for name, value in os.environ.items() if name not in (TASK, "GSB_TESTS_SHARE")}
        env |= {SAY: str(writing), ORDER: str(folder / "order"), "TMPDIR": str(folder)}
        if compiled:
            env["NUMBA_CACHE_DIR"] = str(folder)
        order = [item.nodeid for item in items]
        left_out = sorted({item.nodeid for item in self._session.items}.difference(order))
        told = {"order": order, "left_out": left_out, "most_s": most_s}
        (folder / "order").write_text(json.dumps(told), encoding="utf-8")
        child = subprocess.Popen(
            [*command(), *dict.fromkeys(map(_file, items))],
            env=env, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True, pass_fds=[writing],
        )  # fmt: skip
        os.close(writing)
        found = self._followed(reading, child.pid, folder, passed)
        child.returncode = 0  # it was waited for
        return found

    def _followed(self, reading: int, child: int, folder: Path, passed: set[str]) -> tuple[str, str] | None:
        # the test that failed and how, of a process that says what it does
        test, ended = "no test", "its process ended"
        done, killed = False, None
        for what, of in _lines(reading, SILENT_S):
            if what == "test":
                test = of
            elif what == "passed":
                self._took[test] = float(of)
                passed.add(test)
            elif what == "failed":
                killed = (of, "failed")
            elif what == "silent":
                ended = f"no end within {SILENT_S} s"
                break
            done = done or what == "done"
        for end in (signal.SIGTERM, signal.SIGKILL) if done else (signal.SIGKILL,):
            try:
                os.killpg(child, end)
            except ProcessLookupError:
                break
            if end == signal.SIGTERM:
                select.select([], [], [], 0.05)
        _, status = os.waitpid(child, 0)
        os.close(reading)
        shutil.rmtree(folder, ignore_errors=True)
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF:
            ended = f"more than {TEST_S} s of a processor"
        return killed if killed or done else (test, ended)


def command() -> list[str]:
    """pytest with this plugin, without what tests of mutants need not."""
    return [
        *(sys.executable, "-P", "-m", "pytest", "-q", "--tb=no", "--hypothesis-profile=mutants"),
        *("-m", "not slow and not alone", "-p", "tests.mutant_runner", "-p", "no:cacheprovider", "-p", "no:xdist"),
    ]


def write(path: Path, code: str) -> None:
    """Write a file of Python, and forget its bytecode, which Python takes for current within a second."""
    path.write_text(code, encoding="utf-8")
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


def _key(code: CodeType) -> _Key:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def _differences(old: CodeType, new: CodeType, found: dict[_Key, CodeType], outermost: list[_Key] | None) -> bool:
    # collects new code of functions; False where there is a difference in what runs at import, where outermost is given
    inner = [[c for c in code.co_consts if isinstance(c, CodeType)] for code in (old, new)]
    if [_key(c) for c in inner[0]] != [_key(c) for c in inner[1]]:
        return False
    if outermost is not None and _own(old) != _own(new):
        return False
    if outermost is None and old != new:
        if old.co_freevars != new.co_freevars:
            return False
        found[_key(old)] = new
    for a, b in zip(*inner, strict=True):
        function = bool(a.co_flags & inspect.CO_NEWLOCALS)  # and no class's body
        if outermost is not None and function and a != b:
            outermost.append(_key(a))
        if not _differences(a, b, found, None if function else outermost):
            return False
    return True


def _own(code: CodeType) -> tuple[Any, ...]:
    constants = [repr(c) for c in code.co_consts if not isinstance(c, CodeType)]
    return code.co_code, constants, code.co_names, code.co_varnames


def _lines(reading: int, silent: float) -> Iterator[tuple[str, str]]:
    # what a process says, until it ends, or says nothing for long
    left = b""
    while True:
        ready, _, _ = select.select([reading], [], [], silent)
        if not ready:
            yield "silent", ""
            return
        read = os.read(reading, 1 << 16)
        if not read:
            return
        *lines, left = (left + read).split(b"\n")
        for line in lines:
            what, _, of = line.decode().partition(" ")
            yield what, of
            if what == "done":
                return


def _settle(folder: Path, share: Path) -> None:
    # a fork has a temporary folder of its own, and its own of what tests share
    from tests import conftest

    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
    os.environ["GSB_TESTS_SHARE"] = str(share)
    os.environ["GSB_CACHE"] = str(share / "results")
    conftest.SHARE = share
