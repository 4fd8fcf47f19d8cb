"""A leaderboard as JSON: all that stands behind each row."""

from __future__ import annotations

import json
from typing import Any

from gpusimbench.evaluator.json_values import dump, picked, values_of
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.evidence_json import estimate_record
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.share.leaderboard import words
from gpusimbench.evaluator.share.leaderboard.standing import Board, Row, Section
from gpusimbench.schemas import __version__

SCHEMA_VERSION = 1
KIND = "gpusimbench leaderboard"
"""By which a leaderboard's document is told from other files of that name."""


def dump_json(board: Board) -> str:
    """The document."""
    return dump(
        values_of({
            "schema_version": SCHEMA_VERSION,
            "kind": KIND,
            "gpusimbench": __version__,
            "title": board.title,
            "sample_time_s": board.sample_time,
            "sections": [_section(section) for section in board.sections],
            "unreadable": [{"file": name, "why": why} for name, why in board.unreadable],
            "notes": board.notes,
        })
    )  # fmt: skip


def _section(section: Section) -> dict[str, Any]:
    return {
        "scene": section.scene,
        "scene_sha256": section.scene_hash,
        "device": section.device,
        "dt_s": section.dt,
        "timed": section.timed,
        "rows": [_row(row) for row in section.rows],
    }


def _row(row: Row) -> dict[str, Any]:
    key, metrics = row.key, row.result.metrics
    return {
        **picked(row, "place no_place"),
        "label": row.result.label,
        **picked(key, "simulator version determinism"),
        "options": json.loads(key.options),
        "switches": json.loads(key.switches or "{}"),
        **picked(key, "n_env warmup timed_steps"),
        "runs": row.result.group.outcomes,
        "throughput": _metric(row.fps),
        **picked(row.fps.of(Throughput), "co_tenants speeds"),
        "timed": timed.timed_record(row.result.timed),
        "memory": _metric(row.memory),
        "n_env_max": row.sweep.n_max if row.sweep else None,
        "sweep_ends": row.sweep.ends if row.sweep else None,
        **{name: _metric(metrics[name]) for name in ("distinct_envs", "distinct_runs", "regime_published")},
        "gates": row.gates,
        "protocol": words.deviations(row),
        "reproduction": row.reproduction,
        "recordings": row.entries,
    }


def _metric(metric: Estimate) -> dict[str, Any]:
    return {"name": metric.name, **estimate_record(metric)}
