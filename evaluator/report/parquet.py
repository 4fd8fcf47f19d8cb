"""An evaluation as Parquet tables, for questions that reach over many evaluations.

Tables of several evaluations, of several laboratories, are read as one::

    polars.scan_parquet("*/metrics.parquet").filter(polars.col("metric") == "fps").group_by("simulator").agg(...)
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from typing import Any

from gpusimbench.evaluator.missing import known, why_missing
from gpusimbench.evaluator.report.words import floor_of
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.timed_work import SETTINGS, TimedWork
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import printable

METRICS, RUNS = "metrics.parquet", "runs.parquet"

_KEY = {
    "group": "String", "scene": "String", "scene_hash": "String", "simulator": "String", "version": "String",
    "device": "String", "n_env": "Int64", "dt": "Float64", "seed": "String", "warmup": "Int64", "timed_steps": "Int64",
    "determinism": "String", "options": "String", "switches": "String", "conditions": "String",
}  # fmt: skip

_METRICS = {
    **_KEY, "metric": "String", "value": "Float64", "unit": "String", "direction": "String", "sd": "Float64",
    "low": "Float64", "high": "Float64", "n": "Int64", "exactness": "String", "method": "String",
    "value_missing": "String", "first_timed_step": "Int64", "last_timed_step": "Int64", "shortest_timed_s": "Float64",
    "cone": "String", "iterations": "String", "tolerance": "String", "protocol_findings": "Int64",
    "floor": "Float64", "p_value": "Float64",
}  # fmt: skip

_RUNS = {
    **_KEY, "file": "String", "content_hash": "String", "run_id": "String", "run_index": "Int64", "status": "String",
    "cause": "String", "reason": "String", "lost": "Int64", "created_utc": "String", "host": "String", "gpu": "String",
}  # fmt: skip


def parquet_tables(evaluation: Evaluation) -> dict[str, bytes]:
    """Both tables as Parquet, by the name of their file; UsageError without polars.

    metrics.parquet  a row for each metric of each group; an interval where it has one; floor and p_value of a W1 whose
                     environments were exchanged between two sides
    runs.parquet     a row for each recording that could be read
    """
    found = {}
    for name, table in frames(evaluation).items():
        stream = io.BytesIO()
        table.write_parquet(stream)
        found[name] = stream.getvalue()
    return found


def frames(evaluation: Evaluation) -> dict[str, Any]:
    """Both tables as data frames of polars, by the name of their file; UsageError without polars."""
    pl = polars()
    return {
        name: pl.DataFrame(list(rows), schema={column: getattr(pl, kind) for column, kind in columns.items()})
        for name, columns, rows in (
            (METRICS, _METRICS, _metric_rows(evaluation)),
            (RUNS, _RUNS, _run_rows(evaluation)),
        )
    }


def polars() -> Any:
    """The package that writes them; UsageError where it is not installed."""
    try:
        import polars as pl
    except ImportError:
        raise UsageError("tables need the package polars: pip install 'gpusimbench[tables]'") from None
    return pl


def _key_of(result: GroupResult) -> dict[str, Any]:
    key = result.group.key
    # a seed may be beyond 64 bits with a sign, and one without one: it is a name rather than a number
    return {
        **{name: getattr(key, name) for name in _KEY if name != "group"},
        "group": result.label,
        "seed": str(key.seed),
    }


def _metric_rows(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    for result in evaluation.results:
        for metric in result.metrics.values():
            low, high = metric.ci95 or (None, None)
            floor = known(floor_of(metric).w1)
            yield _clean({
                **_key_of(result), "metric": metric.name, **_values_of(metric), "low": low, "high": high, "n": metric.n,
                **_timed(result.timed),
                "floor": floor.floor_mean if floor else None, "p_value": floor.p_value if floor else None,
            })  # fmt: skip


def _timed(work: TimedWork) -> dict[str, Any]:
    # beside every metric, as the key is: whoever takes a throughput from here sees what it was timed over
    return {
        "first_timed_step": min((window.first for window in work.windows), default=None),
        "last_timed_step": max((window.last for window in work.windows), default=None),
        "shortest_timed_s": work.seconds[0] if work.seconds else None,
        **{name: work.settings.get(name) or None for name in SETTINGS},
        "protocol_findings": work.unmet.count,
    }


def _values_of(metric: Estimate) -> dict[str, Any]:
    return {
        "value": known(metric.value),
        "unit": metric.unit,
        "direction": metric.metric.direction.value,
        "value_missing": why_missing(metric.value),
        **{name: getattr(metric, name) for name in ("sd", "exactness", "method")},
    }


def _run_rows(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    for result in evaluation.results:
        for recording in result.group.recordings:
            yield _clean({**_key_of(result), **_run(recording)})


def _run(recording: Run) -> dict[str, Any]:
    provenance = recording.provenance
    return {
        "file": str(recording.path),
        "content_hash": recording.content_hash or None,
        "run_id": provenance.run_id,
        "run_index": recording.configuration.run_index,
        "status": recording.status,
        "cause": recording.cause,
        "reason": recording.reason,
        "lost": len(recording.dropouts),
        "created_utc": provenance.created_utc,
        "host": json.dumps(provenance.host, sort_keys=True),
        "gpu": provenance.gpus[0].get("name") if provenance.gpus else None,
    }


def _clean(row: dict[str, Any]) -> dict[str, Any]:
    # a file's name may hold bytes that are no text, and Parquet has only text
    return {name: printable(value) if isinstance(value, str) else value for name, value in row.items()}
