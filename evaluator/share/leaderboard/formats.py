"""A leaderboard's figures: as words, as CSV with a line for each row, and as JSON with all that is behind each."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from gpusimbench.evaluator.check.rules.rule import PROTOCOL, load_rules
from gpusimbench.evaluator.json_values import document_of, dump, picked
from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.numbers import ranked
from gpusimbench.evaluator.render.table_files import CsvCell, to_csv
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.json import estimate_record
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.share.dataset.contents import BROKEN
from gpusimbench.evaluator.share.leaderboard.reproduction import Reproduction
from gpusimbench.evaluator.share.leaderboard.standing import Board, Row, Section
from gpusimbench.schemas import __version__
from gpusimbench.schemas.text import cut, plural

_SHORT = 10
_LONGEST = 100
_YES_OR_NO = re.compile(r"^found (yes|no) ")

COLUMNS = (
    "scene", "device", "dt", "settings", "place", "simulator", "version", "determinism", "label", "n_env", "runs",
    "recordings", "fps", "fps_sd", "fps_low", "fps_high", "memory", "memory_unit", "n_env_max", "distinct_envs",
    "distinct_runs", "type", "check", "reproduced", "replays", "gates", "place_missing", "content_hashes",
    *(column.title for column in timed.ALL),
)  # fmt: skip

KIND = "gpusimbench leaderboard"
"""By which a leaderboard's document is told from other files of that name."""


def leaderboard_lines(board: Board) -> Iterator[str]:
    """The first of each section, and how many stand behind."""
    for section in board.sections:
        where = f"{section.scene} on {section.device or 'a device that was never told'}, dt {section.dt:g} s"
        where = ", ".join(part for part in (where, section.treatment, section.timed) if part)
        if section.ranked:
            first = section.ranked[0]
            fps = ranked(first.fps)
            speed = " in ".join((f"{fps.text} env-steps/s", *fps.notes))
            yield (
                f"{where}: 1. {first.name} {first.key.version} with {plural(first.key.n_env, 'env', spec=',')}, "
                f"{speed} ({'; '.join(timed.beside(first.result.timed))}); "
                f"{len(section.ranked)} ranked, {len(section.unranked)} not"
            )
        else:
            yield f"{where}: none ranked, {len(section.unranked)} not"


def short(content_hash: str) -> str:
    """The first digits of a content hash."""
    return content_hash[:_SHORT] or "no hash"


def n_env_max(row: Row) -> tuple[str, str]:
    """N_env^max of the sweep that a row is a point of, and in short why it goes no further; empty without a sweep."""
    sweep = row.sweep
    if sweep is None or sweep.n_max is None:
        return "", ""
    beyond = next((point for point in sweep.points if point.n_env > sweep.n_max), None)
    why = f"{', '.join(beyond.causes)} at {beyond.n_env:,}" if beyond else sweep.ends
    return f"{sweep.n_max:,}", cut(why, _LONGEST)


def checked(row: Row) -> str:
    """What the rules of integrity-1 say of its recordings."""
    broken = sum(entry.check == BROKEN for entry in row.entries)
    count = len(row.entries)
    return f"{broken} of {count} break a rule" if broken else f"{count} of {count} whole"


def deviations(row: Row) -> list[str]:
    """Rules of the protocol that recordings break, each once, with how many do."""
    found: dict[str, int] = {}
    for entry in row.entries:
        for deviation in entry.deviations:
            found[deviation] = found.get(deviation, 0) + 1
    return [f"{deviation} ({count} of {len(row.entries)})" for deviation, count in found.items()]


def unmet(row: Row) -> list[str]:
    """Rules of the protocol that are not met: what is wrong, and what was found in how many files."""
    told: dict[str, list[str]] = {rule: [] for rule in row.result.timed.unmet.findings}
    for deviation in deviations(row):
        rule, _, found = deviation.partition(": ")
        told.setdefault(rule, []).append(_YES_OR_NO.sub("", found))
    broken = _broken()
    return [f"{broken[rule]}: {', '.join(found)}" if found else broken[rule] for rule, found in told.items()]


@cache
def _broken() -> dict[str, str]:
    return {rule.id: rule.broken.rstrip(".") for rule in load_rules(PROTOCOL).rules}


