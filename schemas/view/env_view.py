"""One environment in a view: what its things look like, and where they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from gpusimbench.schemas.configuration import EPOCH_NS
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.view import foxglove
from gpusimbench.schemas.view.kinematics import ROBOT, Vector
from gpusimbench.schemas.view.motion import Frame, Motion
from gpusimbench.schemas.view.shapes import IDENTITY, Solid

ROOT = "world"

_FIXED: tuple[foxglove.Colour, ...] = ((0.55, 0.55, 0.58),)
_BODY: tuple[foxglove.Colour, ...] = ((0.84, 0.65, 0.38), (0.70, 0.50, 0.27))  # neighbours differ
_LINK: tuple[foxglove.Colour, ...] = ((0.92, 0.92, 0.92), (0.75, 0.77, 0.80))


class EnvView:
    """An environment, drawn in a frame of its own.

    number  of the environment
    place   where it stands in the root frame [m]
    motion  of what moves in it
    solids  that are drawn
    """

    def __init__(self, number: int, place: Vector, motion: Motion, solids: Sequence[Solid]) -> None:
        self.number = number
        self.place = place
        self.motion = motion
        self.solids = tuple(solids)
        # links have no poses of their own, since they are relative to each other
        self.groups = tuple(dict.fromkeys(part.group for part in motion.parts if part.group != ROBOT))
        frames = [f"{self.name}/{name}" for name in _distinct(part.name for part in motion.parts)]
        self._frames = {(p.group, p.name): frame for p, frame in zip(motion.parts, frames, strict=True)}
        self._by_name = {p.name: frame for p, frame in zip(motion.parts, frames, strict=True)}
        parents = [self.name if part.parent is None else frames[part.parent] for part in motion.parts]
        self._names = list(zip(parents, frames, strict=True))

    @property
    def name(self) -> str:
        """Of its frame, and the begin of others."""
        return f"env{self.number}"

    def entities(self) -> list[Any]:
        """What things look like, as SceneEntity; who moves takes its shapes along."""
        made = []
        names = _distinct(solid.name for solid in self.solids)  # of two entities of one name, viewers draw the second
        for index, (solid, name) in enumerate(zip(self.solids, names, strict=True)):
            frame = self._frame_of(solid)
            if not solid.shapes or frame is None:
                continue
            tones = _FIXED if not solid.group else _LINK if solid.group == ROBOT else _BODY
            colour = tones[index % len(tones)]
            made.append(foxglove.entity(EPOCH_NS, frame, f"{self.name}/{name}", solid.shapes, colour))
        return made

    def _frame_of(self, solid: Solid) -> str | None:
        # a program that logs its states may call a group otherwise than its scene does
        if not solid.group:
            return self.name
        return self._frames.get((solid.group, solid.name), self._by_name.get(solid.name))

    def transforms(self, frames: Sequence[Frame], row: int, time_ns: int) -> list[Any]:
        """Where its frame and those of everything that moves in it are at a time [ns], as FrameTransform."""
        return [
            foxglove.transform(time_ns, ROOT, self.name, self.place, IDENTITY),
            *(
                foxglove.transform(time_ns, *names, frame.position[row].tolist(), frame.orientation[row].tolist())
                for names, frame in zip(self._names, frames, strict=True)
            ),
        ]

    def poses(self, frames: Sequence[Frame], row: int, time_ns: int) -> dict[str, Any]:
        """Poses of the bodies of each group in the environment's frame, as PosesInFrame."""
        return {
            group: foxglove.poses(
                time_ns,
                self.name,
                (
                    foxglove.pose(frame.position[row].tolist(), frame.orientation[row].tolist())
                    for frame in frames
                    if frame.part.group == group
                ),
            )
            for group in self.groups
        }


def _distinct(names: Iterable[str]) -> Iterator[str]:
    """Names for viewers, none empty and none twice: who would have another's gets a number."""
    taken = set()
    for number, name in enumerate(names):
        shown = printable(name)
        while not shown or shown in taken:
            shown += f"#{number}"
        taken.add(shown)
        yield shown
