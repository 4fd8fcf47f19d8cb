"""A comparison as text in a terminal."""

from __future__ import annotations

from textwrap import wrap
from typing import IO

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.result import Basis, Difference, Divergence, Number, Verdict
from gpusimbench.evaluator.diff.text_growth import print_growth
from gpusimbench.evaluator.diff.text_numbers import print_numbers
from gpusimbench.evaluator.diff.text_splits import print_splits
from gpusimbench.evaluator.render.console import make_console, plain_table
from gpusimbench.schemas.text import printable

_ITEMS, _SETTINGS, _VALUE, _INDENT = 6, 16, 48, 18
_BASIS = {
    Basis.BITS: "in any bit",
    Basis.FLOAT32: "beyond the resolution of float32",
    Basis.LOCAL: "beyond the resolution at their origins",
}


def print_difference(found: Difference, stream: IO[str]) -> None:
    """Print it; what a stranger's recording says is printed as text, never as markup."""
    console = make_console(stream)
    for name, side in (("a", found.a), ("b", found.b)):
        envs = f"env{'s' if len(side.envs) > 1 else ''} {words.ranges(list(side.envs))}"
        _line(console, f"{name}  {side.label}, {envs}: {side.path}")
    console.print(printable(_verdict(found)), style="bold")
    _line(console, f"  over {_over(found)}")
    if found.first:
        _print_first(console, found, found.first)
    console.print()
    if found.first:
        _print_fields(console, found)
        print_growth(console, found)
        if found.compared.n_env > 1:
            print_splits(console, found)
    _print_rest(console, found)


def _line(console: Console, text: str) -> None:
    console.print(printable(text))


def _verdict(found: Difference) -> str:
    part = bool(found.compared.left_out or found.lost)
    if found.verdict is Verdict.IDENTICAL:
        return "EQUAL AS FAR AS COMPARED, bit for bit; not all was compared" if part else "BIT-IDENTICAL"
    if found.verdict is Verdict.WITHIN_RESOLUTION:
        far = " AS FAR AS COMPARED" if part else ""
        return f"EQUAL WITHIN THE RESOLUTION{far}; bits cannot be compared"
    assert found.first is not None
    step = f"step {found.first.step_a} ({found.first.time:g} s){_of_timed(found, found.first)}"
    where = f"from {step} on" if _stays(found, found.first) else f"first at {step}"
    if found.same_up_to_env_order:
        return f"DIFFERENT {where}: equal up to the order of environments"
    if found.same_up_to_body_order:
        of = "environments and bodies" if found.bodies_of_other_envs else "bodies"
        return f"DIFFERENT {where}: equal up to the order of {of}, at all recorded states"
    if found.same_rotations:
        return f"DIFFERENT {where}: the same rotations, of the other sign"
    return f"DIFFERENT {where}"


def _stays(found: Difference, first: Divergence) -> bool:
    """Whether no pair is known to become equal again, so that the sides differ at every known step from here on."""
    if _of_timed(found, first):
        return False  # it is not known pair by pair
    agreeing = found.splits.agreeing
    then = [change.count for change in agreeing if change.step <= first.step_a][-1:]
    later = [change.count for change in agreeing if change.step > first.step_a]
    counts = [*then, *later]
    return bool(then) and then[0] < found.compared.n_env and counts == sorted(counts, reverse=True)


def _of_timed(found: Difference, first: Divergence) -> str:
    # where there is a capture beside it, which is the same
    return " of the timed phase" if first.phase == "timed" and found.compared.hash_phase != "timed" else ""


def _over(found: Difference) -> str:
    compared = found.compared
    parts = [words.counted(len(compared.fields), "field"), words.counted(compared.n_env, "pair") + " of envs"]
    for steps, what in ((compared.state_steps, "recorded state"), (compared.hash_steps, "step")):
        if steps:
            hashes = " by 64-bit hashes" if what == "step" else ""
            parts.append(f"{words.counted(steps.count, what)} from step {steps.first} to {steps.last}{hashes}")
    if compared.timed_steps:
        parts.append(f"{words.counted(compared.timed_steps.count, 'step')} of the timed phase by 64-bit hashes")
    return ", ".join(parts)


def _print_first(console: Console, found: Difference, first: Divergence) -> None:
    rows = []
    step = f"{first.step_a}" if first.step_a == first.step_b else f"{first.step_a} of a, {first.step_b} of b"
    known = "" if first.after_step is None else f"; equal up to step {first.after_step}"
    between = first.after_step is not None and first.after_step < first.step_a - 1
    rows.append(("first at step", f"{step} ({first.time:g} s){known}{', no step between is known' if between else ''}"))
    if found.compared.n_env > 1:
        pairs = f"{first.envs:,} of {found.compared.n_env:,} pairs"
        rows.append(("envs", f"{pairs}; the first is {_pair(found, first)}"))
    rows += _where(found, first)
    if first.contacts_a or first.contacts_b:
        told = [
            f"{name} {c.mean:.4g} an env, {c.max:g} at most" if c else f"{name} not counted"
            for name, c in (("a", first.contacts_a), ("b", first.contacts_b))
        ]
        rows.append(("contacts then", told[0].removeprefix("a ") if found.one_recording else "; ".join(told)))
    for title, text in rows:
        lines = wrap(printable(text), max(20, console.width - _INDENT), break_on_hyphens=False)
        for number, line in enumerate(lines):
            console.print(f"{'' if number else f'  {title}':<{_INDENT}}{line}")


