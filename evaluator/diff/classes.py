"""Classes of equal environments, in words."""

from __future__ import annotations

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.result import Difference

Labels = tuple[int, ...]


def classes_of(found: Difference, of_a: Labels, of_b: Labels, most: int) -> tuple[str, list[str]]:
    """How many classes there are, and the members of the largest; no members where each environment is its own class.

    of_a, of_b  class of each environment of either side
    most        how many classes are listed
    """
    members: dict[int, tuple[list[int], list[int]]] = {}
    for side, envs, labels in ((0, found.a.envs, of_a), (1, found.b.envs, of_b)):
        for env, label in zip(envs, labels, strict=True):
            members.setdefault(label, ([], []))[side].append(env)
    count = f"{len(members):,} {'class' if len(members) == 1 else 'classes'}"
    if len(members) == len(of_a) + len(of_b):
        return count, []
    largest = sorted(members.values(), key=lambda envs: -len(envs[0]) - len(envs[1]))
    listed = [_members(a, b, found.one_recording) for a, b in largest[:most]]
    if len(largest) > most:
        listed.append(f"and {len(largest) - most:,} more, which --json lists")
    return count, listed


def _members(a: list[int], b: list[int], one_recording: bool) -> str:
    if one_recording:
        return f"env{'s' if len(a) + len(b) > 1 else ''} {words.ranges(sorted(a + b))}"
    sides = (f"{name} {words.ranges(envs)}" for name, envs in (("a", a), ("b", b)) if envs)
    return "; ".join(sides)
