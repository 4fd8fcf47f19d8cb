"""A leaderboard as CSV: a line for each row."""

from __future__ import annotations

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.csv import Cell, to_csv
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.share.leaderboard import words
from gpusimbench.evaluator.share.leaderboard.standing import Board, Row, Section

COLUMNS = (
    "scene", "device", "dt_s", "place", "simulator", "version", "determinism", "label", "n_env", "runs", "recordings",
    "fps", "fps_sd", "fps_low", "fps_high", "memory", "memory_unit", "n_env_max", "distinct_envs", "distinct_runs",
    "type", "check", "reproduced", "replays", "gates", "no_place", "content_hashes",
    *(column.title for column in timed.ALL),
)  # fmt: skip


def dump_csv(board: Board) -> str:
    """A line for each row, with the names of the columns first."""
    return to_csv(COLUMNS, (_values(section, row) for section in board.sections for row in section.rows))


def _values(section: Section, row: Row) -> tuple[Cell, ...]:
    key, metrics = row.key, row.result.metrics
    low, high = row.fps.ci95 or (None, None)
    return (
        section.scene, section.device, section.dt, row.place, key.simulator, key.version, key.determinism,
        row.result.label, key.n_env, len(row.result.group.complete), len(row.entries),
        known(row.fps.value), row.fps.sd, low, high, known(row.memory.value), row.memory.unit,
        row.sweep.n_max if row.sweep else None,
        *(known(metrics[name].value) for name in ("distinct_envs", "distinct_runs", "regime_published")),
        words.checked(row), row.reproduction.reproduced, row.reproduction.count,
        "; ".join(row.gates), row.no_place, " ".join(entry.content_hash for entry in row.entries),
        *timed.cells(timed.ALL, row.result.timed),
    )  # fmt: skip
