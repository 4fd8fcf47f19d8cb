"""How figures look: one set of rules, as CSS for a page and resolved for a picture that stands alone.

Rules are in order, later ones win; a selector is the element `text` or one class. Where a page's rules are CSS with
variables for its themes, a file that leaves the page has its colours written into its elements: not every program that
reads SVG knows style sheets, and few know variables.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache

from gpusimbench.evaluator.render.figures import palette

_NAMESPACE = "http://www.w3.org/2000/svg"

_RULES = """
text { fill: var(--ink); font-size: 12px; font-family: var(--font); }
.small { font-size: 10.5px; fill: var(--quiet); }
.mid { text-anchor: middle; }
.end { text-anchor: end; }
.page { fill: var(--page); }
.axis { stroke: var(--quiet); stroke-width: 1; fill: none; }
.frame { stroke: var(--quiet); stroke-width: 1; fill: none; }
.faint { stroke: var(--rule); stroke-width: 1; fill: none; }
.bar { fill: var(--bar); }
.board { fill: var(--board); }
.edge { stroke: var(--edge); stroke-width: 1.2; stroke-dasharray: 5 3; fill: none; }
PALETTE
.hex { stroke-width: 0.6; stroke-linejoin: round; }
.flat { stroke: none; shape-rendering: crispEdges; }
.zero { fill: url(#hatch); stroke: none; }
.ground { fill: var(--zero); }
.hatch { stroke: var(--zero-line); stroke-width: 0.8; fill: none; }
.lost { fill: var(--page); stroke: var(--alert); }
.line { fill: none; stroke-width: 2; }
.model { fill: none; stroke-width: 1; stroke-opacity: 0.75; }
.ideal { fill: none; stroke: var(--quiet); stroke-width: 1; stroke-dasharray: 1 4; }
.end-ring { fill: none; stroke-width: 1.6; }
.lead-out { fill: none; stroke: var(--quiet); stroke-width: 1; stroke-dasharray: 2 3; }
.cross { fill: none; stroke: var(--alert); stroke-width: 2; }
.foreign-name { paint-order: stroke; stroke: var(--panel); stroke-width: 3px; stroke-linejoin: round; }
.over { paint-order: stroke; stroke: var(--page); stroke-width: 3px; stroke-linejoin: round; }
.foreign { fill: var(--page); stroke: var(--quiet); stroke-width: 1.5; }
.whisker { fill: none; stroke-width: 1.8; }
.nothing { fill: var(--page); stroke-width: 1.8; }
.name { font-size: 11px; }
.boundary { stroke: var(--page); stroke-width: 2.5; }
.branch { fill: none; stroke-width: 1.6; }
.fit { fill: none; stroke: var(--ink); stroke-width: 1.6; stroke-dasharray: 6 4; }
"""

_FOR_FILES = {"font": "Helvetica, Arial, sans-serif"}
"""What a file says otherwise than a page: names of fonts that other programs know."""

Rules = tuple[tuple[str, Mapping[str, str]], ...]


def css() -> str:
    """The rules for a page, which resolves their variables by its theme."""
    return "\n".join(
        f"svg {selector} {{ {' '.join(f'{name}: {value};' for name, value in found.items())} }}"
        for selector, found in _rules()
    )


@cache
def resolved() -> Rules:
    """The rules in the light theme, as (selector, attributes) in order: without variables and units."""
    theme = {**palette.theme(dark=False), **_FOR_FILES}
    return tuple(
        (selector, {name: _plain(value, theme) for name, value in found.items()}) for selector, found in _rules()
    )


def standalone(svg: str, hatch: str) -> str:
    """A figure as a file of its own: colours of the light theme in its elements, a ground, and nothing outside it.

    svg    as the figure's module draws it
    hatch  the pattern of exact zeros, an element of its own; put in where the figure uses it
    """
    root = ET.fromstring(svg)
    _, _, width, height = root.attrib["viewBox"].split()
    root.attrib.pop("style", None)
    root.attrib.update(width=width, height=height)
    root.insert(0, ET.Element("rect", {"width": width, "height": height, "class": "page"}))
    if any("zero" in _classes(e) for e in root.iter()):
        defs = ET.Element("defs")
        defs.extend(ET.fromstring(hatch).iter("pattern"))
        root.insert(0, defs)
    for selector, attributes in resolved():
        for one in root.iter():
            if one.tag == selector or (selector[0] == "." and selector[1:] in _classes(one)):
                one.attrib.update(attributes)
    root.set("xmlns", _NAMESPACE)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _classes(element: ET.Element) -> list[str]:
    return element.get("class", "").split()


@cache
def _rules() -> Rules:
    found = []
    for line in _RULES.replace("PALETTE", palette.rules()).strip().splitlines():
        selectors, _, body = line.rstrip(" }").partition(" { ")
        pairs = (part.partition(":") for part in body.split(";") if part.strip())
        found.append((selectors, {name.strip(): value.strip() for name, _, value in pairs}))
    return tuple(found)


def _plain(value: str, theme: Mapping[str, str]) -> str:
    filled = re.sub(r"var\(--([\w-]+)\)", lambda found: theme[found[1]], value)
    return re.sub(r"(?<=\d)px$", "", filled)
