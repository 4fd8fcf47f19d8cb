"""The laws of the scene four-bar: a loop that stays closed, Freudenstein's equation, the energy and the period."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import FourBar, wrapped
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import cycles, fewest_periods, joints_of
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.evaluator.statistics.cases import variation
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

_LARGE = 1e6
_SMALL = 1e-9
_NUDGE = 1e-4  # share of a parameter by which its effect is measured


def four_bar_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured; DamagedRecording where the scene does not describe such a linkage."""
    found = joints_of(recording)
    if isinstance(found, Missing):
        return found
    time, joint, turning = found
    bars = _described(recording)
    if joint.shape[2] != len(bars.inertia):
        raise DamagedRecording(f"{joint.shape[2]} joints were recorded, and a four-bar linkage has three")
    angle, speed = _of_links(joint), _of_links(turning)
    energy = bars.energy(angle[..., 1] - angle[..., 0], *np.moveaxis(speed, -1, 0))
    if not (energy[0] > 0.0).all():
        return Missing("a linkage starts at rest")
    dt, epsilon = recording.configuration.dt, float(np.finfo(recording.state("robot", "qpos").field.dtype).eps)
    # one step along the tangents parts the ends of the links by this much
    towards = bars.towards_axes(energy[0])
    parted = dt**2 * float(towards.mean())
    parted += epsilon * float(np.abs(angle).max()) * (bars.crank + bars.coupler + bars.rocker)
    # a recording with other initial states has another tolerance: its environments' own differ by this share
    uneven = variation(towards)
    return (
        _gap(bars, angle, parted, uneven),
        *_angles(bars, angle, parted, uneven),
        _energy(bars, time, energy, turning, dt),
        _period(bars, time, angle[..., 0], energy[0], dt),
    )


def _gap(bars: FourBar, angle: Array, parted: float, uneven: float) -> LawValues:
    gap = bars.gap(*np.moveaxis(angle, -1, 0)).max(axis=0)
    return LawValues(
        "gap", "largest gap of the loop", "m", tuple(map(float, gap)), (0.0,) * len(gap), parted,
        "dt^2 times the links' accelerations towards their axes, and rounding",
        (("mass", 0.0), ("coupler's length", bars.coupler)), uneven=(("coupler's length", uneven),),
    )  # fmt: skip


def _angles(bars: FourBar, angle: Array, parted: float, uneven: float) -> list[LawValues]:
    crank = angle[..., 0]
    expected = bars.angles(crank)
    least = float(np.abs(np.sin(expected[1] - expected[0])).min())
    made = []
    # what a link's own length does to its angle changes sign in a turn; what that of the other one does hardly varies
    links = (("coupler", "rocker", bars.coupler), ("rocker", "coupler", bars.rocker))
    for index, (name, other, length) in enumerate(links):
        longer, shorter = (_lengthened(bars, other, 1.0 + share).angles(crank)[index] for share in (_NUDGE, -_NUDGE))
        off = wrapped(angle[..., index + 1] - expected[index]).mean(axis=0)
        mean = expected[index].mean(axis=0)
        slope = float(wrapped(longer - shorter).mean()) / (2.0 * _NUDGE)
        made.append(
            LawValues(
                f"{name}_angle", f"mean angle of the {name} for the crank's angles", "rad",
                tuple(map(float, mean + off)), tuple(map(float, mean)), parted / (length * least),
                "tolerance of the gap over the link's length and the sine of the transmission angle",
                (("mass", 0.0), (f"{other}'s length", slope)), uneven=((f"{other}'s length", uneven),),
            )
        )  # fmt: skip
    return made


def _lengthened(bars: FourBar, link: str, factor: float) -> FourBar:
    """The linkage with that many times the length of a link."""
    coupler, rocker = (
        (bars.coupler * factor, bars.rocker) if link == "coupler" else (bars.coupler, bars.rocker * factor)
    )
    return replace(bars, coupler=coupler, rocker=rocker)


def _energy(bars: FourBar, time: Array, energy: Array, joint: Array, dt: float) -> LawValues:
    window = float(bars.period(energy[0]).mean())
    first, last = time <= time[0] + window, time >= time[-1] - window
    before = energy[first].mean(axis=0)
    short = time[-1] - time[0] < 2.0 * window
    changed = np.full(len(before), math.nan) if short else energy[last].mean(axis=0) / before - 1.0
    lost = float(((joint**2).sum(axis=-1).mean(axis=0) * (time[-1] - time[0] - window) / before).mean())
    return LawValues(
        "energy_change", f"energy of the linkage, last above first {window:.3g} s, over it", "",
        tuple(map(float, changed)), (0.0,) * len(changed), dt / window + (2.0 * math.pi * dt / window) ** 2,
        "dt / T + (2 pi dt / T)^2", (("mass", 0.0), ("damping", 0.0 if short else -lost)),
        f"less than {2.0 * window:.3g} s were recorded",
    )  # fmt: skip


