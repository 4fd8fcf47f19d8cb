"""Counts whether laws in closed form notice what they claim, on several scenes and engines, and draws the tables into
docs/physics/power.md.

usage: python docs/make_power.py FOLDER [NAME...]

What FOLDER has already is not counted again; with names of counts, no others are made. Each takes minutes.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
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
    "scene, engine", "step", "law", "change of", "two recordings: claimed size", "seen", "without a change",
    "verdict: claimed size", "broken", "without a change",
)  # fmt: skip
"""Of the table of all counts: that of benchmarks.law_power, and what a row is of before it."""

LIMIT = 0.01
"""A rate is bold where the claim would give one so far off with a smaller probability."""


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


def drawn(text: str) -> tuple[str, dict[int, list[Rate]]]:
    """A table of benchmarks.law_power with rates against their claims in bold, and the rates by column.

    A verdict that is broken without a change is no fault of the claim: such a law claims no size of its verdict.
    """
    lines, rates = [], dict[int, list[Rate]]()
    for line in text.strip().splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        for column, (claimed, above) in CLAIMS.items():
            seen, of, count = cells[column].partition(" of ") if len(cells) > column else ("", "", "")
            if not of:
                continue
            rate = Rate(int(seen), int(count))
            rates.setdefault(column, []).append(rate)
            if column != 8 and rate.beyond(claimed, above=above):
                cells[column] = f"**{cells[column]}**"
        lines.append(f"| {' | '.join(cells)} |" if len(cells) > 1 else line)
    return "\n".join(lines), rates


def total(rates: Mapping[int, Sequence[Rate]]) -> str:
    """The rates of all tables together, in sentences."""
    sums = {column: Rate(sum(r.seen for r in found), sum(r.of for r in found)) for column, found in rates.items()}
    bold = sum(rate.beyond(*CLAIMS[column][:1], above=CLAIMS[column][1])
               for column, found in rates.items() if column != 8 for rate in found)  # fmt: skip
    counted = sum(len(found) for column, found in rates.items() if column != 8)
    return (
        f"In total: {_said(sums, 4)} pairs with a change were seen, and {_said(sums, 7)} verdicts broken; "
        f"without a change {_said(sums, 5)} pairs differed. Bold: {bold} of {counted} rates, so far from the claim "
        f"that a rate of 95 % (5 % without a change) gives them with a probability below {100 * LIMIT:g} %."
    )


def _said(sums: Mapping[int, Rate], column: int) -> str:
    rate = sums.get(column, Rate(0, 0))
    return f"{rate.seen:,} of {rate.of:,}"


def table_rows(text: str) -> list[str]:
    """The lines of a table below its head."""
    return [line for line in text.splitlines() if line.startswith("|")][2:]


def block(folder: Path) -> str:
    """The rows of all counts of claims that FOLDER has, in a table, with what was counted below it."""
    shown = [f"| {' | '.join(HEAD)} |", f"| --- | ---: | --- | --- {'| ---: ' * 6}|"]
    rates = dict[int, list[Rate]]()
    for name, arguments in COUNTS.items():
        file = folder / f"{name}.md"
        if name in _OTHERS or not file.exists():
            continue
        text, found = drawn(file.read_text(encoding="utf-8"))
        engine = text.splitlines()[-1].rpartition(", ")[0].rpartition(", ")[0]  # without environments and repetitions
        scene = arguments[arguments.index("--scene") + 1]
        shown += [f"| {scene}, {engine} {line}" for line in table_rows(text)]
        for column, some in found.items():
            rates.setdefault(column, []).extend(some)
    return "\n".join([*shown, "", total(rates)])


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
