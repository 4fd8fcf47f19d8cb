"""Whether laws that say that masses do not matter measure the same when all masses are others.

The engine is given masses that differ from what the recording declares, all by the same share, up and down by turns.
Both recordings of a repetition begin in the same initial states, so that what the masses change is seen without the
scatter between environments. Of every law with a slope of 0 for the mass, this prints

    moved   the largest change of what is measured of an environment, over the tolerance of the law
    broken  recordings that break the law, with the other masses and without

    python -m benchmarks.law_masses [--share S] [--repetitions N] [--seed FIRST] [--out FILE]
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.arguments import end_table, of_counts
from benchmarks.law_changes import EVERY_MASS, Change
from benchmarks.law_power import N_ENV, Setting, engine, judged, measured, share

SCENES = {"pendulum": 0.01, "sliding-block": 0.01, "ball-drop": 0.01, "free-body": 0.02, "double-pendulum": 0.01}
"""Steps [s], as those of the other counts."""

HEAD = (
    "| step | scene, law | moved, of the tolerance | broken | without a change |\n| ---: | --- | ---: | ---: | ---: |"
)


@dataclass
class Counts:
    """Of one law, a repetition after the other."""

    title: str
    moved: list[float] = field(default_factory=list)
    broken: list[bool] = field(default_factory=list)
    broken_unchanged: list[bool] = field(default_factory=list)


def trials(setting: Setting, repetitions: int, by: float) -> dict[str, Counts]:
    """Counts by law, of masses that are changed by this share."""
    found: dict[str, Counts] = {}
    for repetition in range(repetitions):
        seed, sign = setting.seed + repetition, 1.0 if repetition % 2 else -1.0
        before = measured(setting, (), seed)
        after = measured(setting, (Change(EVERY_MASS, "", sign * by),), seed)
        verdicts = [judged(values, setting.scene) for values in (before, after)]
        for one, other in zip(before, after, strict=True):
            if dict(one.slopes).get("mass") != 0.0 or verdicts[0][one.key].held is None:
                continue
            counts = found.setdefault(one.key, Counts(one.title))
            off = np.abs(np.subtract(one.measured, other.measured))
            counts.moved.append(float(off[np.isfinite(off)].max(initial=0.0)) / one.tolerance)
            counts.broken_unchanged.append(not verdicts[0][one.key].held)
            counts.broken.append(not verdicts[1][one.key].held)
    return found


def rows(setting: Setting, repetitions: int, by: float) -> Iterator[str]:
    """Of a Markdown table."""
    for counts in trials(setting, repetitions, by).values():
        yield (
            f"| {1000 * setting.dt:g} ms | {setting.scene}: {counts.title} | {max(counts.moved):.1e} | "
            f"{share(counts.broken)} | {share(counts.broken_unchanged)} |"
        )


def main() -> None:
    """Print the table."""
    parser = of_counts(__doc__)
    parser.add_argument("--share", type=float, default=0.2, help="by which masses are changed")
    given = parser.parse_args()
    lines = [HEAD]
    print(HEAD)
    with tempfile.TemporaryDirectory() as folder:
        settings = [Setting("mujoco", scene, dt, Path(folder), seed=given.seed) for scene, dt in SCENES.items()]
        for setting in settings:
            for row in rows(setting, given.repetitions, given.share):
                print(row, flush=True)
                lines.append(row)
        made = engine(settings[0])
    said = f"{made}, {N_ENV} environments, {given.repetitions} repetitions, masses {100 * given.share:g} % up or down."
    end_table(lines, said, given.out)


if __name__ == "__main__":
    main()
