"""What gsb-diff says: the verdict, the first difference, fields, distances, classes and settings; and all as JSON."""

from __future__ import annotations

import math

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.arrays import ArrayDivergence, ArraysDifference
from gpusimbench.evaluator.diff.brief import Labels, apart, both_of, brief, classes_of, place_of, reached, verdict_of
from gpusimbench.evaluator.diff.result import Basis, Difference, FieldDifference, Growth
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Document,
    Item,
    Items,
    Section,
    Text,
    Tone,
    facts,
    items,
    table,
)
from gpusimbench.evaluator.render.numbers import NONE, length, ulps
from gpusimbench.schemas.text import cut, plural

_REMARKS, _VALUE, _CHANGES, _CLASSES = 3, 48, 8, 8
_ROWS, _WIDTH = 6, 60
_FEWEST = 8  # steps that are worth a sparkline
_BASIS = {
    Basis.BITS: "in any bit",
    Basis.FLOAT32: "beyond the resolution of float32",
    Basis.LOCAL: "beyond the resolution at their origins",
}

_FIELDS = 8


def diff_document(found: Difference, *, every: bool = False) -> Document:
    """The verdict and what it rests on; with `every`, all that is known."""
    blocks: list[Block] = [verdict_of(found), brief(found, every=every), *remarks(found, every=every)]
    sections: list[Section | None] = [_fields(found), _distances(found.growth), _equal(found)] if found.first else []
    if found.program is not None:
        sections.append(words.section(found.program, found.a.dt))
    sections.append(_settings(found))
    at_length = [section for section in sections if section is not None]
    if every:
        blocks += at_length
    if not every and _in_ulps(found):
        blocks.append(Text("  ULP: units in the last place", Tone.QUIET))
    if at_length and not every:
        blocks.append(Text(f"  more with --all: {', '.join(section.title for section in at_length)}", Tone.QUIET))
    return Document("", tuple(blocks))


def _in_ulps(found: Difference) -> bool:
    """Whether the first number that differs is told in ULP."""
    state = found.first.state if found.first and found.first.phase != "timed" else None
    return state is not None and words.in_ulps(state.number, named=True).endswith("ULP")


def remarks(found: Difference, *, every: bool) -> list[Block]:
    """What was not compared or is not there, in a warning's colour, and what else must be known."""
    made = [Item(f"  not compared: {text}", Tone.WARNING) for text in found.compared.left_out]
    made += [Item(f"  incomplete: {text}", Tone.WARNING) for text in found.lost]
    notes = list(found.notes)
    if found.copies:
        notes.insert(0, "both files are recordings of the same run, so their agreement says nothing about another run")
    if found.compared.hash_steps is None:
        notes.append(
            f"state hashes were not used, so only recorded states are known: {found.compared.hash_steps_missing}"
        )
    made += [Item(f"  note: {text}") for text in notes]
    if not every and len(made) > _REMARKS + 1:
        more = len(made) - _REMARKS
        made = [*made[:_REMARKS], Item(f"  and {more} more remarks, printed with --all", Tone.WARNING)]
    return [Items(tuple(made))] if made else []


def _fields(found: Difference) -> Section | None:
    differing = [f for f in found.compared.fields if f.different]
    if not differing:
        return None
    by = " or ".join(dict.fromkeys(_BASIS[f.basis] for f in found.compared.fields))
    made = table(
        "fields",
        "",
        ("field", "differ", "of", "from step", "ULP then", "max ULP", "max |a - b|"),
        [_row(field) for field in found.compared.fields],
    )
    kinds = [
        Item(f"  {field.field}: {count:,} of the differing numbers {'is' if count == 1 else 'are'} {what}")
        for field in differing
        for count, what in (
            (field.signed_zeros, "0.0 against -0.0"),
            (field.nan_payloads, "NaN of another payload"),
            (field.other_sign, "of quaternions of the same rotation, other sign"),
            (field.not_finite, "not finite on a side, and in no distance"),
        )
        if count
    ]
    return Section(
        "fields", "fields", (made, Items(tuple(kinds))), f"numbers of all common recorded states that differ {by}"
    )


def _row(field: FieldDifference) -> list[Cell | str]:
    nowhere = field.different and field.max_distance is None
    return [
        field.field,
        Cell(f"{field.different:,}", field.different),
        Cell(f"{field.numbers:,}", field.numbers),
        NONE if field.first_step is None else Cell(str(field.first_step), field.first_step),
        _ulps(field.first_ulp, field.signs_from == field.first_step),
        _ulps(field.max_ulp, field.signs_from is not None),
        Cell("not finite", math.inf)
        if nowhere
        else Cell(words.amount(field.max_distance, field.unit), field.max_distance),
    ]


def _ulps(count: int | None, signs_differ: bool) -> Cell | str:
    return NONE if count is None else Cell(ulps(count, signs_differ=signs_differ), count)


def _distances(growth: Growth | Missing) -> Section:
    if isinstance(growth, Missing):
        return Section("distances", "distances", (Text(f"  no distances of bodies: {growth.reason}"),))
    columns = (growth.median_planar, growth.max_planar, growth.median_spatial, growth.max_spatial)
    made = table(
        "distances",
        "",
        ("t [s]", "median, planar", "max, planar", "median, 3D", "max, 3D"),
        [
            [f"{growth.times[row]:g}", *(Cell(length(column[row]), column[row]) for column in columns)]
            for row in _chosen(growth)
        ],
    )
    lines = items(*(f"  {said}" for said in _growth(growth)))
    return Section("distances", "distances", (made, lines), f"bodies of {', '.join(growth.groups)}")


