"""A leaderboard as a document: who is first where, then a section for each scene and device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import (
    EMPTY,
    Block,
    Cell,
    Column,
    Document,
    Item,
    Row,
    Table,
    Text,
    Tone,
    items,
    table,
)
from gpusimbench.evaluator.render.document import Section as Part
from gpusimbench.evaluator.render.numbers import estimate, missing, ranked
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.sections.rows import facets
from gpusimbench.evaluator.report.verdicts import QUESTIONS
from gpusimbench.evaluator.report.words import amount, shared
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.runs.groups import is_instrument
from gpusimbench.evaluator.share.leaderboard import formats
from gpusimbench.evaluator.share.leaderboard.standing import ELSEWHERE, Board, Section
from gpusimbench.evaluator.share.leaderboard.standing import Row as Standing
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import cut, plural

_LEAD = (
    "Computed from {}, and from nothing else: no figure here was typed in. Each row names its recordings by content "
    "hash, so that anybody who has them can compute this page again."
)
_REASON = 80
"""Characters of a reason on the first screen."""

_SPEED = Column(f"throughput [{FPS.unit}]", "mean ± SD over runs, 95 % interval")
_CHECKED = Column("checked", "by the rules of integrity-1: every byte was read; below it, what did not hold")
_REPRODUCED = Column("reproduced", "by replays among the recordings, bit for bit")


def leaderboard_document(board: Board) -> Document:
    """All that a leaderboard says; the same recordings give the same document."""
    named = [section for section in board.sections if section.device]
    blocks: list[Block] = []
    if board.unreadable:
        left = (Item(f"{name}: {why}", Tone.BAD) for name, why in board.unreadable)
        blocks.append(Part("left-out", "Files that are left out", (items(*left),)))
    if named:
        blocks.append(_firsts(named))
    blocks += [_section(number, section) for number, section in enumerate(named, 1)]
    for number, section in enumerate((s for s in board.sections if not s.device), 1):
        title = f"{section.scene}: ended before the simulator named its device"
        blocks.append(Part(f"unnamed{number}", title, (_without_place(f"unnamed{number}-none", section.rows),)))
    if board.notes:
        blocks.append(Part("notes", "Notes", (items(*board.notes),), plural(len(board.notes), "note"), folded=True))
    blocks.append(Part("how", "How to read this", (items(*_explained()),), folded=True))
    made_by = (Text("The same rows for programs: leaderboard.json and leaderboard.csv, beside this page."),)
    return Document(board.title, tuple(blocks), _LEAD.format(plural(board.recordings, "recording")), made_by)


def _firsts(sections: Sequence[Section]) -> Table:
    """The two fastest of each section, and how many cannot have a place."""
    rows = []
    for number, section in enumerate(sections, 1):
        first, second = (*section.ranked[:2], None, None)[:2]
        where = Cell(_heading(section), notes=(_timed_over(section),), link=f"s{number}")
        leaders = (_leader(first), _leader(second)) if first else (_nobody(section), EMPTY)
        rows.append(Row((where, *leaders, _barred(section)), {"scene": section.scene}))
    columns = (
        "scene, device", f"fastest [{FPS.unit}]", "next",
        Column("without a place", "rows that are INVALID, failed, break mechanics in any scene, or break a rule"),
    )  # fmt: skip
    return table("first", "Who is first", columns, rows)


def _nobody(section: Section) -> Cell:
    """Why no row of a section has a place."""
    if all(isinstance(row.fps.value, Missing) for row in section.unranked):
        return Cell("not timed", notes=("none of the recordings has a timed phase",), tone=Tone.QUIET)
    return Cell("no row has a place", tone=Tone.QUIET)


def _leader(row: Standing | None) -> Cell:
    if row is None:
        return Cell("no other row has a place", tone=Tone.QUIET)
    speed = ranked(row.fps)
    name = (row.name,) if row.name != row.key.simulator else ()
    envs = plural(row.key.n_env, "env", spec=",")
    told = f"{envs}, {row.key.version or 'no version'}, determinism {row.key.determinism}"
    notes = (*name, told, *speed.notes, *_equals(row))
    return Cell(f"{row.key.simulator}: {speed.text}", range=speed.range, notes=notes)


def _equals(row: Standing) -> tuple[str, ...]:
    """What must be known of a place: that it may be the same as the one above it."""
    return () if row.equals is None else (f"not shown to be slower than place {row.equals}",)


def _barred(section: Section) -> Cell:
    """Simulators with rows that something speaks against, and what; an untimed row or an instrument is no fault."""
    found = gathered((row.key.simulator, _in_short(row.place_missing)) for row in section.unranked if _is_fault(row))
    told = (
        f"{name} ({plural(len(reasons), 'row')}): {'; '.join(dict.fromkeys(reasons))}"
        for name, reasons in found.items()
    )
    return Cell(", ".join(found), notes=tuple(told), tone=Tone.BAD) if found else EMPTY


def _in_short(place_missing: str) -> str:
    """What kind of reason it is; the whole of it stands in the table of rows without a place."""
    kind, _, rest = place_missing.partition(": ")
    return cut(f"elsewhere {rest.partition('; ')[0]}" if kind == ELSEWHERE else kind, _REASON)


def _is_fault(row: Standing) -> bool:
    """Whether a row has no place for what it did, and not because it was never to be ranked."""
    untimed = isinstance(row.fps.value, Missing) and row.place_missing == row.fps.value.reason
    return bool(row.place_missing) and not untimed and not is_instrument(row.key)


def _section(number: int, section: Section) -> Part:
    key = f"s{number}"
    blocks: list[Block] = [Text(_scene(section))]
    if section.ranked:
        blocks.append(_ranking(f"{key}-ranking", section))
    if section.points:
        said = f"{plural(len(section.points), 'other point')} of these simulators, at which they are slower"
        blocks.append(Part(f"{key}-points", said, (_points(f"{key}-points-table", section.points),), folded=True))
    if section.unranked:
        said = ", ".join(dict.fromkeys(row.key.simulator for row in section.unranked))
        shown = _without_place(f"{key}-none-table", section.unranked)
        blocks.append(Part(f"{key}-none", "Without a place", (shown,), said, folded=True))
    how = _settings(f"{key}-settings-table", section.rows)
    blocks.append(Part(f"{key}-settings", "How each row was run", (how,), "switches, solver, protocol", folded=True))
    files = sum(len(row.entries) for row in section.rows)
    told = plural(files, "recording")
    blocks.append(Part(f"{key}-files", "Recordings", (_files(f"{key}-files-table", section),), told, folded=True))
    return Part(key, _heading(section), tuple(blocks))


def _heading(section: Section) -> str:
    """Scene, device, settings and timed steps: sections of one scene and device differ by the last two."""
    where = f"{section.scene} on {section.device}"
    return ", ".join(part for part in (where, section.treatment, section.timed) if part)


def _timed_over(section: Section) -> str:
    timed_over = f"timed over {section.timed} of the scene, " if section.timed else ""
    return f"{timed_over}{_scene(section)}"


def _scene(section: Section) -> str:
    return f"dt {section.dt:g} s, scene {formats.short(section.scene_hash)}"


def _ranking(key: str, section: Section) -> Table:
    columns: list[Column | str] = [
        "simulator", Column("place", "by throughput"), _SPEED, "envs", "memory",
        Column("N_env^max", "largest number of environments of its sweep, and why it goes no further"),
        *(question.column for question in QUESTIONS), _CHECKED, _REPRODUCED,
    ]  # fmt: skip
    rows = []
    for row in section.ranked:
        most, ends = formats.n_env_max(row)
        cells = (
            _claim(row), Cell(str(row.place), float(row.place or 0), notes=_equals(row)), _speed(row), _envs(row),
            _memory(row),
            Cell(most, notes=(ends,)) if most else EMPTY,
            *(question.answer([row.result]) for question in QUESTIONS),
            _checked(row), _reproduced(row),
        )  # fmt: skip
        rows.append(Row(cells, facets(row.key)))
    return table(key, f"Ranking: {_heading(section)}", columns, rows).without_empty_columns()


def _points(key: str, of: Sequence[Standing]) -> Table:
    rows = [Row((_claim(row), _envs(row), _speed(row), _memory(row), _checked(row)), facets(row.key)) for row in of]
    return table(key, "", ("simulator", "envs", _SPEED, "memory", _CHECKED), rows)


def _without_place(key: str, of: Sequence[Standing]) -> Table:
    rows = []
    for row in of:
        why = Cell(row.place_missing, tone=Tone.BAD if _is_fault(row) else Tone.QUIET)
        rows.append(Row((_claim(row), _envs(row), why, _checked(row), _reproduced(row)), facets(row.key)))
    return table(key, "", ("simulator", "envs", "why it has no place", _CHECKED, _REPRODUCED), rows)


def _settings(key: str, of: Sequence[Standing]) -> Table:
    rows = []
    for row in of:
        work = row.result.timed
        solver = [f"{name} {value}" for name, value in work.settings.items() if value]
        said = (_lines(solver), _lines(formats.settings(row)), _lines(formats.unmet(row)))
        rows.append(Row((Cell(row.name, notes=(plural(row.key.n_env, "env", spec=","),)), *said), facets(row.key)))
    return table(key, "", ("simulator", "solver", "switches in force", f"rules of {PROTOCOL} that are not met"), rows)


def _lines(said: Sequence[str]) -> Cell:
    return Cell(said[0], notes=tuple(said[1:])) if said else EMPTY


def _files(key: str, section: Section) -> Table:
    rows = []
    for row in section.rows:
        for entry in row.entries:
            ended = Cell(entry.status, tone=Tone.PLAIN if entry.status == "complete" else Tone.BAD)
            of = Cell(formats.short(entry.replay_of), code=True) if entry.replay_of else EMPTY
            who = Cell(row.name, notes=(plural(row.key.n_env, "env", spec=","),))
            cells = (who, Cell(entry.name, code=True), Cell(entry.content_hash or "no hash", code=True), ended, of)
            rows.append(Row(cells, facets(row.key)))
    return table(key, "", ("simulator", "file", "content hash", "status", "replay of"), rows)


def _claim(row: Standing) -> Cell:
    """The claim of a row: name, version, level."""
    return Cell(row.name, notes=(f"{row.key.version or 'no version'}; determinism {row.key.determinism}",))


def _envs(row: Standing) -> Cell:
    return Cell(f"{row.key.n_env:,}", float(row.key.n_env))


def _speed(row: Standing) -> Cell:
    beside = [plural(len(row.result.group.complete), "run"), *timed.beside(row.result.timed)[:1]]
    if others := shared(row.fps):
        beside.append(f"another process on the GPU: {others}")
    if speeds := row.fps.of(Throughput).speeds:
        beside.append(f"by outcome: {speeds.ranges}")
    return estimate(row.fps, *beside, tone=Tone.WARNING if others else Tone.PLAIN)


def _memory(row: Standing) -> Cell:
    if isinstance(row.memory.value, Missing):
        return missing(row.memory.value)
    name = row.memory.name
    whose = "of the host" if name.startswith("host") else "of the GPU"
    whose = "of the process on the GPU" if name.startswith("process") else whose
    return Cell(amount(row.memory), float(row.memory.value), notes=(whose,))


def _checked(row: Standing) -> Cell:
    """What the rules say of its recordings, what did not hold, and which rules of the protocol are not met."""
    unmet = formats.unmet_in_short(row)
    beyond = (unmet,) if unmet else ()
    return Cell(formats.checked(row), notes=(*row.gates, *beyond), tone=Tone.BAD if row.gates else Tone.PLAIN)


def _reproduced(row: Standing) -> Cell:
    return Cell(formats.reproduced(row.reproduction), tone=Tone.GOOD if row.reproduction.reproduced else Tone.PLAIN)


def _explained() -> Iterator[str]:
    yield (
        "A place is by throughput within one scene, one step, one device and the same timed steps of the scene: at "
        "other steps the scene has other contacts. A timed phase below 1 s is marked. Cone, iterations and tolerance "
        "of the solver stand in the table of how each row was run: with others a step is another amount of work. Two "
        "devices are not compared. If throughput goes with the outcome of a run, the place is that of the slowest run."
    )
    yield (
        "A row is a set of runs of one simulator, version, switches, options, device and number of environments. A "
        "simulator that was run with several numbers of environments has its place by the one at which it is fastest."
    )
    yield (
        "A run that is INVALID, or that breaks a rule of integrity-1, leaves its row without a place, and so do states "
        "that break a check of mechanics, which is made where states were captured. Either holds for the same engine "
        "in every scene. Runs that failed are named. A throughput that breaks a rule of "
        f"{PROTOCOL} on the timed window or on evidence of work has no place: the world may have been at rest. Neither "
        "has a throughput that is wrong by an error of the recorder that was found later."
    )
    yield (
        "Intervals are 95 %, over runs. A row is not shown to be slower than the row above it where the interval of "
        "the ratio of their throughputs contains 1, or, with fewer than three runs a side, where the ratio is above "
        "0.95: then the two places may be one."
    )
    yield "Repeats itself, envs alike: whether state hashes of runs, or of environments, differ at any captured step."
    yield (
        "Whole means that all of a file was read: every CRC, every digest, the content hash, clocks, hashes and states "
        f"against each other. A rule of {PROTOCOL} that is not met stands below it: the row has numbers of steps or a "
        "machine of its own, and not those of the benchmark."
    )
    yield (
        "Reproduced bitwise means that a recording of a replay is among these recordings, and that its state at every "
        "captured step is that of the original, bit for bit. A verdict that somebody wrote down does not count. That a "
        "recording is a replay, and on what machine, are its own words; recordings name no people, so whether anybody "
        "else made it is not known here."
    )
    yield (
        "A content hash shows that a file is the one that somebody published, and not that a simulator made it. That "
        "the same comes out on your machine does: gsb-audit FILE."
    )
