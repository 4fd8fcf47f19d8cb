"""What gsb-record --list NAME shows: one simulator, or one scene, whole."""

from __future__ import annotations

import textwrap
from dataclasses import fields
from typing import Any

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.command.listing import details, list_all
from gpusimbench.recorder.options import meanings
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.scenes.registry import make_scene, scene_names
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.registry import Entry, simulators
from gpusimbench.schemas.commands.suggestion import did_you_mean
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import REAL

Json = dict[str, Any]

_WIDTH = 118


_OPERATIONS = {
    "snapshot": "save and restore the complete state",
    "some": "restore some environments only",
    "reset": "reset some environments only",
    "set_state": "set positions and velocities",
}
"""Those of StateClaims, in words."""


def list_one(name: str) -> Json:
    """A simulator with its options, levels and abilities, or a scene with the simulators that run it; as of --json.

    UsageError where there is none of that name, or where its own code cannot be loaded.
    """
    known = list_all()
    for about in known["simulators"]:
        if about["name"] == name:
            return {"simulator": about if name == REAL else {**about, **_simulator(simulators()[name])}}
    if name in scene_names():
        return {"scene": _scene(name, known)}
    names = [*simulators(), REAL, *scene_names()]
    raise UsageError(f"no simulator or scene is called '{name}'; known: {', '.join(names)}{did_you_mean(name, names)}")


def lines_of(known: Json) -> list[str]:
    """The same for people."""
    return _lines_of_scene(known["scene"]) if "scene" in known else _lines_of_simulator(known["simulator"])


def _simulator(entry: Entry) -> Json:
    adapter = entry.adapter()
    device = _device(entry, adapter)
    none = adapter.levels_without_effect.get(device, {})
    claims = adapter.state_claims(adapter.Options())
    return {
        "device_here": device,
        "options": _options(adapter),
        "distribution": adapter.distribution,
        "across_releases": adapter.across_releases,
        "state": {field.name: str(getattr(claims, field.name)) for field in fields(claims)},
        "levels": [
            {"level": level, "sets": sets, "effect_here": level not in none, "why_none": none.get(level, "")}
            for level, sets in adapter.determinism_levels.items()
        ],
    }


def _options(adapter: type[Simulator]) -> list[Json]:
    means = meanings(adapter.Options)
    return [
        {
            "name": field.name,
            "type": field.type if isinstance(field.type, str) else field.type.__name__,
            "default": field.default,
            "meaning": means.get(field.name, ""),
        }
        for field in fields(adapter.Options)
    ]


def _device(entry: Entry, adapter: type[Simulator]) -> str:
    """The kind of device that the simulator steps on here without an option; empty where nobody knows."""
    wanted = next((str(f.default) for f in fields(adapter.Options) if f.name == "device"), "auto")
    if wanted in entry.devices:
        return wanted
    with Gpus() as gpus:
        here = "cuda" if len(gpus) else "cpu"
    return here if here in entry.devices else next(iter(entry.devices), "")


def _scene(name: str, known: Json) -> Json:
    scene = make_scene(name)
    (about,) = (about for about in known["scenes"] if about["name"] == name)
    groups = {group: len(bodies) for group, bodies in scene.groups().items()}
    return {
        **about,
        "dt": scene.dt,
        "sample_time": scene.sample_time,
        "groups": groups,
        "simulators": [s["name"] for s in known["simulators"] if name in s["scenes"]],
    }


def _lines_of_simulator(about: Json) -> list[str]:
    lines = [f"{about['name']}: {about['summary']}", *details(about)]
    if about["name"] == REAL:
        return lines
    if about["device_here"]:
        lines.append(f"device on this machine: {about['device_here']}")
    if about["abilities"]:
        means = {ability.title: ability.meaning for ability in Ability}
        lines += ["", "abilities:", *_table([(title, means[title]) for title in about["abilities"]])]
    rows = [(f"{o['name']}={_shown(o['default'])}", f"{o['type']}: {o['meaning']}") for o in about["options"]]
    lines += ["", "options with defaults (--option NAME=VALUE):", *(_table(rows) or ["  none"])]
    rows = [(_OPERATIONS[name], claim) for name, claim in about["state"].items()]
    lines += ["", "operations on the state, with default options:", *_table(rows)]
    levels = [(level["level"], _level(level, about["device_here"])) for level in about["levels"]]
    return [*lines, "", "determinism levels (--determinism LEVEL):", *_table(levels)]


def _level(level: Json, device: str) -> str:
    if level["effect_here"] or not device:
        return str(level["sets"])
    return f"{level['sets']}. NO EFFECT on this machine ({device}): {level['why_none']}"


def _lines_of_scene(scene: Json) -> list[str]:
    groups = [f"{group} ({count})" for group, count in scene["groups"].items()]
    return [
        f"{scene['name']}: {scene['summary']}",
        f"dt: {scene['dt']:g} s; positions are compared at {scene['sample_time']:g} s",
        *([f"groups of the state: {', '.join(groups)}"] if groups else ()),
        f"needs: {', '.join(scene['needs'])}",
        f"simulators: {', '.join(scene['simulators'])}",
    ]


def _table(rows: list[tuple[str, str]]) -> list[str]:
    column = min(34, max((len(name) for name, _ in rows), default=0)) + 4
    lines: list[str] = []
    for name, meaning in rows:
        first = f"  {name:<{column - 2}}" if len(name) + 4 <= column else f"  {name}  "
        lines += textwrap.wrap(
            meaning, _WIDTH, initial_indent=first, subsequent_indent=" " * column, break_on_hyphens=False
        )
    return lines


def _shown(default: object) -> str:
    return (
        {True: "on", False: "off", "": "(empty)"}.get(default, str(default))
        if isinstance(default, bool | str)
        else str(default)
    )
