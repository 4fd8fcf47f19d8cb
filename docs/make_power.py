"""Counts whether laws in closed form notice what they claim, on several scenes and engines, and draws the tables into
docs/physics/power.md.

usage: python docs/make_power.py FOLDER [NAME...]

What FOLDER has already is not counted again; with names of counts, no others are made. Each takes minutes.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from page_blocks import redraw
from scipy import stats

PAGE = Path(__file__).resolve().parent / "physics" / "power.md"
REPETITIONS = 40
FRESH = 1_000_001
"""Of the first recording. The formulas of the claims were chosen on recordings of seeds below."""

_RK4 = ("--option", "integrator=RK4")
_STIFF = ("--option", "solref=0.002 1")
_BOUNCING = ("--sim", "newton", "--option", "solver=xpbd", "--option", "restitution=on")
COUNTS: dict[str, tuple[str, ...]] = {
    "pendulum-10ms": ("--scene", "pendulum", "--dt", "0.01"),
    "pendulum-4ms": ("--scene", "pendulum", "--dt", "0.004"),
    "sliding-block-10ms": ("--scene", "sliding-block", "--dt", "0.01"),
    "sliding-block-4ms": ("--scene", "sliding-block", "--dt", "0.004"),
    "free-body-rk4": ("--scene", "free-body", *_RK4, "--dt", "0.02"),
    "free-body": ("--scene", "free-body", "--dt", "0.02"),
    "ball-drop": ("--scene", "ball-drop", "--dt", "0.01,0.004"),
    "ball-drop-newton": ("--scene", "ball-drop", *_BOUNCING, "--dt", "0.01", "--parameter", "restitution"),
    "double-pendulum-rk4": ("--scene", "double-pendulum", *_RK4, "--dt", "0.01"),
    "double-pendulum": ("--scene", "double-pendulum", "--dt", "0.004"),
    "four-bar-rk4": ("--scene", "four-bar", *_RK4, *_STIFF, "--dt", "0.005", "--repetitions", "20"),
    "loaded-dice": ("--n-env", "16", "--shares", "0,0.3,0.38"),
    "masses": ("--share", "0.2", "--repetitions", "20"),
}
"""Arguments of benchmarks.law_power, and of those of _OTHERS, by the name of the file of their table."""

_OTHERS = {"loaded-dice": "loaded_dice", "masses": "law_masses"}
"""Benchmarks whose tables claim no rate of 95 %, by the name of the file."""

HEAD = (
    "scene, engine", "step", "change of", "laws", "two recordings: claimed size", "seen", "without a change",
    "verdict: claimed size", "broken", "without a change",
)  # fmt: skip
"""Of the table of all counts: a row for each parameter that is changed, with the counts of its laws added up."""

LIMIT = 0.01
"""A rate is named where the claim would give one so far off with a smaller probability."""


def count(folder: Path, chosen: list[str]) -> None:
    """Make the counts that are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, arguments in COUNTS.items():
        out = folder / f"{name}.md"
        if out.exists() or (chosen and name not in chosen):
            continue
        script = _OTHERS.get(name, "law_power")
        command = [sys.executable, "-m", f"benchmarks.{script}", "--repetitions", f"{REPETITIONS}"]
        command += [*arguments, "--seed", f"{FRESH}", "--out", str(out)]
        done = subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
        print(f"{name}: exit code {done.returncode}", flush=True)


@dataclass(frozen=True)
class Rate:
    """How often something came to pass in a column of a table."""

    seen: int
    of: int

    def beyond(self, claimed: float, *, above: bool) -> bool:
        """Whether a rate of what is claimed, or better, gives one so far off with a probability below LIMIT."""
        if not self.of:
            return False
        far = stats.binom.cdf(self.seen, self.of, claimed)
        return bool((stats.binom.sf(self.seen - 1, self.of, claimed) if above else far) < LIMIT)


CLAIMS = {4: (0.95, False), 5: (0.05, True), 7: (0.95, False), 8: (0.0, True)}
"""By column: the rate that is claimed, and whether a higher rate is against the claim."""
_SIZES = (3, 6)


@dataclass(frozen=True)
class Counted:
    """A row of a table of benchmarks.law_power.

    of     scene and engine
    sizes  that are claimed, by column, each with its unit; none where nothing is claimed
    rates  by column of CLAIMS
    """

    of: str
    step: str
    law: str
    parameter: str
    sizes: dict[int, str]
    rates: dict[int, Rate]

    @property
    def far(self) -> list[int]:
        """Columns whose rate is far from its claim.

        A verdict that is broken without a change is no fault of the claim: such a law claims no size of its verdict.
        """
        return [column for column, rate in self.rates.items()
                if column != 8 and rate.beyond(CLAIMS[column][0], above=CLAIMS[column][1])]  # fmt: skip