def _chosen(growth: Growth) -> list[int]:
    # from the first distance on, evenly
    begin = next((row for row, d in enumerate(growth.largest) if d), 0)
    last = len(growth.largest) - 1
    count = min(_ROWS, last - begin + 1)
    return sorted({begin + round(i * (last - begin) / max(1, count - 1)) for i in range(count)})


def _growth(growth: Growth) -> list[str]:
    lines = []
    levels = [math.log10(d) if d else None for d in growth.largest]
    known = [level for level in levels if level is not None]
    if len(levels) >= _FEWEST and known:
        low, span = min(known), max(max(known) - min(known), 1e-9)
        bars = words.sparkline([None if v is None else (v - low) / span for v in levels], _WIDTH)
        lines.append(f"largest, log scale: |{bars}| {growth.times[0]:g} to {growth.times[-1]:g} s")
    if growth.fallen and growth.max_not_fallen:
        lines.append(
            f"without {plural(growth.fallen, 'body', 'bodies')} that fell off the board in either recording: up to "
            f"{length(growth.largest[-1])} apart in the end; what follows is of these distances"
        )
    lines += reached(growth)
    fit = growth.fit
    if isinstance(fit, Missing) or fit.why_no_rate:
        lines.append(f"growth rate: none; {fit.reason if isinstance(fit, Missing) else fit.why_no_rate}")
    else:
        doubling = "" if fit.doubling_time is None else f", doubling every {fit.doubling_time * 1000:.3g} ms"
        lines.append(
            f"growth rate: {fit.rate:.3g} /s{doubling}; log-linear fit of the largest through {fit.n_point} steps from "
            f"{fit.begin_s:g} to {fit.end_s:g} s (first difference to 1 mm), R2 {fit.r_squared:.3f}"
        )
    if growth.not_finite_from is not None:
        lines.append(f"positions that are not finite, first at step {growth.not_finite_from}, are left out")
    return lines


def _equal(found: Difference) -> Section | None:
    """Distinct states over the steps, and classes of environments."""
    if found.compared.n_env == 1:
        return None
    splits = found.splits
    by = "state hashes" if splits.by_hashes else "recorded states"
    pairs = [("equal pairs", words.changes(splits.agreeing, _CHANGES))]
    if splits.classes_missing:
        return Section(
            "equal", "equal environments", (facts(*pairs, ("classes", f"none: {splits.classes_missing}")),), f"by {by}"
        )
    pairs.append(("distinct states", words.changes(splits.distinct_both or (), _CHANGES)))
    if not found.one_recording:
        pairs.append(("distinct states of a", words.changes(splits.distinct_a or (), _CHANGES)))
        pairs.append(("distinct states of b", words.changes(splits.distinct_b or (), _CHANGES)))
    made = [_classes(found, "trajectories", splits.classes_a or (), splits.classes_b or ())]
    if (splits.classes_a, splits.classes_b) != (splits.last_a, splits.last_b):
        title = f"states at step {splits.steps.last}"
        made.append(_classes(found, title, splits.last_a or (), splits.last_b or ()))
    return Section("equal", "equal environments", (facts(*pairs, *made),), f"by {by}")


def _classes(found: Difference, title: str, of_a: Labels, of_b: Labels) -> tuple[str, Cell]:
    count, listed = classes_of(found, of_a, of_b, _CLASSES)
    return title, Cell(count, notes=tuple(listed))


def _settings(found: Difference) -> Section | None:
    """What the recordings state about themselves and differ in."""
    if not found.settings:
        return None
    made = table(
        "settings",
        "",
        ("name", "a", "b"),
        [
            [words.name(setting.name), *(cut(value, _VALUE) for value in (setting.a, setting.b))]
            for setting in found.settings
        ],
    )
    return Section("settings", "settings", (made,), f"{len(found.settings):,} that differ")


def arrays_document(found: ArraysDifference, names: tuple[str, str]) -> Document:
    """The verdict and what it rests on.

    names  of the two sides
    """
    who = f"{names[0]} and {names[1]}"
    if found.identical:
        return Document("", (Text(f"{who} are bit-identical.", Tone.GOOD),))
    blocks: list[Block] = []
    if found.first:
        blocks += [Text(f"{who} differ first at {_where(found.first)}.", Tone.BAD), _facts(found.first)]
    elif found.compared:
        blocks.append(Text(f"{who} are not alike, although what could be compared is bit-identical.", Tone.BAD))
    else:
        blocks.append(Text(f"{who} are not alike, and nothing of them can be compared.", Tone.BAD))
    if found.unlike:
        blocks.append(items(*(f"  not compared: {text}" for text in found.unlike), tone=Tone.WARNING))
    return Document("", tuple(blocks))


def _where(first: ArrayDivergence) -> str:
    env = f", in env {first.env}" if first.n_env > 1 else ""
    return f"step {first.step}{env}: {place_of(first.number)}: {apart(first.number)}"


def _facts(first: ArrayDivergence) -> Block:
    step = f"step {first.step}"
    if first.after_step is not None:
        step += f"; equal up to step {first.after_step}"
    if first.n_env > 1:
        step += f"; {first.envs:,} of {plural(first.n_env, 'env', spec=',')} differ at that step, first env {first.env}"
    return facts(
        ("first at", step),
        ("fields", words.names(first.fields, _FIELDS)),
        ("first number", both_of(first.number)),
    )


def dump_json(found: Difference) -> str:
    """The document that ``gsb-diff --json`` prints: the result's own names, the verdict, and whether it is over all."""
    document = {
        "verdict": found.verdict.value,
        "all_compared": not (found.compared.left_out or found.lost),
        "lost": list(found.lost),
        **values_of(found),
    }
    return dump(document_of(document))
