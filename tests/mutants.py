"""What the tests are worth: how many random mutants of the code they notice (run by make mutants).

A mutant is the code with one operator, number, keyword or decorator replaced, by cosmic-ray's operators. cosmic-ray's
own runner changes files of the checkout in place, knows one command for all modules and draws no sample; so only its
operators are used. Each mutant is written into a copy of the checkout in a temporary folder. There run the quick tests
of the files that import the module by the fewest steps, tests that take long last, until one fails
(tests.mutant_runner). A test that fails runs again without the mutant, and what is limited is the time of a processor:
a busy machine neither kills a mutant nor saves it. What was killed is kept in `.cache/`, and stays killed while neither
the mutant nor the file of the test that killed it has changed.

Annotations are not mutated, because nothing evaluates them, and neither are decorators of data classes: mypy holds that
nothing assigns to a frozen instance.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import io
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import tokenize
import tomllib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

from tests import mutant_runner

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("schemas", "recorder", "evaluator", "src/gpusimbench")

FOLDERS = (
    *("evaluator/metrics", "evaluator/transport", "evaluator/statistics", "evaluator/compare", "evaluator/audit"),
    *("evaluator/runs", "evaluator/results", "evaluator/report", "evaluator/check", "evaluator/diff"),
    *("evaluator/probe", "schemas"),
)
LINKED = ("recordings", "docs", ".git")
"""Read by tests and never written, so that no copy is made."""

MOST_FILES = 6
"""Files of tests that a mutant meets, unless more are asked for."""

_COMPILED = "transport.compiled import"  # what has code in it that is compiled to machine code
_KEPT = ROOT / ".cache" / "mutants.json"

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


def main() -> int:
    """Run a sample of mutants, print what became of each, the survivors, and how many were killed."""
    parser = argparse.ArgumentParser(description="Run the tests against random mutants of the code.")
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="folders or files to mutate")
    parser.add_argument("--sample", type=int, default=100, help="how many mutants (default: 100)")
    parser.add_argument("--seed", type=int, default=1, help="of the sample (default: 1)")
    parser.add_argument("--jobs", type=int, default=2, help="how many run at once (default: 2)")
    parser.add_argument("--files", type=int, default=MOST_FILES, help="of tests, that a mutant meets (default: 6)")
    parser.add_argument("--seconds", type=float, default=30.0, help="of a processor, for a mutant (default: 30)")
    given = parser.parse_args()
    mutants = sample(given.folders, given.sample, given.seed)
    kept = _kept()
    killed = {n for n, mutant in enumerate(mutants) if _stays_killed(mutant, kept)}
    print(f"{len(killed)} of {len(mutants)} mutants were killed earlier", flush=True)
    alive: set[int] = set()
    left = [n for n in range(len(mutants)) if n not in killed]
    for result in _run(mutants, left, given.jobs, given.files, given.seconds):
        number, by = result["number"], result["killed_by"]
        mutant = mutants[number]
        place = f"{number + 1:4d}/{len(mutants)}  {mutant.path}:{mutant.line}"
        if by:
            killed.add(number)
            alive.discard(number)
            kept[_key(mutant)] = [by, _digest(by)]
            _KEPT.parent.mkdir(exist_ok=True)
            _KEPT.write_text(json.dumps(kept), encoding="utf-8")
            print(f"killed    {place}  {by}: {result['how']}", flush=True)
        else:
            print(f"{'survived' if number in alive else 'alive   '}  {place}", flush=True)
            alive.add(number)
        for test in result["unsound"]:
            print(f"          left out, because it fails without a mutant: {test}")
    for number in sorted(alive):
        mutant = mutants[number]
        nearest = " ".join(near(mutant.path)[:MOST_FILES])
        print(f"\n{mutant.path}:{mutant.line}\n- {mutant.before}\n+ {mutant.after}\n  {nearest}")
    print(f"\n{len(killed)} of {len(mutants)} mutants killed, seed {given.seed}")
    return 0


def _key(mutant: Mutant) -> str:
    return hashlib.sha256(f"{mutant.path}\n{mutant.code}".encode()).hexdigest()


def _digest(test: str) -> str:
    path = ROOT / test.partition("::")[0]
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _kept() -> dict[str, list[str]]:
    # of mutants that were killed: the test, and the digest of its file
    return json.loads(_KEPT.read_text(encoding="utf-8")) if _KEPT.exists() else {}  # type: ignore[no-any-return]


def _stays_killed(mutant: Mutant, kept: dict[str, list[str]]) -> bool:
    test, digest = kept.get(_key(mutant), ("", ""))
    return bool(digest) and digest == _digest(test)


def _run(
    mutants: Sequence[Mutant], numbers: Sequence[int], jobs: int, files: int, seconds: float
) -> Iterator[dict[str, Any]]:
    # what became of the mutants of these numbers, as soon as it is known
    results: SimpleQueue[dict[str, Any] | None] = SimpleQueue()

    def follow(folder: Path, part: Sequence[int]) -> None:
        try:
            for line in _runner(folder, {number: mutants[number] for number in part}, files, seconds):
                results.put(json.loads(line))
        finally:
            results.put(None)

    parts = [part for part in (numbers[job::jobs] for job in range(jobs)) if part]
    with tempfile.TemporaryDirectory(prefix="gsb-mutants-") as name, ThreadPoolExecutor(jobs) as pool:
        followed = [pool.submit(follow, Path(name) / str(job), part) for job, part in enumerate(parts)]
        for _ in parts:
            while (result := results.get()) is not None:
                yield result
        for one in followed:
            one.result()


def _runner(folder: Path, mutants: Mapping[int, Mutant], files: int, seconds: float) -> Iterator[str]:
    # results, as JSON, of one process that runs mutants in a copy of the checkout
    tree = _copy(folder / "tree")
    (folder / "numba").mkdir()
    meets = {number: near(m.path)[:files] for number, m in mutants.items()}
    told = [
        {"number": number, "path": m.path, "code": m.code, "tests": meets[number], "compiled": _COMPILED in m.code}
        for number, m in mutants.items()
    ]
    task = {"folder": str(folder), "mutants": told, "seconds": seconds}
    (folder / "task").write_text(json.dumps(task), encoding="utf-8")
    reading, writing = os.pipe()
    env = {name: value for name, value in os.environ.items() if name != "GSB_TESTS_SHARE"}
    env |= {
        mutant_runner.TASK: str(folder / "task"),
        mutant_runner.SAY: str(writing),
        "PYTHONPATH": f"{tree / 'src'}{os.pathsep}{tree}",
        "NUMBA_CACHE_DIR": str(folder / "numba"),
        "TMPDIR": str(folder),
    }
    tests = sorted({test for some in meets.values() for test in some})
    with (folder / "said").open("w") as said:
        child = subprocess.Popen(
            [*mutant_runner.command(), *tests],
            cwd=tree, env=env, stdin=subprocess.DEVNULL, stdout=said, stderr=said, pass_fds=[writing],
        )  # fmt: skip
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as results:
        yield from results
    if child.wait() not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        last = (folder / "said").read_text(encoding="utf-8")[-3000:]
        raise SystemExit(f"the runner of mutants ended with exit code {child.returncode}:\n{last}")


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
    return [*found, *_asterisks(source)]


def _asterisks(source: str) -> Iterator[tuple[Place, Place]]:
    # those of signatures and arguments, which cosmic-ray takes for products: one that follows no operand
    before = None
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        unary = before is None or before.type == tokenize.OP and before.string not in (")", "]", "}")
        if token.type == tokenize.OP and token.string in ("*", "**") and unary:
            yield token.start, token.end
        if token.type not in (tokenize.NL, tokenize.COMMENT, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT):
            before = token


def _mutant(path: str, place: Place, name: str, occurrence: int) -> Mutant | None:
    # None where the change makes no Python: an asterisk of a signature is no product
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    source = (ROOT / path).read_text(encoding="utf-8")
    code = mutate_code(source, get_operator(name)(), occurrence)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # pytest would end at what Python warns of: an identity with a literal
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


@cache
def near(path: str) -> list[str]:
    """Files of tests that import a file of the code, nearest first.

    Near are those that import the module by few steps; among them first those named like the module or its folder, and
    of as many steps those of the folder that mirrors the package. A test that calls a command imports the command's
    module.
    """
    module = _module_of(path)
    names = {Path(path).stem, Path(path).parent.name}
    distances = {test: _distance(test, module) for test in _tests()}

    def turn(test: str) -> tuple[bool, int, bool, int]:
        named = any(name in Path(test).stem for name in names)
        elsewhere = Path(test).parts[1] != Path(path).parts[0]
        return (not named or distances[test] > 3, distances[test], elsewhere, (ROOT / test).stat().st_size)

    return sorted((test for test in distances if distances[test] < sys.maxsize), key=turn)


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
        elif isinstance(node, ast.Constant) and str(node.value).startswith("gpusimbench."):
            found.add(node.value)  # a module that is run as a process
    return found


def _module_of(path: str) -> str:
    parts = Path(path).with_suffix("").parts
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts[1:] if parts[0] == "src" else parts if parts[0] == "tests" else ("gpusimbench", *parts))


if __name__ == "__main__":
    sys.exit(main())