def counted(text: str, of: str) -> Iterator[Counted]:
    """The rows of a table of benchmarks.law_power of a scene and an engine."""
    for line in table_rows(text):
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        rates = {}
        for column in CLAIMS:
            seen, among, count = cells[column].partition(" of ")
            if among:
                rates[column] = Rate(int(seen), int(count))
        sizes = {column: cells[column] for column in _SIZES if cells[column] != "-"}
        yield Counted(of, cells[0], cells[1], cells[2], sizes, rates)


def table(rows: Sequence[Counted]) -> str:
    """A row for each parameter, the counts of its laws added up; below it the sums, and every rate far from its
    claim by name."""
    lines = [f"| {' | '.join(HEAD)} |", f"| --- | ---: | --- {'| ---: ' * 7}|"]
    groups: dict[tuple[str, str, str], list[Counted]] = {}
    for row in rows:
        groups.setdefault((row.of, row.step, row.parameter), []).append(row)
    for (of, step, parameter), some in groups.items():
        shown = [_between([row.sizes[c] for row in some if c in row.sizes]) if c in _SIZES else _said(some, c)
                 for c in range(3, 9)]  # fmt: skip
        lines.append(f"| {of} | {step} | {parameter} | {len(some)} | {' | '.join(shown)} |")
    far = [
        f"{row.law} ({row.of}, {row.step}): {row.rates[c].seen} of {row.rates[c].of}" for row in rows for c in row.far
    ]
    n_rate = sum(column != 8 for row in rows for column in row.rates)
    return "\n".join([
        *lines, "",
        f"In total: {_said(rows, 4)} pairs with a change were seen, and {_said(rows, 7)} verdicts broken; without a "
        f"change {_said(rows, 5)} pairs differed. Of the {n_rate} rates of single laws, {len(far)} "
        f"{'is' if len(far) == 1 else 'are'} so far from the claim that a rate of 95 % (5 % without a change) gives "
        f"such a rate with a probability below {100 * LIMIT:g} %{': ' * bool(far)}{'; '.join(far)}.",
    ])  # fmt: skip


def _said(rows: Sequence[Counted], column: int) -> str:
    rates = [row.rates[column] for row in rows if column in row.rates]
    return f"{sum(rate.seen for rate in rates):,} of {sum(rate.of for rate in rates):,}" if rates else "-"


def _between(sizes: Sequence[str]) -> str:
    """Sizes of one unit as a range."""
    if not sizes:
        return "-"
    numbers = sorted({size.partition(" ")[0] for size in sizes}, key=float)
    unit = sizes[0].partition(" ")[2]
    return f"{numbers[0]}{f' to {numbers[-1]}' if len(numbers) > 1 else ''} {unit}"


def table_rows(text: str) -> list[str]:
    """The lines of a table below its head."""
    return [line for line in text.splitlines() if line.startswith("|")][2:]


def block(folder: Path) -> str:
    """The table of all counts of claims that FOLDER has."""
    rows: list[Counted] = []
    for name, arguments in COUNTS.items():
        file = folder / f"{name}.md"
        if name in _OTHERS or not file.exists():
            continue
        text = file.read_text(encoding="utf-8").strip()
        engine = text.splitlines()[-1].rpartition(", ")[0].rpartition(", ")[0]  # without environments and repetitions
        rows += counted(text, f"{arguments[arguments.index('--scene') + 1]}, {engine}")
    return table(rows)


def unmoved(text: str) -> str:
    """What a table of benchmarks.law_masses says of all its laws together, in sentences."""
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in table_rows(text)]
    most = max(float(row[2]) for row in rows)
    other = [row[1] for row in rows if row[3] != row[4]]
    return (
        f"With other masses, {len(rows)} laws of {len({row[1].partition(':')[0] for row in rows})} scenes moved by "
        f"{most:.1e} of their tolerance at most, and "
        + (f"other verdicts were broken of: {', '.join(other)}." if other else "the same verdicts were broken.")
    )


def main() -> None:
    """Count, and write the tables into the page."""
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    folder = Path(sys.argv[1]).resolve()
    count(folder, sys.argv[2:])
    blocks = {"further counts": block(folder)}
    for name, marker, shown in (("loaded-dice", "loaded dice", str.strip), ("masses", "other masses", unmoved)):
        file = folder / f"{name}.md"
        if file.exists():
            blocks[marker] = shown(file.read_text(encoding="utf-8"))
    redraw(PAGE, blocks)


if __name__ == "__main__":
    main()
