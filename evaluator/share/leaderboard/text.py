"""A leaderboard in a terminal: who leads where."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.share.leaderboard.board import Board


def leaderboard_lines(board: Board) -> Iterator[str]:
    """The first of each section, and how many stand behind."""
    for section in board.sections:
        where = f"{section.scene} on {section.device or 'a device that was never told'}, dt {section.dt:g} s"
        if section.timed:
            where += f", {section.timed}"
        if section.ranked:
            first = section.ranked[0]
            yield (
                f"{where}: 1. {first.name} {first.key.version} with {first.key.n_env:,} envs, "
                f"{numbers.mean_sd(first.fps)} env-steps/s ({'; '.join(timed.beside(first.result.timed))}); "
                f"{len(section.ranked)} ranked, {len(section.unranked)} not"
            )
        else:
            yield f"{where}: none ranked, {len(section.unranked)} not"
