"""Which lines of the code each quick test executes, measured once by coverage.py (for make coverage and make mutants).

Processes that a test starts count as the test. The measurement is kept in `.cache/` until a file of Python changes.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("schemas", "recorder", "evaluator")
QUICK = "not slow and not alone"

_KEPT = ROOT / ".cache" / "reached.json"
_SECONDS = "GSB_TESTS_SECONDS"  # the file that the plugin writes durations to
_TEST = "GSB_TESTS_RUNNING"  # the test that a child process runs for

_CONFIGURATION = """
[run]
data_file = {folder}/data
parallel = true
source = {source}
context = ${{{test}-}}
patch = subprocess
disable_warnings = no-data-collected,module-not-imported
"""


@dataclass(frozen=True)
class Reached:
    """What the quick tests execute.

    digest   of the files that were measured
    seconds  that each test took while it was measured, by its node id, in the order of the tests
    sets     of numbers of tests
    lines    by file and line (as JSON has it, a text), the number of a set: the tests that execute the line
    missing  by file, the lines that no test executes
    sizes    by file, how many lines can be executed
    """

    digest: str
    seconds: dict[str, float]
    sets: list[list[int]]
    lines: dict[str, dict[str, int]]
    missing: dict[str, list[int]]
    sizes: dict[str, int]

    def tests(self, path: str, line: int) -> dict[str, float]:
        """The tests that execute the statement at a line, with the seconds that each takes.

        Of a statement with a block, such as a function, only its head counts.
        """
        names, found = list(self.seconds.items()), self.lines.get(path, {})
        first, last = _statement((ROOT / path).read_text(encoding="utf-8"), line)
        sets = {found[str(at)] for at in range(first, last + 1) if str(at) in found}
        return dict(names[number] for one in sets for number in self.sets[one])

    def time_of(self, tests: str) -> float:
        """Seconds that a test, or all tests of a file, took."""
        return sum(seconds for name, seconds in self.seconds.items() if name == tests or name.startswith(f"{tests}::"))


def _statement(source: str, line: int) -> tuple[int, int]:
    # the lines of the innermost statement at a line, without its block
    spans = [(line, line)]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.stmt, ast.excepthandler, ast.match_case)):
            body = getattr(node, "body", ())
            begin = getattr(node, "lineno", None) or node.pattern.lineno  # type: ignore[attr-defined]
            end = body[0].lineno - 1 if body else node.end_lineno  # type: ignore[union-attr]
            if begin <= line <= end:
                spans.append((begin, end))
    return max(spans)


def reached() -> Reached:
    """The measurement of this checkout: the one that was kept, or a new one, which takes minutes."""
    digest = _digest()
    if _KEPT.exists():
        kept = Reached(**json.loads(_KEPT.read_text(encoding="utf-8")))
        if kept.digest == digest:
            return kept
    found = _measured(digest)
    _KEPT.parent.mkdir(exist_ok=True)
    _KEPT.write_text(json.dumps(asdict(found)), encoding="utf-8")
    return found


def _digest() -> str:
    found = hashlib.sha256()
    for path in sorted(path for folder in (*PACKAGES, "tests") for path in (ROOT / folder).rglob("*.py")):
        found.update(str(path.relative_to(ROOT)).encode() + hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def _measured(digest: str) -> Reached:
    with tempfile.TemporaryDirectory(prefix="gsb-reached-") as name:
        folder = Path(name)
        configuration = folder / "configuration"
        source = "".join(f"\n    {ROOT / package}" for package in PACKAGES)
        configuration.write_text(_CONFIGURATION.format(folder=folder, source=source, test=_TEST), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-m", "coverage", "run", f"--rcfile={configuration}",
             "-m", "pytest", "-q", "-m", QUICK, "-p", "tests.reached", "-p", "no:xdist", "--tb=short"],
            cwd=ROOT, env={**os.environ, _SECONDS: str(folder / "seconds")}, check=False,
        )  # fmt: skip
        if done.returncode not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
            raise SystemExit(
                f"the quick tests did not run to their end (exit code {done.returncode}): nothing is known"
            )
        return _read(digest, configuration, json.loads((folder / "seconds").read_text(encoding="utf-8")))


def _read(digest: str, configuration: Path, seconds: dict[str, float]) -> Reached:
    import coverage

    measured = coverage.Coverage(config_file=str(configuration))
    measured.combine()
    data = measured.get_data()
    numbers = {test: number for number, test in enumerate(seconds)}
    sets: dict[tuple[int, ...], int] = {}
    lines: dict[str, dict[str, int]] = {}
    missing, sizes = {}, {}
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        name = str(path.relative_to(ROOT))
        _, statements, _, unreached, _ = measured.analysis2(str(path))
        missing[name], sizes[name] = unreached, len(statements)
        by_line = data.contexts_by_lineno(str(path))
        for line, contexts in by_line.items():
            tests = tuple(sorted(numbers[context] for context in contexts if context in numbers))
            if tests:
                lines.setdefault(name, {})[str(line)] = sets.setdefault(tests, len(sets))
    return Reached(digest, seconds, [list(tests) for tests in sets], lines, missing, sizes)


# -- the plugin of pytest

_seconds: dict[str, float] = {}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Tell coverage.py which test runs, with the fixtures that are made for it."""
    import coverage

    measuring = coverage.Coverage.current()
    assert measuring is not None
    os.environ[_TEST] = item.nodeid
    measuring.switch_context(item.nodeid)
    begin = time.perf_counter()
    result = yield
    _seconds[item.nodeid] = round(time.perf_counter() - begin, 3)
    measuring.switch_context("")
    return result


def pytest_sessionfinish() -> None:
    """Write how long each test took."""
    Path(os.environ[_SECONDS]).write_text(json.dumps(_seconds), encoding="utf-8")


def main(least: float = 0.8) -> int:
    """Print how much of the code the quick tests execute, and which files less than 80 %."""
    found = reached()

    def told(title: str, files: Sequence[str]) -> str:
        size = sum(found.sizes[file] for file in files)
        return f"{_share(size - sum(len(found.missing[file]) for file in files), size)}  {size:6d} lines  {title}"

    for package in PACKAGES:
        print(told(package, [file for file in found.sizes if file.split("/")[0] == package]))
    print(told("together", list(found.sizes)))
    for file, size in found.sizes.items():
        if len(found.missing[file]) > (1 - least) * size:
            print(f"{told(file, [file])}, without {' '.join(_ranges(found.missing[file]))}")
    return 0


def _share(part: int, whole: int) -> str:
    return f"{part / whole if whole else 1:6.1%}"


def _ranges(lines: Sequence[int]) -> Iterator[str]:
    begin = end = 0
    for line in [*lines, sys.maxsize]:
        if line > end + 1:
            if begin:
                yield f"{begin}-{end}" if end > begin else str(begin)
            begin = line
        end = line


if __name__ == "__main__":
    sys.exit(main())
