"""Which runs of a group recorded the sample step: the others are left out by name, and hide nothing of these."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.results.aggregate import NO_RUN, Runs


def sampled(runs: Runs) -> Runs:
    """The runs that recorded the sample step; all of them where none did."""
    return tuple(run for run in runs if run.reached) or tuple(runs)


def positions(runs: Runs) -> tuple[NDArray[np.float64] | None, str]:
    """Planar positions of all runs [m], [run, env, item, 2]; or None and the reason."""
    if why_not := no_positions(runs):
        return None, why_not
    return np.stack([r.positions.planar for r in runs if r.positions]), ""


def no_positions(runs: Runs) -> str:
    """Why not all runs have positions at the sample step, with the names of those; empty where all have."""
    if not runs:
        return NO_RUN
    why = next((why for run in runs if (why := why_missing(run.positions))), "")
    alike = [run for run in runs if why_missing(run.positions) == why]
    return why if len(alike) == len(runs) or not why else f"{named(alike)}: {why}"


def left_out(runs: Runs) -> list[str]:
    """A sentence for each reason why runs are not among the sampled ones."""
    used = sampled(runs)
    reached = {id(run) for run in used}
    found: dict[str, list[int]] = {}
    for at, run in enumerate(runs):
        if id(run) not in reached:
            found.setdefault(why_missing(run.positions), []).append(at)
    others = "run" if len(used) == 1 else f"{len(used)} runs"
    return [
        f"{named([runs[at] for at in places])} left out of W1, equality, published type and bodies off the board, "
        f"which are those of the other {others}: {why}"
        for why, places in found.items()
    ]


def ends_early(runs: Runs) -> list[str]:
    """Sentences on runs that captured fewer steps than others: how far their bits are compared."""
    last = [int(run.histories.steps[-1]) if run.histories else None for run in runs]
    latest = max((step for step in last if step is not None), default=None)
    if latest is None:
        return []
    notes = []
    for step in sorted({step for step in last if step is not None and step < latest}):
        short = [run for run, end in zip(runs, last, strict=True) if end == step]
        notes.append(
            f"{named(short)} captured up to step {step} and others up to step {latest}: bits of two runs are compared "
            "at the steps that both captured"
        )
    if without := [run for run, end in zip(runs, last, strict=True) if end is None]:
        notes.append(f"{named(without)} captured no states: no bits to compare")
    return notes


def named(runs: Runs) -> str:
    """Runs by index and file: "run 2 (a.mcap)", "runs 2 (a.mcap), 3 (b.mcap)"."""
    parts = [f"{run.configuration.run_index} ({run.path.name})" for run in runs]
    return f"run{'' if len(parts) == 1 else 's'} {', '.join(parts)}"
