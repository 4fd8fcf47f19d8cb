"""The tables of a set, held against those that its recordings give."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.report.parquet import METRICS, polars
from gpusimbench.schemas.text import cut

MAX_BYTES = 64 << 20
"""A larger table is not read."""

_MOST_TOLD = 10
_NAMING = {METRICS: ("group", "metric")}
_LONGEST = 80


def compare_table(name: str, path: Path, expected: Any, tolerance: float) -> list[str]:
    """What differs, a sentence each, of many the first ones; nothing where every value is the same.

    expected   data frame of polars
    tolerance  relative, of numbers; 0 wants the same bits
    """
    pl = polars()
    try:
        if path.stat().st_size > MAX_BYTES:
            return [f"it is larger than the {MAX_BYTES} bytes that are read"]
        lazy = pl.scan_parquet(path, glob=False, hive_partitioning=False)  # a folder may be called [1], or k=v
        schema = lazy.collect_schema()
        if schema != expected.schema:
            return [f"it has other columns: {_other(list(schema), expected.columns)}"]
        rows = lazy.select(pl.len()).collect().item()
        if rows != len(expected):
            return [f"it has {rows} rows, and the recordings give {len(expected)}"]
        found = lazy.collect()
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # what a stranger's file makes polars do is no Exception always
        return [f"it cannot be read: {str(error).splitlines()[0][:200] if str(error) else type(error).__name__}"]
    naming = [expected.columns.index(column) for column in _NAMING.get(name, ("file",))]
    return list(_first(_differences(expected.columns, naming, found.rows(), expected.rows(), tolerance)))


def _other(found: Sequence[str], expected: Sequence[str]) -> str:
    missing, more = sorted(set(expected) - set(found)), sorted(set(found) - set(expected))
    told = [f"without {', '.join(missing)}" if missing else "", f"with {', '.join(more)}"[:300] if more else ""]
    return " and ".join(part for part in told if part) or "in another order, or of other types"


def _differences(
    columns: Sequence[str],
    naming: Sequence[int],
    found: Sequence[tuple[Any, ...]],
    expected: Sequence[tuple[Any, ...]],
    tolerance: float,
) -> Iterator[str]:
    for theirs, ours in zip(found, expected, strict=True):
        for column, there, here in zip(columns, theirs, ours, strict=True):
            if not _same(there, here, tolerance):
                row = ", ".join(str(ours[index]) for index in naming)
                yield f"{row}: {column} is {_shown(there)}, and {_shown(here)} by the recordings{_apart(there, here)}"


def _same(one: Any, other: Any, tolerance: float) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        if one == other or (math.isnan(one) and math.isnan(other)):
            return True
        return abs(one - other) <= tolerance * max(abs(one), abs(other))
    return type(one) is type(other) and bool(one == other)


def _apart(one: Any, other: Any) -> str:
    if not (isinstance(one, float) and isinstance(other, float) and math.isfinite(one) and math.isfinite(other)):
        return ""
    return f" (relative difference {abs(one - other) / max(abs(one), abs(other)):.1e})"


def _shown(value: Any) -> str:
    return "nothing" if value is None else cut(repr(value), _LONGEST)


def _first(sentences: Iterator[str]) -> Iterator[str]:
    more = 0
    for number, sentence in enumerate(sentences):
        if number < _MOST_TOLD:
            yield sentence
        else:
            more += 1
    if more:
        yield f"and {more} more values"
