"""Real trials from a CSV file: the planar positions of the cubes after each trial."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trial_units import METRES

COLUMNS = ("trial", "cube", "x", "y")
HEIGHT = "z"
UNITS = {unit: METRES[unit] for unit in ("m", "cm")}


@dataclass(frozen=True)
class Trials:
    """Measured positions.

    names       of the trials, in order of appearance
    positions   [m], shape [trial, cube, 2 or 3]
    components  ("x", "y") or ("x", "y", "z")
    """

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    components: tuple[str, ...]


def parse_trials(text: str, *, unit: str, cubes: int) -> Trials:
    """Trials from CSV text with the header trial,cube,x,y[,z]; further columns are not allowed.

    unit   of x, y and z: a key of UNITS
    cubes  number of cubes in each trial, numbered from 0

    Raises UsageError naming row (the header is row 1) and column of the first thing that is wrong.
    """
    try:
        rows = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=None)))
    except csv.Error as error:
        raise UsageError(f"not readable as CSV: {error}") from None
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if not rows:
        raise UsageError("the trials file is empty; its first row is trial,cube,x,y or trial,cube,x,y,z")
    columns = [cell.strip() for cell in rows[0]]
    components = _components(columns)
    place = {name: columns.index(name) for name in (*COLUMNS[:2], *components)}
    found: dict[str, dict[int, tuple[float, ...]]] = {}
    first_row: dict[tuple[str, int], int] = {}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            raise UsageError(f"row {number} has {len(row)} cells, the header has {len(columns)}")
        trial = row[place["trial"]].strip()
        if not trial:
            raise UsageError(f"row {number}, column trial: empty")
        cube = _cube(row[place["cube"]], number, cubes)
        if (trial, cube) in first_row:
            raise UsageError(
                f"row {number}, column cube: trial {trial} has cube {cube} already, in row {first_row[trial, cube]}"
            )
        first_row[trial, cube] = number
        point = tuple(_number(row[place[name]], number, name) * UNITS[unit] for name in components)
        found.setdefault(trial, {})[cube] = point
    if not found:
        raise UsageError("the trials file has a header and no rows")
    for trial, points in found.items():
        missing = sorted(set(range(cubes)) - set(points))
        if missing:
            last = max(row for (name, _), row in first_row.items() if name == trial)
            raise UsageError(
                f"trial {trial} (last in row {last}), column cube: {len(points)} of {cubes} cubes; "
                f"missing: {', '.join(map(str, missing))}"
            )
    positions = np.array([[points[c] for c in range(cubes)] for points in found.values()])
    return Trials(tuple(found), positions, components)


def _components(columns: list[str]) -> tuple[str, ...]:
    for name in COLUMNS:
        if name not in columns:
            raise UsageError(f"row 1: column {name} is missing; the header is trial,cube,x,y or trial,cube,x,y,z")
    for name in columns:
        if name not in (*COLUMNS, HEIGHT):
            raise UsageError(f"row 1: column '{name}' is not known; the header is trial,cube,x,y or trial,cube,x,y,z")
        if columns.count(name) > 1:
            raise UsageError(f"row 1: column {name} appears twice")
    return ("x", "y", "z") if HEIGHT in columns else ("x", "y")


def _cube(cell: str, row: int, cubes: int) -> int:
    try:
        cube = int(cell)
    except ValueError:
        raise UsageError(f"row {row}, column cube: '{cell}' is not a whole number") from None
    if not 0 <= cube < cubes:
        raise UsageError(f"row {row}, column cube: {cube} is not one of the scene's {cubes} cubes, 0 to {cubes - 1}")
    return cube


def _number(cell: str, row: int, column: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise UsageError(f"row {row}, column {column}: '{cell}' is not a number") from None
    if not math.isfinite(value):
        raise UsageError(f"row {row}, column {column}: {cell.strip()} is not a position")
    return value
