"""Which states are the same, as text."""

from __future__ import annotations

from rich.console import Console

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.result import Difference, Splits
from gpusimbench.schemas.text import printable

_CHANGES, _CLASSES = 8, 8


def print_splits(console: Console, found: Difference) -> None:
    """Distinct states over the steps, and classes of environments."""
    splits = found.splits
    by = "state hashes" if splits.by_hashes else "recorded states"
    console.print(printable(f"which are the same, by {by}"), style="bold")
    for line in _lines(found, splits):
        console.print(printable(f"  {line}"))
    console.print()


def _lines(found: Difference, splits: Splits) -> list[str]:
    lines = []
    if found.compared.n_env > 1:
        lines.append(f"pairs that are equal: {words.changes(splits.agreeing, _CHANGES)}")
    if splits.no_classes:
        return [*lines, f"classes: none; {splits.no_classes}"]
    told = [("distinct states", splits.distinct_both)]
    if not found.one_recording:
        told += [("  of a", splits.distinct_a), ("  of b", splits.distinct_b)]
    lines += [f"{title}: {words.changes(counts or (), _CHANGES)}" for title, counts in told]
    lines += _classes(found, "trajectories", splits.classes_a or (), splits.classes_b or ())
    if (splits.classes_a, splits.classes_b) != (splits.last_a, splits.last_b):
        lines += _classes(found, f"states at step {splits.steps.last}", splits.last_a or (), splits.last_b or ())
    return lines


def _classes(found: Difference, title: str, of_a: tuple[int, ...], of_b: tuple[int, ...]) -> list[str]:
    # the largest classes, unless each environment is one of its own
    members: dict[int, tuple[list[int], list[int]]] = {}
    for side, envs, labels in ((0, found.a.envs, of_a), (1, found.b.envs, of_b)):
        for env, label in zip(envs, labels, strict=True):
            members.setdefault(label, ([], []))[side].append(env)
    lines = [f"{title}: {len(members):,} {'class' if len(members) == 1 else 'classes'}"]
    if len(members) == len(of_a) + len(of_b):
        return lines
    largest = sorted(members.values(), key=lambda envs: -len(envs[0]) - len(envs[1]))
    lines += [f"    {_members(a, b, found.one_recording)}" for a, b in largest[:_CLASSES]]
    if len(largest) > _CLASSES:
        lines.append(f"    and {len(largest) - _CLASSES:,} more, which --json lists")
    return lines


def _members(a: list[int], b: list[int], one_recording: bool) -> str:
    if one_recording:
        return f"env{'s' if len(a) + len(b) > 1 else ''} {words.ranges(sorted(a + b))}"
    sides = (f"{name} {words.ranges(envs)}" for name, envs in (("a", a), ("b", b)) if envs)
    return "; ".join(sides)
