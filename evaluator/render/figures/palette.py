"""Colours: of the page, one scale for values, one set for groups, each for a light and a dark page.

The scale's control points lie in OKLCH (lightness, chroma, hue), where equal steps of lightness look equal. Lightness
rises evenly from end to end while the hue turns from indigo by teal to yellow: the order survives in grey print and in
every form of colour blindness, since blue and yellow are the pair that the common ones keep apart. On a light page high
values are dark, on a dark page they are bright: in both, much stands out and little recedes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LEVELS = 32
"""Number of steps that values are drawn in."""

CONTROL_POINTS = (
    # lightness, chroma, hue [deg]
    (0.25, 0.090, 285.0),
    (0.42, 0.115, 262.0),
    (0.59, 0.105, 222.0),
    (0.76, 0.120, 170.0),
    (0.93, 0.130, 105.0),
)

_LIGHT_ENDS = (0.82, 0.0)
_DARK_ENDS = (0.26, 1.0)

_LIGHT = {
    "page": "#ffffff", "ink": "#1b1f24", "quiet": "#57606a", "rule": "#c9d0d8", "panel": "#f5f7f9", "link": "#0a5ea8",
    "alert": "#8f1d14", "alert-panel": "#fdf0ee", "board": "#eceae4", "edge": "#8a8372", "bar": "#7b8794",
    "zero": "#e3e6ea", "zero-line": "#7b8794", "good": "#0b5f38", "good-panel": "#e4f3ea", "warn": "#734d00",
    "warn-panel": "#fcf1d8",
}  # fmt: skip
_DARK = {
    "page": "#14171b", "ink": "#e4e8ec", "quiet": "#a3adb8", "rule": "#3b444e", "panel": "#1c2126", "link": "#7fbcff",
    "alert": "#ffb0a6", "alert-panel": "#36201e", "board": "#22241f", "edge": "#8f8871", "bar": "#8a97a5",
    "zero": "#2b3138", "zero-line": "#8a97a5", "good": "#84d9ac", "good-panel": "#14311f", "warn": "#f0c674",
    "warn-panel": "#362b12",
}  # fmt: skip

GROUPS_LIGHT = ("#0a5ea8", "#b8470a", "#0d7a52", "#9c2f78", "#6d6200", "#5a46b0", "#a02834", "#3d5a66")
GROUPS_DARK = ("#6db6ff", "#ff9d5c", "#4fd09c", "#f08fce", "#d6c84a", "#b3a4ff", "#ff8f93", "#a9c4d0")


def level(value: float) -> int:
    """The step of a value between 0 and 1; what lies outside is drawn as the nearer end."""
    return min(LEVELS - 1, max(0, int(value * LEVELS)))


def colour(position: float) -> str:
    """The scale's colour, "#rrggbb", from 0 (darkest) to 1 (lightest)."""
    points = np.array(CONTROL_POINTS)
    at = np.linspace(0.0, 1.0, len(points))
    lightness, chroma, hue = (float(np.interp(position, at, column)) for column in points.T)
    red, green, blue = np.rint(255.0 * _srgb(lightness, chroma, math.radians(hue))).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def scale(*, dark: bool) -> list[str]:
    """Colours of all steps, lowest value first."""
    low, high = _DARK_ENDS if dark else _LIGHT_ENDS
    return [colour(low + (high - low) * step / (LEVELS - 1)) for step in range(LEVELS)]


def theme(*, dark: bool) -> dict[str, str]:
    """All colours by name: those of the page, q0 .. for values, g0 .. for groups."""
    named = _DARK if dark else _LIGHT
    groups = GROUPS_DARK if dark else GROUPS_LIGHT
    values = {f"q{i}": c for i, c in enumerate(scale(dark=dark))}
    return named | values | {f"g{i}": c for i, c in enumerate(groups)}


def variables(*, dark: bool) -> str:
    """The colours of `theme` as CSS custom properties."""
    return " ".join(f"--{name}: {value};" for name, value in theme(dark=dark).items())


def rules() -> str:
    """The classes of values and groups, as CSS."""
    names = [*(f"q{i}" for i in range(LEVELS)), *(f"g{i}" for i in range(len(GROUPS_LIGHT)))]
    return "\n".join(f".{name} {{ fill: var(--{name}); stroke: var(--{name}); }}" for name in names)


def _srgb(lightness: float, chroma: float, hue: float) -> NDArray[np.float64]:
    """OKLCH to sRGB, shape [3], clipped to 0 .. 1 (matrices: B. Ottosson, "A perceptual color space", 2020)."""
    a, b = chroma * math.cos(hue), chroma * math.sin(hue)
    cones = np.array(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ]
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip(to_linear @ cones**3, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(encoded, dtype=np.float64)
