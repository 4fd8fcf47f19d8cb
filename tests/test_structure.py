"""The shape of the house: no circles of imports, no module too large to be held in mind."""

from __future__ import annotations

import ast
import itertools
import re
from functools import cache
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
LONGEST = 400
"""Lines; a longer module has two nouns in it."""


@cache
def imports() -> dict[str, set[str]]:
    """Each module of the package, and those that it imports itself, wherever in it."""
    graph = grimp.build_graph("gpusimbench", cache_dir=None)
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Sets of modules that import each other around a circle: strongly connected components of more than one."""
    order: list[str] = []
    seen: set[str] = set()

    def visit(start: str, edges: dict[str, set[str]], found: list[str]) -> None:
        stack = [(start, iter(sorted(edges.get(start, ()))))]
        seen.add(start)
        while stack:
            node, following = stack[-1]
            for other in following:
                if other not in seen:
                    seen.add(other)
                    stack.append((other, iter(sorted(edges.get(other, ())))))
                    break
            else:
                found.append(node)
                stack.pop()

    for module in sorted(graph):
        if module not in seen:
            visit(module, graph, order)
    backwards: dict[str, set[str]] = {}
    for module, others in graph.items():
        for other in others:
            backwards.setdefault(other, set()).add(module)
    seen.clear()
    components = []
    for module in reversed(order):
        if module not in seen:
            component: list[str] = []
            visit(module, backwards, component)
            components.append(set(component))
    return [component for component in components if len(component) > 1]


def test_a_circle_is_found() -> None:
    """Find the circle of a graph that has one, and none in one that has none."""
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [{"b", "c"}]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_circles_of_imports() -> None:
    """Import in one direction alone, also inside functions and for types."""
    found = circles(imports())
    assert [sorted(circle) for circle in found] == []
    assert len(imports()) > 300


@pytest.mark.parametrize("package", ["schemas", "recorder", "evaluator"])
def test_no_module_is_too_long(package: str) -> None:
    """Keep modules short enough to be read in one sitting."""
    long = {
        str(path.relative_to(ROOT)): lines
        for path in (ROOT / package).rglob("*.py")
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > LONGEST
    }
    assert long == {}


@pytest.mark.parametrize("package", ["schemas", "recorder", "evaluator"])
def test_the_map_has_every_folder(package: str) -> None:
    """Name each folder of a package in the map of CONTRIBUTING.md, and none that is not there."""
    house = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## The map of the house")[2]
    part = house.partition(f"\n    {package}/")[2]
    rows = itertools.takewhile(lambda row: row.startswith("      "), part.splitlines()[1:])
    begins = [found[0] for row in rows if (found := re.match(r"( {2,6}\w+/)+ ", row))]
    mapped = re.findall(r"\w+", " ".join(begins))
    folders = [path for path in (ROOT / package).iterdir() if path.is_dir()]
    assert sorted(mapped) == sorted(path.name for path in folders if [*path.rglob("*.py"), *path.rglob("*.proto")])


def test_every_benchmark_is_described() -> None:
    """Say in the README of benchmarks/ what each program there is for."""
    described = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    programs = [path for path in (ROOT / "benchmarks").glob("*.py") if "__main__" in path.read_text(encoding="utf-8")]
    assert [path.name for path in programs if path.name not in described and path.stem != "all"] == []
    assert len(programs) > 30


@cache
def names_of(module: str) -> set[str]:
    """What can be imported from a module of the package: names that it binds, and modules in it; empty without one."""
    path = (ROOT / "src").joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    if not file.exists():
        return set()
    inside = {other.stem for other in path.iterdir()} if path.is_dir() else set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inside.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            inside.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            inside |= {alias.asname or alias.name for alias in node.names}
    return inside


@pytest.mark.parametrize("folder", ["examples", "tests"])
def test_scripts_import_what_is_there(folder: str) -> None:
    """Import from the package what it has, in programs that run by hand and in tests of engines that are not installed:
    mypy reads neither."""
    missing = [
        f"{path.relative_to(ROOT)}: {node.module}.{alias.name}"
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "gpusimbench"
        for alias in node.names
        if alias.name not in names_of(node.module or "")
    ]
    assert missing == []
