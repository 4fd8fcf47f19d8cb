"""What the tests are worth: how many random mutants of the code they notice (run by make mutants).

A mutant is the code with one operator, number, keyword or decorator replaced, by cosmic-ray's operators. cosmic-ray's
own runner changes files of the checkout in place, knows one command for all modules and draws no sample; so only its
operators are used. Each mutant is written into a copy of the checkout in a temporary folder. There run the quick tests
that execute its line (tests.reached), the shortest first, until one fails. Where all pass, so do those of the files
that import the module by the fewest steps: what a test asks for may have been made once, for an earlier test.

Annotations are not mutated, because nothing evaluates them, and neither are decorators of data classes: mypy holds that
nothing assigns to a frozen instance.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from queue import SimpleQueue

from tests.reached import PACKAGES, QUICK, ROOT, Reached, reached

FOLDERS = (
    *("evaluator/metrics", "evaluator/transport", "evaluator/statistics", "evaluator/compare", "evaluator/audit"),
    "schemas",
)
LINKED = ("recordings", "docs", ".git")
"""Read by tests and never written, so that no copy is made."""

MOST_SECONDS = 60
"""That the tests take which execute a mutant's line, at most, so far as they are run."""

MOST_FILES = 6
"""Files of tests that a mutant meets after these."""

LIMIT_S = 60
SLOWER = 4
"""A mutant is killed whose tests take a minute, and so many times what they took when they were measured: it loops.
Where they take as long without it, as on a busy machine, nothing is known of it."""

ENDED = tuple(f"exit code {-number}" for number in (signal.SIGKILL, signal.SIGTERM))
"""Tests that were ended run again: once may be something else on the machine, twice is the mutant, by its memory."""

