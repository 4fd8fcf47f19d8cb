"""In which order the runs of two sides were made, and which of them are neighbours in time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.exchange import least_p

_UTC = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
_SHOWN = 24


@dataclass(frozen=True)
class Schedule:
    """Runs of both sides in the order in which they were made.

    runs    in order
    head    whether each is of head
    blocks  number of the block of each: the shortest stretches that hold runs of both sides
    known   whether recordings say when they were made, and not all at once: times are in whole seconds
    """

    runs: tuple[Run, ...]
    head: tuple[bool, ...]
    blocks: tuple[int, ...]
    known: bool

    @property
    def n(self) -> tuple[int, int]:
        """Runs of base and of head."""
        return len(self.head) - sum(self.head), sum(self.head)

    @property
    def interleaved(self) -> bool:
        """Whether blocks are short enough for drift to be nearly the same for their runs: four runs on average."""
        return self.known and len(set(self.blocks)) >= max(2, (min(self.n) + 1) // 2)

    @property
    def one_first(self) -> bool:
        """Whether every block began with the same side, so that a steady drift is left in the difference."""
        first = {self.head[self.blocks.index(block)] for block in self.blocks}
        return len(first) == 1

    @property
    def text(self) -> str:
        """The order as letters, A for base and B for head."""
        letters = "".join("B" if head else "A" for head in self.head)
        return letters if len(letters) <= _SHOWN else f"{letters[:_SHOWN]}..."

    def blocks_for(self, level: float) -> tuple[int, ...]:
        """The shortest blocks of neighbours within which a test can reach the level; one block where none can."""
        if not self.interleaved:
            return (0,) * len(self.head)
        blocks = self.blocks
        while max(blocks) and least_p(self.head, blocks) > level:
            blocks = tuple(block // 2 for block in blocks)
        return blocks


def schedule(base: Sequence[Run], head: Sequence[Run]) -> Schedule:
    """The order of some runs; those of one second are in the order of their run ids, which says nothing of the side."""
    tagged = [(run, False) for run in base] + [(run, True) for run in head]
    tagged.sort(key=lambda one: (one[0].provenance.created_utc, one[0].provenance.run_id))
    times = [run.provenance.created_utc for run, _ in tagged]
    n_time = len(set(times))
    known = all(map(_UTC.fullmatch, times)) and n_time > 1 and 2 * n_time >= len(times)
    sides = tuple(side for _, side in tagged)
    return Schedule(tuple(run for run, _ in tagged), sides, neighbours(sides), known)


def neighbours(head: Sequence[bool]) -> tuple[int, ...]:
    """Blocks of a sequence: each ends with the first run by which it holds both sides; what is left joins the last."""
    blocks: list[int] = []
    block, seen = 0, set[bool]()
    for index, side in enumerate(head):
        blocks.append(block)
        seen.add(side)
        if len(seen) == 2 and len(set(head[index + 1 :])) == 2:
            block, seen = block + 1, set()
    return tuple(blocks)
