"""A whole leaderboard."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.evaluator.share.leaderboard.standing import Section
from gpusimbench.schemas.errors import ExitCode


@dataclass(frozen=True)
class Board:
    """What is written.

    title        of the page
    sample_time  at which positions were compared [s]
    sections     by scene and device
    unreadable   names of files that nothing is computed from, and why
    notes        about the recordings as a whole: copies, groups that are the same bit for bit
    recordings   that count, each run once
    """

    title: str
    sample_time: float
    sections: tuple[Section, ...]
    unreadable: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    recordings: int

    @property
    def exit_code(self) -> ExitCode:
        """3 where a file is damaged, 5 where nothing has a place, else 0."""
        if self.unreadable:
            return ExitCode.DATA_LOST
        return ExitCode.OK if any(section.ranked for section in self.sections) else ExitCode.NOTHING_COMPARABLE