def _where(found: Difference, first: Divergence) -> list[tuple[str, str]]:
    state = first.state
    if first.phase == "timed":
        return [("field and body", "not known: of the timed phase hashes are kept, and no states")]
    if state is None and found.compared.state_steps is None:
        return [("field and body", "not known: the recordings have no states of a common step, only hashes")]
    if state is None:
        return [("field and body", "not known: all recorded states are equal again")]
    rows = []
    if state.step != first.step_a:
        rows.append(
            ("field and body", f"not known: no state of step {first.step_a} was recorded; --stride 1 records it. By "
             f"step {state.step} ({state.time:g} s) there differ")
        )  # fmt: skip
    every = len(state.fields) == len(found.compared.fields) > 1
    fields = f"all {len(state.fields)}" if every else words.shortened(state.fields, 8)
    items = words.shortened(state.items, _ITEMS)
    return [*rows, ("fields", fields), ("items", items), ("first number", _number(state.number))]


def _pair(found: Difference, first: Divergence) -> str:
    if found.one_recording or first.env_a != first.env_b:
        return f"env {first.env_a} against env {first.env_b}"
    return f"env {first.env_a}"


def _number(number: Number) -> str:
    where = f"{number.field} of {words.short(number.item)}, {words.short(number.component)}"
    unit = "" if number.unit == "unit quaternion" else f" {number.unit}"
    apart = [
        f"{words.ulps(number.ulp)} ULP" if number.ulp is not None else "",
        "same rotation, other sign" if number.other_sign else "",
        f"{words.amount(number.distance, number.unit)} apart" if number.distance is not None else "",
        f"resolution {words.amount(number.resolution, number.unit)}" if number.resolution is not None else "",
    ]
    how = ", ".join(part for part in apart if part)
    return f"{where}: {number.a} and {number.b}{unit} ({number.hex_a}, {number.hex_b}): {how}"


def _print_fields(console: Console, found: Difference) -> None:
    differing = [f for f in found.compared.fields if f.different]
    if not differing:
        return
    by = " or ".join(dict.fromkeys(_BASIS[f.basis] for f in found.compared.fields))
    console.print(printable(f"recorded states at all common steps; numbers that differ {by}"), style="bold")
    titles = ("", "differ", "of", "from step", "ULP then", "max ULP", "max |a - b|")
    rows = []
    for field in found.compared.fields:
        first = words.NONE if field.first_step is None else str(field.first_step)
        ulps = (words.ulps(field.first_ulp), words.ulps(field.max_ulp))
        cells = (f"{field.different:,}", f"{field.numbers:,}", first, *ulps)
        nowhere = field.different and field.max_distance is None
        distance = "not finite" if nowhere else words.amount(field.max_distance, field.unit)
        rows.append((field.field, *cells, distance))
    print_numbers(console, titles, rows)
    for field in differing:
        for count, what in (
            (field.signed_zeros, "0.0 against -0.0"),
            (field.nan_payloads, "NaN of another payload"),
            (field.other_sign, "of quaternions of the same rotation, other sign"),
            (field.not_finite, "not finite on a side, and in no distance"),
        ):
            if count:
                _line(console, f"  {field.field}: {count:,} of them are {what}")
    console.print()


def _print_rest(console: Console, found: Difference) -> None:
    lines = [f"not compared: {text}" for text in found.compared.left_out]
    lines += [f"incomplete: {text}" for text in found.lost]
    lines += [f"note: {text}" for text in found.notes]
    if found.copies:
        lines.append("note: both are recordings of one run; that they agree says nothing of another run")
    if found.compared.hash_steps is None:
        lines.append(f"note: state hashes were not used, so only recorded states are known: {found.compared.no_hashes}")
    for text in lines:
        _line(console, text)
    if lines:
        console.print()
    if not found.settings:
        if not found.one_recording:
            same = "configuration, versions, options, machine" if found.described else "configuration, machine"
            console.print(f"the recordings say the same of themselves: {same}")
            if not found.described:
                console.print("versions and options in force are not compared: neither recording tells them")
        return
    console.print("what the recordings say of themselves and differ in", style="bold")
    table = plain_table("", "a", "b")
    for setting in found.settings[:_SETTINGS]:
        values = (words.short(value, _VALUE) for value in (setting.a, setting.b))
        table.add_row(Text(printable(words.short(setting.name))), *(Text(printable(value)) for value in values))
    console.print(table)
    more = len(found.settings) - _SETTINGS
    if more > 0:
        console.print(f"  and {more} more, which --json lists", style="dim")
    console.print()
