"""Redraws the table of docs/physics/checks.md; those of every state from a folder if one is given.

usage: python docs/make_physics.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from make_h200 import of_protocol
from page_blocks import redraw

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report.sections.mechanics import allowed, number
from gpusimbench.evaluator.results.fidelity import Fidelity, FidelityRow, fidelity
from gpusimbench.evaluator.runs.groups import group
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.physics.facts import Check
from gpusimbench.evaluator.runs.physics.measure import physics_of

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "physics" / "checks.md"


_AT_THE_END = (
    Check.ENERGY_START,
    Check.DEPTH_REST,
    Check.DEPTH_EVER,
    Check.PAIR_REST,
    Check.SANK,
    Check.END_SPEED,
    Check.END_SPIN,
)


def judged(paths: Iterable[Path]) -> list[tuple[Fidelity, float]]:
    """The groups of some recordings that mechanics can say anything of, with the step of each [s]."""
    recordings = [recording for path in paths if (recording := Recording(path)).usable]
    groups = group(recordings)
    names = labels([one.key for one in groups], options_given(recordings))
    found = [
        (fidelity(label, [physics_of(recording) for recording in one.complete]), one.key.dt)
        for one, label in zip(groups, names, strict=True)
    ]
    return [(one, dt) for one, dt in found if not one.checks_missing]


def shipped() -> list[tuple[Fidelity, float]]:
    """Those of the recordings that ship."""
    folder = ROOT / "recordings"
    protocol = of_protocol(folder / "protocol-h200")
    return judged([*sorted(folder.glob("*.mcap")), *sorted((folder / "h200").glob("*.mcap")), *protocol])


def cell(row: FidelityRow | None) -> str:
    """The worst of what was measured, bold where mechanics broke, in italics where a scene was not at rest."""
    if row is None or row.found is None:
        return NONE
    found = row.found
    middle = found.low is not None and found.low == found.high and row.check is not Check.SANK
    shown = number(found.mean if middle else found.most)
    if not found.broken:
        return shown
    mark = "**" if row.check.demanded else "*"
    told = f"{mark}{shown}{mark}"
    return f"{told} ({found.broken} of {found.count})" if found.broken < found.count else told


def at_the_end(found: Sequence[tuple[Fidelity, float]]) -> str:
    """A row for each group that breaks a check or is not at rest: what a few states tell."""
    titles = [f"{check.title}{f' [{check.unit}]' if check.unit else ''}" for check in _AT_THE_END]
    lines = [f"| simulator | runs | {' | '.join(titles)} |", f"| --- | --- {'| --- ' * len(titles)}|"]
    for one, _ in found:
        rows = {row.check: row for row in one.rows}
        cells = [cell(rows.get(check)) for check in _AT_THE_END]
        if any("*" in shown for shown in cells):
            lines.append(f"| {one.label} | {one.n_run} | {' | '.join(cells)} |")
    return "\n".join(lines)


def every_step(found: Sequence[tuple[Fidelity, float]], scene: str) -> str:
    """A row for each check that a group of a scene breaks, a column for each group."""
    chosen = [(one, dt) for one, dt in found if one.scene == scene]
    heads = [f"{one.label}, {1000 * dt:g} ms" for one, dt in chosen]
    lines = [f"| check | allowed | {' | '.join(heads)} |", f"| --- | --- {'| --- ' * len(heads)}|"]
    for check in Check:
        rows = [next((row for row in one.rows if row.check is check), None) for one, _ in chosen]
        told = [row.found for row in rows if row is not None and row.found is not None]
        if check.demanded and any(one.broken for one in told):
            unit = f" [{check.unit}]" if check.unit else ""
            lines.append(f"| {check.title}{unit} | {allowed(told[0])} | {' | '.join(map(cell, rows))} |")
    return "\n".join(lines)


def main() -> None:
    """Write the pages."""
    redraw(PAGE, {"shipped": at_the_end(shipped())})
    if len(sys.argv) > 1:
        found = judged(sorted(Path(sys.argv[1]).rglob("*.mcap")))
        scenes = ("inclined-collision", "free-fall")
        redraw(PAGE, {f"every step of {scene}": every_step(found, scene) for scene in scenes})
    print(PAGE)


if __name__ == "__main__":
    main()
