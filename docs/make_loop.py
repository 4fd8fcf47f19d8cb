"""Draws docs/figures/parting.svg: two recordings of one scene seen from above, which are alike and then part.

usage: python docs/make_loop.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.evaluator.render.figures import palette

ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / "docs" / "figures" / "parting.svg"
PAIR = ("mujoco-amd-r0.mcap", "mujoco-pyramidal-r0.mcap")
"""MuJoCo on one machine, with elliptic and with pyramidal friction cones."""

_EVERY = 10  # recorded steps between two frames
_SECONDS = 7.0
_HOLD = 8  # frames for which the last picture stays
_SIDE, _TOP, _BOTTOM = 460.0, 46.0, 44.0
_CUBE_M = 0.04
_WINDOW = (-0.05, 0.5, -0.275, 0.275)  # what is shown of the board: x from, x to, y from, y to [m]


def positions(name: str) -> NDArray[np.float64]:
    """Planar positions of the cubes of environment 0 [m], shape [frame, cube, 2]."""
    states = open_recording(ROOT / "recordings" / name).state("cubes", "position")
    return np.asarray(states[::_EVERY, 0, :, :2], dtype=np.float64)


def loop() -> str:
    """The picture as SVG that moves in any browser, without a script."""
    one, other = (positions(name) for name in PAIR)
    apart = np.linalg.norm(one - other, axis=2).mean(axis=1) * 100
    frames = len(one) + _HOLD
    light, dark = palette.variables(dark=False), palette.variables(dark=True)
    style = f":root {{ {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    marks = [_cube(path, kind) for kind, found in (("b", other), ("a", one)) for path in np.moveaxis(found, 1, 0)]
    counters = [
        _shown(f"t = {i * _EVERY / 100:.1f} s: on average {cm:.3g} cm apart", i, frames) for i, cm in enumerate(apart)
    ]
    height = _TOP + _SIDE + _BOTTOM
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_SIDE:g} {height:g}" role="img" '
        'aria-label="27 cubes seen from above in two recordings: alike at first, elsewhere in the end">\n'
        f"<style>{style}\ntext {{ font: 14px system-ui, sans-serif; fill: var(--ink); }}\n"
        ".a { fill: var(--g0); } .b { fill: none; stroke: var(--g1); stroke-width: 2; }\n"
        ".board { fill: var(--board); }</style>\n"
        '<text x="4" y="18">One scene twice, one setting changed: MuJoCo, <tspan class="a">elliptic</tspan> ■</text>\n'
        '<text x="4" y="37">and pyramidal □ friction cones. Both repeat themselves bit for bit.</text>\n'
        f'<svg y="{_TOP:g}" width="{_SIDE:g}" height="{_SIDE:g}"><rect class="board" width="100%" height="100%"/>\n'
        f"{chr(10).join(marks)}\n</svg>\n{chr(10).join(counters)}\n</svg>\n"
    )


def _cube(path: NDArray[np.float64], kind: str) -> str:
    """A cube that moves along a path [m], shape [frame, 2], and then stays."""
    low_x, high_x, low_y, high_y = _WINDOW
    scale = _SIDE / (high_x - low_x)
    side = _CUBE_M * scale
    x = (path[:, 0] - low_x) * scale - side / 2
    y = (high_y - path[:, 1]) * scale - side / 2
    still = "".join(_animated(name, [*values, *([values[-1]] * _HOLD)]) for name, values in (("x", x), ("y", y)))
    return f'<rect class="{kind}" width="{side:g}" height="{side:g}" x="{x[0]:.0f}" y="{y[0]:.0f}">{still}</rect>'


def _animated(name: str, values: list[float]) -> str:
    listed = ";".join(f"{value:.0f}" for value in values)
    return f'<animate attributeName="{name}" dur="{_SECONDS:g}s" repeatCount="indefinite" values="{listed}"/>'


def _shown(said: str, frame: int, frames: int) -> str:
    """A line that is seen in one frame, the last of them until the loop begins anew."""
    last = frame == frames - _HOLD - 1
    seen = ["hidden"] * frames
    seen[frame : frames if last else frame + 1] = ["visible"] * (frames - frame if last else 1)
    first = "visible" if frame == 0 else "hidden"
    return (
        f'<text x="4" y="{_TOP + _SIDE + 24:g}" visibility="{first}">{said}<animate attributeName="visibility" '
        f'dur="{_SECONDS:g}s" calcMode="discrete" repeatCount="indefinite" values="{";".join(seen)}"/></text>'
    )


def main() -> None:
    """Write it."""
    TARGET.write_text(loop(), encoding="utf-8")
    print(TARGET)


if __name__ == "__main__":
    main()
