"""Shows how a block's deceleration depends on its mass: three rules for kinetic friction, and recordings of engines.

usage: python docs/make_friction.py [RECORDING ...]

Prints the table of the rules, which needs no engine, and a row for each recording of the scene sliding-blocks (see
examples/sliding-blocks). Without recordings it takes those of recordings/friction, and writes the tables into
docs/madrona-friction.md.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.schemas.provenance import engine_name

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "recordings" / "friction"
PAGE = ROOT / "docs" / "madrona-friction.md"

sys.path.insert(0, str(ROOT / "examples" / "sliding-blocks" / "src"))
from sliding_blocks import FRICTION, GRAVITY, MASSES, deceleration  # noqa: E402

_CORNER = 4.0
"""Generalised inverse mass of a cube at a lower corner, along an edge, times its mass.

w = 1/m + (r x t) . I^-1 (r x t), with r = (a, a, -a)/2, t along x and I = m a^2 / 6: 1/m + 6/(m a^2) (a^2/4 + a^2/4).
"""

Rule = Callable[[float, float], float]
"""The largest friction impulse [kg m/s], of the impulse mu J_n that Coulomb allows [kg m/s] and w [1/kg]."""

RULES: dict[str, Rule] = {
    "Coulomb: impulse up to mu J_n": lambda impulse, w: impulse,
    "eq. 30 of Müller et al. (2020): mu J_n as a speed": lambda impulse, w: impulse / w,
    "Madrona b31034b: that, divided by w once more": lambda impulse, w: impulse / w**2,
}


def by_rule(rule: Rule, mass: float) -> float:
    """Deceleration of a cube that slides on a plane at its four corners [m/s2], if nothing stops it in a substep.

    In a substep of h seconds the plane gives the normal impulse J_n = m g h; h cancels.
    """
    return rule(FRICTION * mass * GRAVITY, _CORNER / mass) / mass


def rules_table() -> list[list[str]]:
    """The rules' decelerations, a row each."""
    rows = [[name, *(_number(by_rule(rule, mass)) for mass in MASSES)] for name, rule in RULES.items()]
    return [["rule", *(f"{mass:g} kg" for mass in MASSES)], *rows]


def measured(path: Path) -> tuple[str, NDArray[np.float64]]:
    """What an engine is called, and the deceleration of each block in environment 0 [m/s2]."""
    recording = open_recording(path)
    if recording.configuration.scene != "sliding-blocks" or recording.simulation is None:
        raise SystemExit(f"{path} is no recording of sliding-blocks")
    name = engine_name(recording.configuration.simulator, recording.simulation)
    velocity = np.asarray(recording.state("blocks", "linear_velocity")[:, :1])
    return f"{name}, {recording.simulation.version}", deceleration(velocity, recording.configuration.dt)[0]


def measured_table(paths: Sequence[Path]) -> list[list[str]]:
    """Measured decelerations, a row for each recording."""
    rows = [[name, *map(_number, found)] for name, found in map(measured, paths)]
    return [["recording", *(f"{mass:g} kg" for mass in MASSES)], *rows]


def _number(value: float) -> str:
    return f"{value + 0.0:.2f}" if abs(value) >= 0.095 else f"{value + 0.0:.1g}" if abs(value) >= 1e-3 else "< 0.001"


def markdown(rows: list[list[str]]) -> str:
    """A table."""
    head, *body = rows
    lines = [head, ["---", *("---:" for _ in head[1:])], *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def with_tables(page: str, tables: dict[str, str]) -> str:
    """The page with the tables between their markers replaced."""
    for name, shown in tables.items():
        begin, end = f"<!-- {name}: make figures -->\n", f"<!-- end of {name} -->"
        head, rest = page.split(begin)
        _, tail = rest.split(end)
        page = f"{head}{begin}{shown}\n{end}{tail}"
    return page


def main() -> int:
    """Entry point."""
    given = [Path(path) for path in sys.argv[1:]]
    tables = {"rules": markdown(rules_table()), "measured": markdown(measured_table(given or shipped()))}
    if given:
        print(f"Deceleration [m/s2]\n\n{tables['rules']}\n\n{tables['measured']}")
    else:
        PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), tables), encoding="utf-8")
    return 0


def shipped() -> list[Path]:
    """The recordings that ship, in the order of the page."""
    return sorted(SHIPPED.glob("*.mcap"))


if __name__ == "__main__":
    sys.exit(main())
