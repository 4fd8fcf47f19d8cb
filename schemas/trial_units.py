"""Whether measured positions can be in the unit that they are said to be in: held against the extent of the scene.

A file of centimetres read as metres puts every cube metres beside the board; one of metres read as centimetres puts all
of them into one place.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.schemas import checks

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Of a unit that measured positions may be in."""

_Planar = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Extent:
    """Where bodies of a group should come to lie, seen from above.

    what  that is: "the board" or "the scene"
    low   its smallest x and y [m]
    high  its largest
    edge  smallest edge of a box of the group [m]; 0 where it has none
    """

    what: str
    low: tuple[float, float]
    high: tuple[float, float]
    edge: float

    @property
    def side(self) -> float:
        """The longer of its sides [m]."""
        return max(self.high[0] - self.low[0], self.high[1] - self.low[1])


@dataclass(frozen=True)
class UnitDoubt:
    """Why positions do not look as if they were in their unit.

    text   names the trials, what is odd, and the unit that would fit
    wrong  whether the unit cannot be right; otherwise a reader should look
    """

    text: str
    wrong: bool


def extent_of(scene: Mapping[str, Any], group: str) -> Extent | None:
    """The board's rectangle, or, without a board, that of all bodies at the start, with their height as a margin.

    None for a scene without bodies of finite size. DamagedRecording where the description cannot be read.
    """
    bodies = checks.objects(scene, "bodies")
    shaped = [(b, checks.mapping(b, "shape"), checks.vector(b.get("position"), 3, "a body's position")) for b in bodies]
    boxes = [checks.vector(s.get("size"), 3, "a box's size") for b, s, _ in shaped if _is_box(b, s, group)]
    edge = min((min(size) for size in boxes), default=0.0)
    for body, shape, (x, y, _) in shaped:
        if scene.get("board") and body.get("name") == scene["board"]:
            length, width, _ = checks.vector(shape.get("size"), 3, "the board's size")
            return Extent("the board", (x - length / 2, y - width / 2), (x + length / 2, y + width / 2), edge)
    reached = [(at, reach_of(shape)) for _, shape, at in shaped if shape.get("kind") != "plane"]
    if not reached:
        return None
    margin = max(0.0, *(z + reach for (_, _, z), reach in reached))
    low = [min(at[axis] - reach for at, reach in reached) - margin for axis in (0, 1)]
    high = [max(at[axis] + reach for at, reach in reached) + margin for axis in (0, 1)]
    return Extent("the scene", (low[0], low[1]), (high[0], high[1]), edge)


def unit_doubt(positions: npt.NDArray[Any], unit: str, names: Sequence[str], extent: Extent) -> UnitDoubt | None:
    """What speaks against the unit of some trials; None where nothing does.

    A trial fits where at least half of its bodies are within the extent, and not on top of each other: a rectangle
    around all of them has room for n boxes in max(3, n / 2) layers. Where it does not fit, and would in another unit,
    its unit is wrong if its bodies are on top of each other, or half of them further from the extent than that is long.

    positions  of the bodies [m], shape [trial, item, 2 or more]
    unit       that they were given in, a key of METRES
    names      of the trials
    """
    planar = np.asarray(positions, dtype=np.float64)[..., :2]
    odd = [(name, trial) for name, trial in zip(names, planar, strict=True) if _odd(trial, extent)]
    if not odd:
        return None
    fitting = [_fitting(trial, unit, extent) for _, trial in odd]
    wrong = [bool(other) and _clearly(trial, extent) for (_, trial), other in zip(odd, fitting, strict=True)]
    first = wrong.index(True) if any(wrong) else 0
    others = f" (and {len(odd) - 1} more of {len(names)})" if len(odd) > 1 else ""
    would = f"; {fitting[first]} would fit" if fitting[first] else ""
    asked = f"{unit} cannot be its unit" if wrong[first] else f"{unit} may not be its unit"
    return UnitDoubt(f"trial {odd[first][0]}{others}: {_reason(odd[first][1], extent)}: {asked}{would}", any(wrong))


def _fitting(planar: _Planar, unit: str, extent: Extent) -> str:
    """The largest other unit in which they would fit; empty where none is."""
    others = (other for other in METRES if other != unit)
    return next((other for other in others if not _odd(planar * (METRES[other] / METRES[unit]), extent)), "")


def _odd(planar: _Planar, extent: Extent) -> bool:
    return _median_beside(planar, extent) > 0 or _heaped(planar, extent)


def _clearly(planar: _Planar, extent: Extent) -> bool:
    return _median_beside(planar, extent) > extent.side or _heaped(planar, extent)


def _median_beside(planar: _Planar, extent: Extent) -> float:
    outside = np.maximum(np.maximum(np.array(extent.low) - planar, planar - np.array(extent.high)), 0.0)
    return float(np.median(np.hypot(outside[:, 0], outside[:, 1])))


def _heaped(planar: _Planar, extent: Extent) -> bool:
    if extent.edge <= 0:
        return False
    with np.errstate(over="ignore"):  # an edge that is next to nothing makes room for any number
        columns = float(np.prod(np.ptp(planar, axis=0) / extent.edge + 1.0))
    return len(planar) / columns > max(3.0, len(planar) / 2)


def _reason(planar: _Planar, extent: Extent) -> str:
    if _heaped(planar, extent):
        x, y = np.ptp(planar, axis=0)
        return f"its {len(planar)} bodies with edges of {extent.edge:g} m lie within {x:.2g} m by {y:.2g} m"
    return f"half of its bodies lie {_median_beside(planar, extent):.3g} m or more beside {extent.what}"


def _is_box(body: Mapping[str, Any], shape: Mapping[str, Any], group: str) -> bool:
    return body.get("group") == group and shape.get("kind") == "box"


def reach_of(shape: Mapping[str, Any], *, most: float = sys.float_info.max) -> float:
    """How far a box, sphere or capsule reaches from its centre [m]; 0 of another shape.

    DamagedRecording where a size is unreadable, or a radius or length is above `most` [m].
    """
    if shape.get("kind") == "box":
        return math.hypot(*checks.vector(shape.get("size"), 3, "a box's size")) / 2
    sizes = {"sphere": (("radius", 1.0),), "capsule": (("radius", 1.0), ("length", 0.5))}
    parts = sizes.get(str(shape.get("kind")), ())
    return sum(share * checks.number(shape, name, 0.0, most) for name, share in parts)
