"""Redraws the tables of docs/physics/shipped.md, and of docs/physics/every-step.md from a folder if one is given.

The verdicts that physics-2 changes are listed from all recordings that ship.

usage: python docs/make_physics.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from make_h200 import of_protocol
from page_blocks import redraw

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report.sections.mechanics import allowed, number
from gpusimbench.evaluator.results.fidelity import CheckVerdict, Fidelity, FidelityRow, fidelity
from gpusimbench.evaluator.runs.groups import group
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.physics.facts import Check, Revision
from gpusimbench.evaluator.runs.physics.measure import physics_of

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "docs" / "physics" / "shipped.md"
EVERY_STEP = SHIPPED.with_name("every-step.md")

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


def changed() -> str:
    """A row for each engine, scene and check whose verdict physics-2 changed, over all recordings that ship."""
    recordings = [one for path in sorted((ROOT / "recordings").rglob("*.mcap")) if (one := Recording(path)).usable]
    groups, became = Counter[tuple[str, str, str]](), dict[tuple[str, str, str, str, str], list[FidelityRow]]()
    for runs in group(recordings):
        both = [fidelity("", [physics_of(run, revision=of) for run in runs.complete]) for of in Revision]
        for before, after in zip(both[0].rows, both[1].rows, strict=True):
            where = (runs.key.simulator, runs.key.scene, before.check.title)
            groups[where] += before.verdict is not CheckVerdict.NOT_APPLICABLE
            if before.verdict is not after.verdict:
                became.setdefault((*where, before.verdict.value, after.verdict.value), []).append(after)
    lines = [
        "| simulator | scene | check | physics-1 | physics-2 | groups | largest [m] | physics-2 allows [m] |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (simulator, scene, title, old, new), rows in sorted(became.items()):
        found = [row.found for row in rows if row.found is not None]
        counted = f"{len(rows)} of {groups[simulator, scene, title]}"
        most = number(max((one.most for one in found if one.most is not None), default=None))
        tolerance = number(max((one.tolerance for one in found), default=None))
        lines.append(f"| {simulator} | {scene} | {title} | {old} | {new} | {counted} | {most} | {tolerance} |")
    return "\n".join(lines)


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
    """A row for each group: what a few states tell."""
    titles = [f"{check.title}{f' [{check.unit}]' if check.unit else ''}" for check in _AT_THE_END]
    lines = [f"| simulator | runs | {' | '.join(titles)} |", f"| --- | --- {'| --- ' * len(titles)}|"]
    for one, _ in found:
        rows = {row.check: row for row in one.rows}
        cells = [cell(rows.get(check)) for check in _AT_THE_END]
        lines.append(f"| {one.label} | {one.n_run} | {' | '.join(cells)} |")
    return "\n".join(lines)


def every_step(found: Sequence[tuple[Fidelity, float]], scene: str) -> str:
    """A row for each check, a column for each group of a scene."""
    chosen = [(one, dt) for one, dt in found if one.scene == scene]
    heads = [f"{one.label}, {1000 * dt:g} ms" for one, dt in chosen]
    lines = [f"| check | allowed | {' | '.join(heads)} |", f"| --- | --- {'| --- ' * len(heads)}|"]
    for check in Check:
        rows = [next((row for row in one.rows if row.check is check), None) for one, _ in chosen]
        told = [row.found for row in rows if row is not None and row.found is not None]
        if told:
            unit = f" [{check.unit}]" if check.unit else ""
            lines.append(f"| {check.title}{unit} | {allowed(told[0])} | {' | '.join(map(cell, rows))} |")
    return "\n".join(lines)


def main() -> None:
    """Write the pages."""
    redraw(SHIPPED, {"shipped": at_the_end(shipped()), "changed by physics-2": changed()})
    print(SHIPPED)
    if len(sys.argv) > 1:
        found = judged(sorted(Path(sys.argv[1]).rglob("*.mcap")))
        scenes = ("inclined-collision", "free-fall")
        redraw(EVERY_STEP, {f"every step of {scene}": every_step(found, scene) for scene in scenes})
        print(EVERY_STEP)


if __name__ == "__main__":
    main()
