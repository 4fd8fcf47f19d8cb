"""Shows how a block's deceleration depends on its mass: rules for kinetic friction, and recordings of engines.

usage: python docs/make_friction.py [RECORDING ...]

Prints the table of the rules, which needs no engine, and a row for each recording of the scenes sliding-blocks and
sliding-slabs (see examples/sliding-blocks). Without recordings it takes those of recordings/friction, and writes the
tables into docs/madrona-friction.md, with what a substep of Madrona's predicts beside what was recorded.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from madrona_substep import corner_inverse_mass, normal_impulses
from numpy.typing import NDArray
from page_blocks import redraw

from gpusimbench import open_recording
from gpusimbench.schemas.provenance import engine_name

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "recordings" / "friction"
PAGE = ROOT / "docs" / "madrona-friction.md"

sys.path.insert(0, str(ROOT / "examples" / "sliding-blocks" / "src"))
from sliding_blocks import EDGE, FRICTION, GRAVITY, MASSES, SPEED, THICKNESS, deceleration  # noqa: E402

Rule = Callable[[float, float], float]
"""The largest friction impulse [kg m/s], of the impulse mu J_n that Coulomb allows [kg m/s] and w [1/kg]."""

COULOMB = "Coulomb: impulse up to mu J_n"
MADRONA = "Madrona b31034b: that, divided by w once more"

RULES: dict[str, Rule] = {
    COULOMB: lambda impulse, w: impulse,
    "eq. 30 of Müller et al. (2020): mu J_n as a speed": lambda impulse, w: impulse / w,
    MADRONA: lambda impulse, w: impulse / w**2,
}

HEIGHTS = {"sliding-blocks": EDGE, "sliding-slabs": THICKNESS}
"""Of the boxes of a scene [m]."""


@dataclass(frozen=True)
class Case:
    """A recording of Madrona that ships, and what was built into it.

    stem        of the file
    changed     what differs from b31034b, in words; empty where nothing does
    height      of the boxes [m]
    substeps    of a step
    rule        a name of RULES
    count_both  whether friction counts the normal impulses of both solves
    """

    stem: str
    changed: str
    height: float = EDGE
    substeps: int = 4
    rule: str = COULOMB
    count_both: bool = False

    def predicted(self) -> NDArray[np.float64]:
        """Deceleration of each box [m/s2]."""
        return np.array([self._predicted(mass) for mass in MASSES])

    def _predicted(self, mass: float) -> float:
        flatness = self.height / EDGE
        w = corner_inverse_mass(flatness) / mass
        friction = RULES[self.rule](FRICTION * mass, w) / mass  # the friction impulse over the normal impulse
        lift, given_back = normal_impulses(friction, flatness, count_both=self.count_both)
        return friction * GRAVITY * (lift + given_back if self.count_both else lift)


PUBLISHED = (Case("madrona", "", rule=MADRONA), Case("madrona-slabs", "", THICKNESS, rule=MADRONA))

_ONCE, _TWICE = "multiplies by w", "multiplies by w, counts both impulses"

CHANGED = (
    Case("madrona-modified", _ONCE),
    Case("madrona-modified-1-substep", _ONCE, substeps=1),
    Case("madrona-modified-16-substeps", _ONCE, substeps=16),
    Case("madrona-modified-slabs", _ONCE, THICKNESS),
    Case("madrona-modified-twice", _TWICE, count_both=True),
)


def by_rule(rule: Rule, mass: float) -> float:
    """Deceleration of a cube that slides on a plane at its four corners [m/s2], if nothing stops it in a substep.

    In a substep of h seconds the plane gives the normal impulse J_n = m g h; h cancels.
    """
    return rule(FRICTION * mass * GRAVITY, corner_inverse_mass(1.0) / mass) / mass


def rules_table() -> list[list[str]]:
    """The rules' decelerations, a row each."""
    rows = [[name, *(_number(by_rule(rule, mass)) for mass in MASSES)] for name, rule in RULES.items()]
    return [["rule", *(f"{mass:g} kg" for mass in MASSES)], *rows]


def measured(path: Path) -> tuple[str, NDArray[np.float64]]:
    """What an engine is called, and the deceleration of each box in environment 0 [m/s2]; NaN if it stops by 0.5 s."""
    recording = open_recording(path)
    if recording.configuration.scene not in HEIGHTS or recording.simulation is None:
        raise SystemExit(f"{path} is no recording of {' or '.join(HEIGHTS)}")
    name = engine_name(recording.configuration.simulator, recording.simulation)
    velocity = np.asarray(recording.state("blocks", "linear_velocity")[:, :1])
    found = deceleration(velocity, recording.configuration.dt)[0]
    found[np.abs(velocity[-1, 0, :, 0]) < _STOPPED] = np.nan
    what = "" if recording.configuration.scene == "sliding-blocks" else ", slabs"
    return f"{name}, {recording.simulation.version}{what}", found


_STOPPED = 0.01 * SPEED


def measured_table(paths: Sequence[Path]) -> list[list[str]]:
    """Measured decelerations, a row for each recording."""
    rows = [[name, *map(_number, found)] for name, found in map(measured, paths)]
    return [["recording", *(f"{mass:g} kg" for mass in MASSES)], *rows]


def page_table() -> list[list[str]]:
    """Measured decelerations of engines as published, and below each Madrona's the predicted ones."""
    head, *rows = measured_table([SHIPPED / f"{name}.mcap" for name in ("sapien", *(case.stem for case in PUBLISHED))])
    sapien, *madrona = rows
    both = []
    for row, case in zip(madrona, PUBLISHED, strict=True):
        stopped = [cell == _STOPS for cell in row[1:]]
        told = [_STOPS if s else _number(value) for s, value in zip(stopped, case.predicted(), strict=True)]
        both += [row, ["predicted", *told]]
    return [head, sapien, *both]


def changed_table() -> list[list[str]]:
    """Deceleration over that of Coulomb's law of changed builds, the mean over the masses, which are alike."""
    rows = []
    for case in CHANGED:
        _, found = measured(SHIPPED / f"{case.stem}.mcap")
        numbers = (values.mean() / (FRICTION * GRAVITY) for values in (found, case.predicted()))
        shape = "cubes" if case.height == EDGE else "slabs"
        rows.append([case.changed, shape, str(case.substeps), *(f"{number:.3f}" for number in numbers)])
    return [["friction", "boxes", "substeps", "measured", "predicted"], *rows]


_STOPS = "stops"


def _number(value: float) -> str:
    if np.isnan(value):
        return _STOPS
    return f"{value + 0.0:.2f}" if abs(value) >= 0.095 else f"{value + 0.0:.1g}" if abs(value) >= 1e-3 else "< 0.001"


def markdown(rows: list[list[str]]) -> str:
    """A table."""
    head, *body = rows
    lines = [head, ["---", *("---:" for _ in head[1:])], *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> int:
    """Entry point."""
    given = [Path(path) for path in sys.argv[1:]]
    if given:
        print(f"Deceleration [m/s2]\n\n{markdown(rules_table())}\n\n{markdown(measured_table(given))}")
    else:
        redraw(PAGE, page_tables())
    return 0


def page_tables() -> dict[str, str]:
    """The tables of the page by the names of their markers."""
    tables = {"rules": rules_table(), "measured": page_table(), "changed": changed_table()}
    return {name: markdown(rows) for name, rows in tables.items()}


def shipped() -> list[Path]:
    """The recordings that ship."""
    return sorted(SHIPPED.glob("*.mcap"))


if __name__ == "__main__":
    sys.exit(main())
