"""A comparison of recordings as JSON."""

from __future__ import annotations

from gpusimbench.evaluator.diff.result import Difference
from gpusimbench.evaluator.json_values import dump, values_of

SCHEMA_VERSION = 1


def dump_json(found: Difference) -> str:
    """The document that ``gsb-diff --json`` prints: the result's own names, the verdict, and whether it is over all."""
    document = {
        "schema_version": SCHEMA_VERSION,
        "verdict": found.verdict.value,
        "all_compared": not (found.compared.left_out or found.lost),
        "lost": list(found.lost),
        **values_of(found),
    }
    return dump(document)