def _period(bars: FourBar, time: Array, crank: Array, energy: Array, dt: float) -> LawValues:
    expected = bars.period(energy)
    found = [cycles(time, np.sin(crank[:, env])) for env in range(crank.shape[1])]
    # a linkage with another rocker begins with the same speed of the crank, and so with another energy
    speed = np.sqrt(energy / bars.energy_at(crank[0], np.ones_like(energy)))
    heavier, lighter = (_heavier(bars, 1.0 + share) for share in (_NUDGE, -_NUDGE))
    periods = [other.period(other.energy_at(crank[0], speed)) for other in (heavier, lighter)]
    slope = float((periods[0] - periods[1]).mean()) / (2.0 * _NUDGE)
    return LawValues(
        "period", "period of the crank", "s",
        tuple(one for one, _ in found), tuple(map(float, expected)),
        dt / fewest_periods(found), "dt over the turns measured",
        (("mass", 0.0), ("rocker's mass", slope)), "no whole turn was recorded",
    )  # fmt: skip


def _heavier(bars: FourBar, factor: float) -> FourBar:
    """The linkage with a rocker of that many times the mass."""
    crank, coupler, rocker = bars.inertia
    return replace(bars, inertia=(crank, coupler, rocker * factor))


def _of_links(joint: Array) -> Array:
    """Of the links, from the ground [..., 3], from those of the joints: the coupler's is relative to the crank's."""
    return np.stack([joint[..., 0], joint[..., 0] + joint[..., 1], joint[..., 2]], axis=-1)


def _described(recording: Recording) -> FourBar:
    """The linkage of the scene, which lies level, with axes and centres of mass on the links' lines."""
    scene = recording.scene
    x, y, _ = checks.vector(scene.get("gravity"), 3, "gravity")
    robot = checks.mapping(scene, "robot")
    loop, links = checks.mapping(robot, "loop"), checks.objects(robot, "links")
    moving = [link for link in links if link.get("joint") is not None]
    names = [checks.text(link, "name") for link in moving]
    level = all(checks.vector(link.get("orientation"), 4, "an orientation") == (1.0, 0.0, 0.0, 0.0) for link in links)
    if x or y or not level or len(moving) != 3 or names[1:] != [loop.get("coupler"), loop.get("rocker")]:
        raise DamagedRecording("a four-bar linkage has a crank, a coupler and a rocker, and lies level")
    lengths = {
        "crank": _along(moving[1].get("position")),
        "ground": _along(moving[2].get("position")) - _along(moving[0].get("position")),
        "coupler": _along(loop.get("on_coupler")),
        "rocker": _along(loop.get("on_rocker")),
    }
    solids = [_solid(link) for link in moving]
    if not all(_SMALL < length < _LARGE for length in lengths.values()):
        raise DamagedRecording("a four-bar linkage has links of positive lengths")
    about = (solids[0][2], solids[1][2], solids[2][2])
    bars = FourBar(**lengths, inertia=about, mass=solids[1][0], centre=solids[1][1])
    if not bars.turns():
        raise DamagedRecording("the crank of this linkage cannot turn all the way round")
    return bars


def _along(place: Any) -> float:
    """The x of a place on its link's line."""
    x, y, _ = checks.vector(place, 3, "a place on a link")
    if y:
        raise DamagedRecording("the axes of a four-bar linkage lie on the links' lines")
    return x


def _solid(link: dict[str, Any]) -> tuple[float, float, float]:
    """Mass [kg], distance of its centre from the link's axis [m], and moment of inertia about that axis [kg m2]."""
    inertial = checks.mapping(link, "inertial")
    mass, centre = checks.number(inertial, "mass", _SMALL, _LARGE), _along(inertial.get("centre"))
    own = checks.vector(inertial.get("inertia"), 6, "moments of inertia")[2]
    if not (0.0 < own < _LARGE and abs(centre) < _LARGE):
        raise DamagedRecording("a link's moment of inertia is positive")
    return mass, centre, own + mass * centre**2
