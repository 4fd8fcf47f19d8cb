"""Records, judges and draws what docs/preregistration.md announces.

usage: python docs/make_preregistration.py power             the table of power, from the synthetic tosses that ship
       python docs/make_preregistration.py record FOLDER     record what FOLDER does not have; $GSB_CUBE_TOSS: tosses
       python docs/make_preregistration.py result FOLDER     judge FOLDER by the rules of the page, into the page

Whoever has the measured tosses can run it. Recordings hold measured states, and are no part of this project.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from statistics import NormalDist

import numpy as np
from page_blocks import redraw

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import (
    TOSS_END_POSITION,
    TOSS_FACE,
    TOSS_POSITION,
    TOSS_ROTATION,
    errors_by_toss,
)
from gpusimbench.evaluator.statistics.cases import Paired, paired
from gpusimbench.evaluator.statistics.families import holm

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "preregistration.md"
SAMPLE_TIME = 441 / 148

LEAST = 0.1
"""Smallest difference of interest, of the error of position [cm]."""

LEVEL = 0.05
"""Of the family, by Holm's method."""

TOSSES = 570
ENGINES = ("mujoco", "warp", "mjx")
SETTINGS = (("integrator", "Euler"), ("integrator", "RK4"), ("solver", "CG"))
"""Each compared with the default of the same engine: implicitfast, and Newton."""

SECONDARY = (TOSS_ROTATION, TOSS_END_POSITION, TOSS_FACE)
_HASH = 12


@dataclass(frozen=True)
class Contrast:
    """An engine with one option changed against the same engine without, toss by toss; errors in cm."""

    simulator: str
    option: str
    value: str
    usual: GroupResult
    changed: GroupResult
    found: Paired
    error: float  # standard error of the mean difference
    p_value: float  # adjusted by Holm's method

    @property
    def interval(self) -> tuple[float, float]:
        """Simultaneous 95 % interval of the difference: normal, by Bonferroni's method for the whole family."""
        half = z(1 - LEVEL / len(family()) / 2) * self.error
        return self.found.mean - half, self.found.mean + half

    @property
    def verdict(self) -> str:
        """By the rules of the page."""
        low, high = self.interval
        differs, close = self.p_value < LEVEL, low > -LEAST and high < LEAST
        if differs:
            more = "larger" if self.found.mean > 0 else "smaller"
            return f"{more}, by less than matters" if close else f"**{more}**"
        return "equivalent" if close else "undecided"


def family() -> list[tuple[str, str, str]]:
    """Simulator, option and value of each contrast."""
    return [(simulator, *setting) for simulator in ENGINES for setting in SETTINGS]


def z(share: float) -> float:
    """Quantile of the normal distribution."""
    return NormalDist().inv_cdf(share)


def power(spread: float, cases: int = TOSSES) -> tuple[float, float]:
    """Chance that a difference of LEAST is shown at the strictest level of Holm's method, and that no difference at
    all is called equivalent; both of a normal mean.

    spread  standard deviation of the differences of a toss [cm]
    """
    if spread == 0.0:
        return 1.0, 1.0
    scaled, quantile = LEAST / (spread / cases**0.5), z(1 - LEVEL / len(family()) / 2)
    differs = NormalDist().cdf(scaled - quantile) + NormalDist().cdf(-scaled - quantile)
    return differs, max(0.0, 2 * NormalDist().cdf(scaled - quantile) - 1)


def power_table(evaluation: Evaluation) -> str:
    """Power by the spread of differences between every two groups of a set."""
    judged = [r for r in evaluation.results if known(r.metrics[TOSS_POSITION.name].value) is not None]
    lines = [
        "| pair, on the synthetic tosses | SD of the difference [cm] | shows 0.1 cm | calls 0 equivalent |",
        "| --- | --- | --- | --- |",
    ]
    spreads = []
    for one, other in combinations(judged, 2):
        first, second = errors_by_toss(one), errors_by_toss(other)
        both = sorted(first.keys() & second.keys())
        difference = np.array([first[toss] - second[toss] for toss in both])
        spreads.append((float(difference.std(ddof=1)), one.label, other.label))
    for spread, one_name, other_name in sorted(spreads):
        shows, calls = power(spread)
        lines.append(f"| {one_name} and {other_name} | {spread:.3g} | {shows:.1%} | {calls:.1%} |")
    enough = LEAST * TOSSES**0.5 / (z(1 - LEVEL / len(family()) / 2) + z(0.95))
    return "\n".join([*lines, "", f"A power of 95 % for 0.1 cm needs a spread of at most {enough:.2f} cm."])


