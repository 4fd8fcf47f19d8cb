"""Prims of USD and their text form (.usda): names, values, poses, and the stage that holds them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from gpusimbench.recorder.scenes.base import IDENTITY, Quaternion, Vector

Value = bool | int | float | str
Apis = Mapping[str, Mapping[str, Value]]


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """A name that USD allows for each of these names, in order; different names stay different."""
    found: dict[str, str] = {}
    for name in names:
        word = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
        stem = word if not word[0].isdigit() else f"_{word}"
        word, number = stem, 1
        while word in found.values():
            number += 1
            word = f"{stem}_{number}"
        found.setdefault(name, word)
    return found


@dataclass
class Prim:
    """A prim on its way into the text.

    apis        schemas applied
    properties  lines
    """

    kind: str
    name: str
    apis: list[str] = field(default_factory=list)
    properties: list[str] = field(default_factory=list)
    children: list[Prim] = field(default_factory=list)

    def add(self, child: Prim) -> Prim:
        """Put a prim below this one."""
        self.children.append(child)
        return child

    def apply(self, apis: Apis, *names: str) -> None:
        """Apply schemas with the engine's settings of them, if it has any."""
        for name in names:
            if name in apis:
                self.apis.append(name)
                self.properties += [f"{key} = {literal(value)}" for key, value in apis[name].items()]

    def lines(self) -> list[str]:
        """The text; braces stand on lines of their own, without which some readers fail."""
        head = f'def {self.kind} "{self.name}"'
        schemas = ", ".join(f'"{api}"' for api in self.apis)
        top = [f"{head} (", f"    prepend apiSchemas = [{schemas}]", ")"] if self.apis else [head]
        inner = list(self.properties)
        for child in self.children:
            inner += child.lines()
        return [*top, "{", *(f"    {line}" for line in inner), "}"]


def stage_text(world: Prim) -> str:
    """A stage of this default prim: metres, kilograms, z up."""
    header = ["#usda 1.0", "(", '    defaultPrim = "World"', "    kilogramsPerUnit = 1", "    metersPerUnit = 1"]
    return "\n".join([*header, '    upAxis = "Z"', ")", "", *world.lines(), ""])


def pose_lines(position: Vector, orientation: Quaternion) -> list[str]:
    """Properties of a prim that stands there in its parent's frame [m], turned by a quaternion wxyz."""
    operations = {"double3 xformOp:translate": tuple_text(position)}
    if orientation != IDENTITY:
        operations["quatd xformOp:orient"] = tuple_text(orientation)
    return operation_lines(operations)


def operation_lines(operations: Mapping[str, str]) -> list[str]:
    """Transformations by their declarations, and their order."""
    order = ", ".join(f'"{name.partition(" ")[2]}"' for name in operations)
    return [*(f"{name} = {value}" for name, value in operations.items()), f"uniform token[] xformOpOrder = [{order}]"]


def tuple_text(values: Iterable[float]) -> str:
    """Numbers as USD has them, every bit kept."""
    return f"({', '.join(literal(value) for value in values)})"


def literal(value: Value) -> str:
    """A value as USD has it."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return f'"{value}"'
        case int():
            return str(value)
    return repr(float(value))
