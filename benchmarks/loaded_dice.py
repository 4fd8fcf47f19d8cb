"""Whether the chi-squared law of the scene dice-drop notices a loaded die as often as it says.

MuJoCo C drops dice whose centre of mass lies off their centre, toward the face +z, by a share of half the edge. The law
says by how much the probability of a face has to be off, whatever the others are, for a single recording to break it in
95 of 100 cases. Of each share, half of the recordings tell the probabilities of the faces, and the power that Pearson's
test has with them; the other half, which are independent, tell how many recordings break the law.

    python -m benchmarks.loaded_dice [--shares S,S...] [--n-env N] [--repetitions N] [--seed FIRST] [--out FILE]
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import stats

from benchmarks.arguments import end_table, of_counts
from benchmarks.law_changes import Change
from benchmarks.law_power import Setting, engine, judged, record
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.canonical import Law
from gpusimbench.evaluator.runs.physics.canonical.dice import counted
from gpusimbench.recorder.scenes.dice_drop import EDGE

Array = npt.NDArray[np.float64]

HEAD = (
    "| centre of mass, share of half the edge | face +z | face -z | other faces | off, of the claimed size "
    "| power by these probabilities | broken |\n| ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
)


@dataclass(frozen=True)
class Throws:
    """One recording: how often each face came to lie on top, and the law."""

    counts: tuple[int, ...]
    law: Law


def throw(setting: Setting, share: float, seed: int) -> Throws:
    """Records dice whose centre of mass is moved by a share of half their edge, and asks the law."""
    made = record(setting, [Change("centre of mass", "", share * EDGE / 2.0)], seed, counted)
    if isinstance(made, Missing):
        raise TypeError(made.reason)
    return Throws(made[0].counts, judged(made, setting.scene)["faces"])


def power(probabilities: Array, throws: int, critical: float) -> float:
    """Of Pearson's test of equal probabilities: noncentrality n sum (p - 1/k)^2 k (Cohen, Statistical Power Analysis,
    chapter 7).

    probabilities  of the classes, shape [class]
    critical       statistic beyond which the law is broken
    """
    classes = len(probabilities)
    noncentrality = throws * classes * float(((probabilities - 1.0 / classes) ** 2).sum())
    return float(stats.ncx2.sf(critical, classes - 1, noncentrality))


def row(setting: Setting, share: float, repetitions: int) -> str:
    """A row of the table; recordings of all shares have the same seeds, and those of one share different ones."""
    told = [throw(setting, share, setting.seed + one) for one in range(repetitions)]
    asked = [throw(setting, share, setting.seed + repetitions + one) for one in range(repetitions)]
    faces = np.sum([one.counts for one in told], axis=0)
    probabilities = faces / faces.sum()
    law = asked[0].law
    claimed = next(one.breaks for one in law.sensitivities)
    throws = int(np.mean([sum(one.counts) for one in asked]))
    off = float(np.abs(6.0 * probabilities - 1.0).max())
    expected = power(probabilities, throws, law.tolerance + 5.0)
    others = (1.0 - probabilities[2] - probabilities[5]) / 4.0
    broken = sum(not one.law.held for one in asked)
    cells = (
        f"{100 * share:g} %", f"{probabilities[2]:.4f}", f"{probabilities[5]:.4f}", f"{others:.4f}",
        f"{100 * off:.2g} % of {100 * claimed:.2g} %" if claimed else "-", f"{100 * expected:.0f} %",
        f"{broken} of {len(asked)}",
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = of_counts(__doc__, n_env=64)
    parser.add_argument("--shares", default="0,0.02,0.04,0.06", help="by which the centre of mass is moved")
    given = parser.parse_args()
    lines = [HEAD]
    print(HEAD)
    with tempfile.TemporaryDirectory() as folder:
        setting = Setting("mujoco", "dice-drop", 0.01, Path(folder), {}, given.seed, given.n_env)
        for share in map(float, given.shares.split(",")):
            lines.append(row(setting, share, given.repetitions))
            print(lines[-1], flush=True)
        said = f"{engine(setting)}, {12 * given.n_env} dice in a recording, {given.repetitions} repetitions."
    end_table(lines, said, given.out)


if __name__ == "__main__":
    main()
