"""Colours of the page and its figures: contrast of text, and what colour-blind readers can tell apart."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.evaluator.render.figures import palette, style

# G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, "A physiologically-based model for simulation of color vision
# deficiency", 2009: severity 1.0, of linear sRGB.
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}

THEMES = pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])


def linear(colour: str) -> NDArray[np.float64]:
    """Linear sRGB of "#rrggbb", shape [3]."""
    encoded = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Contrast of two colours (WCAG 2.2), from 1 to 21."""
    low, high = sorted(float(linear(c) @ [0.2126, 0.7152, 0.0722]) for c in (one, other))
    return (high + 0.05) / (low + 0.05)


def oklab(colour: str, blindness: str) -> NDArray[np.float64]:
    """The colour as somebody sees it, in OKLab, where distances are differences that are seen."""
    seen = np.clip(np.array(BLINDNESS[blindness]) @ linear(colour), 0.0, 1.0)
    cones = np.cbrt(
        np.array(
            [
                [0.4122214708, 0.5363325363, 0.0514459929],
                [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005],
            ]
        )
        @ seen
    )
    return (
        np.array(
            [
                [0.2104542553, 0.7936177850, -0.0040720468],
                [1.9779984951, -2.4285922050, 0.4505937099],
                [0.0259040371, 0.7827717662, -0.8086757660],
            ]
        )
        @ cones
    )


@THEMES
def test_text_has_contrast(dark: bool) -> None:
    """Set every text on every ground that it stands on with a contrast of 4.5 to 1."""
    theme = palette.theme(dark=dark)
    grounds = {"ink": ("page", "panel", "alert-panel", "board"), "quiet": ("page", "panel", "alert-panel"),
               "link": ("page", "panel", "alert-panel"), "alert": ("page", "panel", "alert-panel")}  # fmt: skip
    for text, behind in grounds.items():
        for ground in behind:
            assert contrast(theme[text], theme[ground]) >= 4.5, (text, ground)


@THEMES
def test_what_figures_draw_has_contrast(dark: bool) -> None:
    """Draw lines and marks of series with a contrast of 3 to 1 against the page (WCAG 1.4.11)."""
    theme = palette.theme(dark=dark)
    for name in (*(f"g{i}" for i in range(len(palette.GROUPS_LIGHT))), "bar", "zero-line", "quiet"):
        assert contrast(theme[name], theme["page"]) >= 3, name


def test_text_of_files_has_contrast() -> None:
    """Do the same in figures that leave the page, which have the light theme's colours in their elements."""
    found = dict(style.resolved())
    for selector in ("text", ".small"):
        assert contrast(found[selector]["fill"], found[".page"]["fill"]) >= 4.5


@THEMES
@pytest.mark.parametrize("blindness", BLINDNESS)
def test_the_scale_keeps_its_order(blindness: str, dark: bool) -> None:
    """Let lightness rise or fall all the way along the scale, whoever looks."""
    lightness = [float(oklab(colour, blindness)[0]) for colour in palette.scale(dark=dark)]
    steps = np.diff(lightness)
    assert (steps > 0).all() if dark else (steps < 0).all()
    assert abs(lightness[-1] - lightness[0]) > 0.45


@THEMES
@pytest.mark.parametrize("blindness", BLINDNESS)
def test_neighbouring_groups_differ(blindness: str, dark: bool) -> None:
    """Keep colours of groups that follow each other apart; dash and mark tell the rest."""
    colours = palette.GROUPS_DARK if dark else palette.GROUPS_LIGHT
    for one, other in pairwise((*colours, colours[0])):
        assert math.dist(oklab(one, blindness), oklab(other, blindness)) > 0.05, (one, other)