Place = tuple[int, int]


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    path       of the file, relative to the checkout
    line       of the change, from 1
    before     that line
    after      the same line, mutated
    code       the whole file, mutated
    """

    path: str
    line: int
    before: str
    after: str
    code: str


@dataclass(frozen=True)
class Result:
    """What became of a mutant.

    killed_by  the first test that failed, or that the time ran out; None where all passed
    unknown    why nothing is known of it: its tests did not end, neither with it nor without; None where they did
    tests      that it was to pass, and files of tests
    """

    mutant: Mutant
    killed_by: str | None
    unknown: str | None
    tests: Sequence[str]


def main() -> int:
    """Run a sample of mutants, print what became of each, the survivors, and how many were killed."""
    parser = argparse.ArgumentParser(description="Run the tests against random mutants of the code.")
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="folders or files to mutate")
    parser.add_argument("--sample", type=int, default=100, help="how many mutants (default: 100)")
    parser.add_argument("--seed", type=int, default=1, help="of the sample (default: 1)")
    parser.add_argument("--jobs", type=int, default=2, help="how many run at once (default: 2)")
    given = parser.parse_args()
    mutants = sample(given.folders, given.sample, given.seed)
    measured = reached()
    with tempfile.TemporaryDirectory(prefix="gsb-mutants-") as folder, ThreadPoolExecutor(given.jobs) as pool:
        trees: SimpleQueue[Path] = SimpleQueue()
        for number in range(given.jobs):
            trees.put(_copy(Path(folder) / str(number)))
        results = []
        for result in pool.map(lambda mutant: _run(mutant, measured, trees), mutants):
            results.append(result)
            print(f"{len(results):4d}/{len(mutants)}  {_told(result)}", flush=True)
    survivors = [result for result in results if result.killed_by is None and result.unknown is None]
    unknown = sum(result.unknown is not None for result in results)
    known = len(results) - unknown
    killed = known - len(survivors)
    print(f"\n{killed} of {known} mutants killed, seed {given.seed}; survivors: {len(survivors)}, unknown: {unknown}")
    for result in survivors:
        m = result.mutant
        print(f"\n{m.path}:{m.line}\n- {m.before}\n+ {m.after}\n  tests: {' '.join(result.tests[-9:])}")
    return 0


def _told(result: Result) -> str:
    where = f"{result.mutant.path}:{result.mutant.line}"
    if result.unknown is not None:
        return f"unknown   {where}  {result.unknown}"
    return f"survived  {where}" if result.killed_by is None else f"killed    {where}  by {result.killed_by}"


def sample(folders: Sequence[str], size: int, seed: int) -> list[Mutant]:
    """Mutants of Python files at random places.

    A place is drawn once, however many ways there are to mutate it.

    Args:
        folders: folders or files, relative to the checkout.
        size: how many; fewer where there are no more places.
        seed: of the drawing; the same files and the same seed give the same mutants.
    """
    places: dict[tuple[str, Place], list[tuple[str, int]]] = {}
    for folder in folders:
        top = ROOT / folder
        for path in sorted(top.rglob("*.py")) if top.is_dir() else [top]:
            for place, operator, occurrence in _mutations(path.read_text(encoding="utf-8")):
                places.setdefault((str(path.relative_to(ROOT)), place), []).append((operator, occurrence))
    draw = random.Random(seed)
    order = sorted(places)
    draw.shuffle(order)
    found: list[Mutant] = []
    for path, place in order:
        if len(found) == size:
            break
        mutant = _mutant(path, place, *draw.choice(places[path, place]))
        if mutant is not None:
            found.append(mutant)
    return found


def _mutations(source: str) -> Iterator[tuple[Place, str, int]]:
    # every change that cosmic-ray knows: where, by which operator, and the how manieth of this operator in the file
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    nodes = list(ast_nodes(get_ast(source)))
    spared = _spared(source)
    for name in sorted(operator_names()):
        operator = get_operator(name)
        if name == "core/NoOp" or operator.arguments():
            continue
        positions = [position for node in nodes for position in operator().mutation_positions(node)]
        for occurrence, (begin, _) in enumerate(positions):
            if not any(first <= begin < last for first, last in spared):
                yield begin, name, occurrence


def _spared(source: str) -> list[tuple[Place, Place]]:
    found: list[tuple[Place, Place]] = []
    for node in ast.walk(ast.parse(source)):
        classes = [d for d in getattr(node, "decorator_list", ()) if ast.unparse(d).startswith("dataclass")]
        for at in (getattr(node, "annotation", None), getattr(node, "returns", None), *classes):
            if isinstance(at, ast.expr) and at.end_lineno is not None and at.end_col_offset is not None:
                begin = at.col_offset - (at in classes)  # with the @
                found.append(((at.lineno, begin), (at.end_lineno, at.end_col_offset)))
    return found


def _mutant(path: str, place: Place, name: str, occurrence: int) -> Mutant | None:
    # None where the change makes no Python: an asterisk of a signature is no product
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (ROOT / path).read_text(encoding="utf-8")
    code = mutate_code(source, get_operator(name)(), occurrence)
    try:
        compile(code or "", path, "exec")
    except SyntaxError:
        return None
    if not code or ast.dump(ast.parse(code)) == ast.dump(ast.parse(source)):
        return None  # a large float plus one is that float
    before, after = source.splitlines(), code.splitlines()
    at = next(i for i, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
    return Mutant(path, at + 1, before[at].strip(), after[at].strip(), code)


def _copy(tree: Path) -> Path:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in listed.stdout.splitlines():
        if name.split("/")[0] in LINKED or not (ROOT / name).exists():
            continue
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tree / name, follow_symlinks=False)
    for name in LINKED:
        (tree / name).symlink_to(ROOT / name)
    return tree


def _run(mutant: Mutant, measured: Reached, trees: SimpleQueue[Path]) -> Result:
    tests = tests_of(mutant.path, mutant.line, measured)
    original = (ROOT / mutant.path).read_text(encoding="utf-8")
    tree = trees.get()
    killed_by = unknown = None
    try:
        for given in (tests, near(mutant.path)):
            left_out: list[str] = []
            limit = LIMIT_S + SLOWER * sum(map(measured.time_of, given))
            while given and not killed_by:
                _write(tree / mutant.path, mutant.code)
                compiled = "transport.compiled import" in mutant.code
                run = [*given, *(f"--deselect={test}" for test in left_out)]
                killed_by = _first_failure(tree, run, limit, compiled=compiled)
                if killed_by in ENDED:
                    killed_by = _first_failure(tree, run, limit, compiled=compiled)
                _write(tree / mutant.path, original)
                if killed_by is None:
                    break
                failed = killed_by.startswith("tests/")
                without = _first_failure(tree, [killed_by] if failed else run, limit, compiled=False)
                if without is None:
                    break
                if not failed:
                    killed_by, unknown = None, f"{killed_by}; without a mutant: {without}"
                    break
                print(f"left out, because it fails without a mutant: {killed_by}", flush=True)
                left_out.append(killed_by)
                killed_by = None
    finally:
        _write(tree / mutant.path, original)
        trees.put(tree)
    return Result(mutant, killed_by, None if killed_by else unknown, (*tests, *near(mutant.path)))


def _write(path: Path, code: str) -> None:
    path.write_text(code, encoding="utf-8")
    # Python takes bytecode for current that is of the same second and of a file as long
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def _first_failure(tree: Path, tests: Sequence[str], limit: float, *, compiled: bool) -> str | None:
    # compiled: machine code of callers has that of the mutated function in it, so nothing kept may be used
    with tempfile.TemporaryDirectory(dir=tree.parent) as folder:
        env = {
            **{name: value for name, value in os.environ.items() if name != "GSB_TESTS_SHARE"},
            "PYTHONPATH": f"{tree / 'src'}{os.pathsep}{tree}",
            "TMPDIR": folder,
            "NUMBA_CACHE_DIR": folder if compiled else str(tree.parent / "numba"),
        }
        child = subprocess.Popen(
            [sys.executable, "-P", "-m", "pytest", "-x", "-q", "-m", QUICK, "--tb=no",
             "--hypothesis-profile=mutants", "-p", "no:cacheprovider", "-p", "no:xdist", *tests],
            cwd=tree, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        )  # fmt: skip
        try:
            said, _ = child.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
            return f"the limit of {limit:.0f} s"
    if child.returncode == 0:
        return None
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", said, re.MULTILINE)
    return failed[1] if failed else f"exit code {child.returncode}"


def tests_of(path: str, line: int, measured: Reached) -> list[str]:
    """The tests that execute a line of the code, those of the nearest files first, and of these the shortest."""
    order = {test: turn for turn, test in enumerate(near(path))}
    found: list[str] = []
    left = float(MOST_SECONDS)
    executing = measured.tests(path, line)

    def turn(test: str) -> tuple[bool, int, float]:
        return (executing[test] > 2, order.get(test.partition("::")[0], len(order)), executing[test])

    for test in sorted(executing, key=turn):
        seconds = executing[test]
        if seconds < left:
            found.append(test)
            left -= seconds
    return found


@cache
def near(path: str) -> list[str]:
    """Files of tests that concern a file of the code, nearest first.

    Near are those that import the module by few steps; among them first those named like the module or its folder. A
    test that calls a command imports the command's module.
    """
    module = _module_of(path)
    names = {Path(path).stem, Path(path).parent.name}
    distances = {test: _distance(test, module) for test in _tests()}

    def turn(test: str) -> tuple[bool, int, int]:
        named = any(name in Path(test).stem for name in names)
        return (not named or distances[test] > 3, distances[test], (ROOT / test).stat().st_size)

    return sorted((test for test in distances if distances[test] <= 4), key=turn)[:MOST_FILES]


@cache
def _tests() -> list[str]:
    return [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests").rglob("test_*.py"))]


def _distance(test: str, module: str) -> int:
    seen, edge, steps = {module}, {module}, 0
    importers = _importers()
    while edge and test not in edge:
        edge = {importer for one in edge for importer in importers.get(one, ()) if importer not in seen}
        seen |= edge
        steps += 1
    return steps if edge else sys.maxsize


@cache
def _importers() -> dict[str, set[str]]:
    # of each module, who imports it: modules by name, files of tests by path
    commands = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    found: dict[str, set[str]] = {}
    files = [path for folder in (*PACKAGES, "tests") for path in (ROOT / folder).rglob("*.py")]
    for path in files:
        name = str(path.relative_to(ROOT))
        source = path.read_text(encoding="utf-8")
        imports = _imports(source)
        if name.startswith("tests/"):
            imports |= {module.partition(":")[0] for command, module in commands.items() if f'"{command}"' in source}
        importer = name if path.stem.startswith("test_") else _module_of(name)
        for module in imports - {importer}:
            found.setdefault(module, set()).add(importer)
    return found


def _imports(source: str) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def _module_of(path: str) -> str:
    parts = Path(path).with_suffix("").parts
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts if parts[0] == "tests" else ("gpusimbench", *parts))


if __name__ == "__main__":
    sys.exit(main())