def contrasts(results: Iterable[GroupResult]) -> tuple[list[Contrast], list[str]]:
    """What could be judged, and why the rest could not."""
    by_options: dict[tuple[str, frozenset[tuple[str, str]]], GroupResult] = {}
    for result in results:
        configuration = result.group.recordings[0].configuration
        by_options[configuration.simulator, frozenset((k, f"{v}") for k, v in configuration.options.items())] = result
    made, missing = [], []
    for simulator, option, value in family():
        usual = _of(by_options, simulator, {})
        changed = _of(by_options, simulator, {option: value})
        for name, group in (("default", usual), (f"{option}={value}", changed)):
            if group is None:
                missing.append(f"{simulator} {option}={value}: no recording of {name} has errors")
        if usual is None or changed is None:
            continue
        first, second = errors_by_toss(changed), errors_by_toss(usual)
        both = sorted(first.keys() & second.keys())
        a, b = np.array([first[t] for t in both]), np.array([second[t] for t in both])
        error = float((a - b).std(ddof=1)) / len(both) ** 0.5
        made.append(Contrast(simulator, option, value, usual, changed, paired(a, b), error, 1.0))
    # what is missing keeps its place in the family, with p = 1
    adjusted = holm([one.found.p_value for one in made] + [1.0] * (len(family()) - len(made)))
    return [
        Contrast(c.simulator, c.option, c.value, c.usual, c.changed, c.found, c.error, p)
        for c, p in zip(made, adjusted, strict=False)
    ], list(dict.fromkeys(missing))


def _of(
    by_options: dict[tuple[str, frozenset[tuple[str, str]]], GroupResult], simulator: str, asked: dict[str, str]
) -> GroupResult | None:
    for (name, options), result in by_options.items():
        given = {k: v for k, v in dict(options).items() if k in ("integrator", "solver")}
        if name == simulator and given == asked and known(result.metrics[TOSS_POSITION.name].value) is not None:
            return result
    return None


def result_table(evaluation: Evaluation) -> str:
    """The result, as the page announces it."""
    made, missing = contrasts(evaluation.results)
    if evaluation.reference is None or evaluation.reference.tosses is None:
        raise SystemExit(f"there is no recording of tosses: {evaluation.reference_note}")
    titles = [
        "engine", "changed", "error of position, default / changed [cm]", "difference [cm], simultaneous 95 %",
        "p, Holm", "verdict", *(f"{m.title}, default / changed [{m.unit}]" for m in SECONDARY), "recordings",
    ]  # fmt: skip
    lines = [f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}"]
    for one in made:
        sides = (one.usual, one.changed)
        low, high = one.interval
        cells = [
            f"{one.simulator} {one.usual.group.key.version}", f"{one.option}={one.value}",
            _pair(sides, TOSS_POSITION.name, 3),
            f"{one.found.mean:+.4f} [{low:+.4f}, {high:+.4f}]", f"{one.p_value:.2g}", one.verdict,
            *(_pair(sides, m.name, 2) for m in SECONDARY),
            " ".join(f"`{side.group.recordings[0].content_hash[:_HASH]}`" for side in sides),
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    tosses = evaluation.reference.tosses
    count = made[0].found.cases if made else 0
    below = [f"{tosses.name()}, SHA-256 `{tosses.known.sha256[:_HASH]}...`; {count} judged."]
    below += [f"Not judged: {why}." for why in missing]
    return "\n".join([*lines, "", *below])


def _pair(sides: Iterable[GroupResult], name: str, digits: int) -> str:
    return " / ".join(f"{known(side.metrics[name].value) or 0.0:.{digits}f}" for side in sides)


def record(folder: Path) -> None:
    """Record the reference and both sides of every contrast, one run each, unless they are there already."""
    wanted: list[tuple[str, tuple[str, ...]]] = [("real", ()), *((name, ()) for name in ENGINES)]
    wanted += [(name, ("--option", f"{option}={value}")) for name, option, value in family()]
    for simulator, options in wanted:
        target = folder / "-".join([simulator, *options[1:]]).replace("=", "-")
        if list(target.glob("*.mcap")):
            continue
        command = [sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", simulator, "--scene", "cube-toss"]
        if simulator != "real":
            command += ["--runs", "1", "--phases", "capture", *options]
        done = subprocess.run([*command, "--out", str(target)], check=False)
        print(f"{simulator} {' '.join(options)}: exit code {done.returncode}", flush=True)


def main() -> None:
    """Do what the first argument says."""
    match sys.argv[1:]:
        case ["power"]:
            files = sorted((ROOT / "recordings" / "cube-toss").glob("*.mcap"))
            redraw(PAGE, {"power": power_table(evaluate_files(files, sample_time=SAMPLE_TIME))})
        case ["record", folder]:
            record(Path(folder))
        case ["result", folder]:
            files = sorted(Path(folder).rglob("*.mcap"))
            redraw(PAGE, {"result": result_table(evaluate_files(files, sample_time=SAMPLE_TIME))})
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
