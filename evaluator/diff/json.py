"""A comparison as JSON, for programs."""

from __future__ import annotations

from typing import Any

from gpusimbench.evaluator.diff.result import SCHEMA_VERSION, Difference
from gpusimbench.evaluator.json_values import dump, values_of


def to_json(found: Difference) -> dict[str, Any]:
    """The document that ``gsb-diff --json`` prints: the result's own names, the verdict, and whether it is over all."""
    return {
        "schema_version": SCHEMA_VERSION,
        "verdict": found.verdict.value,
        "all_compared": not (found.compared.left_out or found.lost),
        "lost": list(found.lost),
        **values_of(found),
    }


def dump_json(found: Difference) -> str:
    """The same as text, ending in a newline."""
    return dump(to_json(found))