def unmet_in_short(row: Row) -> str:
    """The same as names of rules; empty where all are met."""
    rules = ", ".join(rule.replace("-", " ") for rule in row.result.timed.unmet.findings)
    return f"{PROTOCOL} not met: {rules}" if rules else ""


def reproduced(found: Reproduction) -> str:
    """Whether anybody's replay gave the same states."""
    if not found.originals:
        return "no states captured"
    if not found.count:
        return "not replayed"
    if not found.reproduced:
        compared = any(r.agrees is False for replays in found.replays.values() for r in replays)
        how = "with other states" if compared else "without states to compare"
        return f"replayed by {plural(found.count, 'recording')}, {how}"
    by = f"by {plural(len(found.agreeing), 'recording')} on {plural(found.machines, 'kind')} of machine"
    where = f"{found.elsewhere} other than its own" if found.elsewhere else found.nowhere_else
    return f"{found.reproduced} of {found.originals} reproduced bitwise, {by}, {where}"


def settings(row: Row) -> list[str]:
    """Determinism, switches in force and options that tell it from others, each as name=value."""
    switches = json.loads(row.key.switches or "{}")
    return [f"{name}={_brief(value)}" for name, value in sorted(switches.items())]


def _brief(value: object) -> str:
    return cut(value if isinstance(value, str) else json.dumps(value, sort_keys=True), 60)


def dump_csv(board: Board) -> str:
    """A line for each row, with the names of the columns first."""
    return to_csv(COLUMNS, (_values(section, row) for section in board.sections for row in section.rows))


def _values(section: Section, row: Row) -> tuple[CsvCell, ...]:
    key, metrics = row.key, row.result.metrics
    low, high = row.fps.ci95 or (None, None)
    return (
        section.scene, section.device, section.dt, section.treatment, row.place, key.simulator, key.version,
        key.determinism, row.result.label, key.n_env, len(row.result.group.complete), len(row.entries),
        known(row.fps.value), row.fps.sd, low, high, known(row.memory.value), row.memory.unit,
        row.sweep.n_max if row.sweep else None,
        *(known(metrics[name].value) for name in ("distinct_envs", "distinct_runs", "regime_published")),
        checked(row), row.reproduction.reproduced, row.reproduction.count,
        "; ".join(row.gates), row.place_missing, " ".join(entry.content_hash for entry in row.entries),
        *timed.cells(timed.ALL, row.result.timed),
    )  # fmt: skip


def dump_json(board: Board) -> str:
    """The document."""
    return dump(
        document_of({
            "kind": KIND,
            "gpusimbench": __version__,
            "title": board.title,
            "sample_time_s": board.sample_time,
            "sections": [_section(section) for section in board.sections],
            "unreadable": [{"file": name, "reason": why} for name, why in board.unreadable],
            "notes": board.notes,
        })
    )  # fmt: skip


def _section(section: Section) -> dict[str, Any]:
    return {
        "scene": section.scene,
        "scene_sha256": section.scene_hash,
        "device": section.device,
        "dt": section.dt,
        "settings": dict(section.settings),
        "timed": section.timed,
        "rows": [_row(row) for row in section.rows],
    }


def _row(row: Row) -> dict[str, Any]:
    key, metrics = row.key, row.result.metrics
    return {
        **picked(row, "place equals place_missing"),
        "label": row.result.label,
        **picked(key, "simulator version determinism"),
        "options": key.parsed_options,
        "switches": json.loads(key.switches or "{}"),
        **picked(key, "n_env warmup timed_steps"),
        "outcomes": row.result.group.outcomes,
        "throughput": estimate_record(row.fps),
        **picked(row.fps.of(Throughput), "co_tenants speeds"),
        "timed": timed.timed_record(row.result.timed),
        "memory": estimate_record(row.memory),
        "n_env_max": row.sweep.n_max if row.sweep else None,
        "sweep_ends": row.sweep.ends if row.sweep else None,
        **{name: estimate_record(metrics[name]) for name in ("distinct_envs", "distinct_runs", "regime_published")},
        "gates": row.gates,
        "protocol": deviations(row),
        "reproduction": row.reproduction,
        "recordings": row.entries,
    }
