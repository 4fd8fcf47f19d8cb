"""Places for labels beside points, such that no label covers another, a mark or a line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

LETTER = 6.4
"""Width of a letter of a label at 11 px: more than most, for fonts differ."""

HEIGHT = 12.0

_BESIDE = 9.0  # from a point to a label that needs no line
_FAR = (22.0, 32.0, 44.0, 58.0, 74.0, 92.0, 112.0, 136.0)  # to one that has a line
_ANGLES = 16
_GAP = 2.0  # from the end of a line to its label


@dataclass(frozen=True)
class Box:
    """A rectangle in figure units."""

    left: float
    top: float
    right: float
    bottom: float

    def meets(self, other: Box) -> bool:
        """Whether both have an area in common."""
        return (
            self.left < other.right and other.left < self.right and self.top < other.bottom and other.top < self.bottom
        )

    def within(self, other: Box) -> bool:
        """Whether all of it lies in the other."""
        return (
            self.left >= other.left
            and self.right <= other.right
            and self.top >= other.top
            and self.bottom <= other.bottom
        )


@dataclass(frozen=True)
class Label:
    """Where a label stands.

    box     that its text fills; the text begins at its left edge
    leader  the end of a line from the point to the label; None where it stands beside its point
    """

    box: Box
    leader: tuple[float, float] | None = None


def place(
    points: Sequence[tuple[float, float]],
    texts: Sequence[str],
    *,
    marks: Sequence[Box],
    whiskers: Sequence[Box],
    frame: Box,
) -> list[Label | None]:
    """A place for the label of each point, in their order; None where there is no room, or no text.

    marks     that neither a label nor its line may cover
    whiskers  that no label may cover; its line may cross them
    frame     that every label lies in

    Points with the most others around them choose first. The same points give the same places.
    """
    order = sorted(range(len(points)), key=lambda i: (_room(i, points), i))
    found: list[Label | None] = [None] * len(points)
    solid, leaders = list(marks), list[Box]()
    for i in order:
        if not texts[i]:
            continue
        label = next(_free(points[i], len(texts[i]) * LETTER, solid, [*whiskers, *leaders], frame), None)
        if label:
            found[i] = label
            solid.append(label.box)
            leaders += _along(points[i], label.leader) if label.leader else []
    return found


def _room(i: int, points: Sequence[tuple[float, float]]) -> float:
    """Distance to the other points, the nearest counting most."""
    distances = sorted(math.dist(points[i], other) for j, other in enumerate(points) if j != i)
    return sum(d / 2.0**k for k, d in enumerate(distances))


def _free(
    point: tuple[float, float], width: float, solid: Sequence[Box], thin: Sequence[Box], frame: Box
) -> Iterator[Label]:
    for label in _candidates(point, width):
        if not label.box.within(frame) or any(label.box.meets(other) for other in (*solid, *thin)):
            continue
        if label.leader and any(part.meets(other) for part in _along(point, label.leader) for other in solid):
            continue
        yield label


def _candidates(point: tuple[float, float], width: float) -> Iterator[Label]:
    x, y = point
    near, half = _BESIDE, HEIGHT / 2
    for left, middle in (
        (x + near, y), (x - near - width, y), (x - width / 2, y - near - half), (x - width / 2, y + near + half),
        (x + near - 3, y - near), (x + near - 3, y + near), (x - near + 3 - width, y - near),
        (x - near + 3 - width, y + near),
    ):  # fmt: skip
        yield Label(Box(left, middle - half, left + width, middle + half))
    for far in _FAR:
        for step in range(_ANGLES):
            # from the upper right by turns to both sides
            angle = -math.pi / 4 + math.pi * 2 * (step + 1) // 2 * (-1) ** step / _ANGLES
            end = (x + far * math.cos(angle), y + far * math.sin(angle))
            left = end[0] + _GAP if math.cos(angle) >= 0 else end[0] - _GAP - width
            yield Label(Box(left, end[1] - half, left + width, end[1] + half), end)


def _along(point: tuple[float, float], end: tuple[float, float]) -> list[Box]:
    """Small boxes on a line, from beyond the point's mark to just before the label."""
    length = math.dist(point, end)
    steps = max(1, int((length - _BESIDE) / 3))
    shares = [(_BESIDE + (length - _BESIDE - 1) * i / steps) / length for i in range(steps)]
    at = [(point[0] + (end[0] - point[0]) * s, point[1] + (end[1] - point[1]) * s) for s in shares]
    return [Box(x - 1, y - 1, x + 1, y + 1) for x, y in at]
