"""What gsb-record --list shows: simulators, where each is installed, what it can do, and scenes."""

from __future__ import annotations

import textwrap
from dataclasses import fields
from typing import Any

from gpusimbench.recorder.abilities import Ability, listed, titles
from gpusimbench.recorder.environments.store import Prepared, find
from gpusimbench.recorder.options import meanings
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import make_scene, scene_names
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.registry import Entry, simulators
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.text import did_you_mean

Json = dict[str, Any]

_WIDTH = 118
_OPERATIONS = {
    "snapshot": "save and restore the complete state",
    "some": "restore some environments only",
    "reset": "reset some environments only",
    "set_state": "set positions and velocities",
}
"""Those of StateClaims, in words."""


def list_all() -> Json:
    """Everything, as --json prints it."""
    found = {name: _scene(name) for name in scene_names()}
    scenes = [scene for scene in found.values() if isinstance(scene, Scene)]
    return {
        "simulators": [*(_about(entry, scenes) for entry in simulators().values()), _about_real(scenes)],
        "scenes": [_about_scene(name, scene) for name, scene in found.items()],
    }


def text_of(known: Json) -> str:
    """The same for people, in short: two or three lines a simulator."""
    lines = ["simulators"]
    for about in known["simulators"]:
        lines.append(f"  {about['name']:<20} {about['summary']}")
        lines += [f"{'':<23}{line}" for line in _in_short(about, len(known["scenes"]))]
    lines.append("scenes")
    lines += [f"  {scene['name']:<20} {scene['summary'] or scene['problem']}" for scene in known["scenes"]]
    lines.append("gsb-record --list NAME shows a simulator's options and determinism levels, or what a scene needs.")
    return "\n".join(lines)


def about_environment(prepared: Prepared) -> Json:
    """A prepared environment, as --json prints it."""
    return {
        "simulator": prepared.simulator,
        "folder": str(prepared.folder),
        "python": prepared.python,
        "versions": prepared.versions,
        "size_bytes": prepared.size,
        "created_utc": prepared.created,
        "current": prepared.current,
    }


def environment_lines(environment: Json) -> list[str]:
    """The same for people: the folder on a line of its own, since a path may be of any length; then its packages."""
    versions = ", ".join(f"{name} {version}" for name, version in environment["versions"].items())
    stale = "" if environment["current"] else "; outdated, made for other requirements: run --setup again"
    size = environment["size_bytes"] / 1e9
    return [
        f"environment: {environment['folder']} ({size:.2f} GB; Python {environment['python']}){stale}",
        *textwrap.wrap(f"  packages: {versions}", 120, subsequent_indent="    ", break_on_hyphens=False),
    ]


def _about(entry: Entry, scenes: list[Scene]) -> Json:
    installed = not entry.missing()
    prepared = find(entry.name)
    adapter, problem = _adapter(entry)
    abilities: frozenset[Ability] = adapter.offered(adapter.Options()) if adapter else frozenset()
    missing = {scene.name: titles(scene.needs() - abilities) for scene in scenes} if adapter else {}
    refused = _refused(adapter, entry, scenes, abilities) if adapter else {}
    levels = adapter.determinism_levels if adapter and (installed or prepared) else {}
    return {
        "name": entry.name,
        "summary": entry.summary,
        "installed": installed,
        "install": entry.install,
        "needs": entry.needs,
        "environment": about_environment(prepared) if prepared else None,
        "problem": problem,
        "devices": list(entry.devices),
        "precision": list(entry.precision),
        "abilities": titles(abilities),
        "scenes": [name for name, lacks in missing.items() if not lacks],
        "refused": {name: lacks for name, lacks in missing.items() if lacks},
        "refused_on": refused,
        "determinism": {str(level): str(meaning) for level, meaning in levels.items()},
    }


def _refused(adapter: type[Simulator], entry: Entry, scenes: list[Scene], offered: frozenset[Ability]) -> Json:
    # by kind of device, scenes that the engine simulates elsewhere, with the abilities that it does not have there
    if "device" not in getattr(adapter.Options, "__dataclass_fields__", {}):
        return {}
    found: Json = {}
    for device in entry.devices:
        try:
            withheld = adapter.withheld(adapter.Options(device=device)).keys()
        except ValueError:  # a third party's devices have other names than kinds
            continue
        lacks = {scene.name: titles(scene.needs() & withheld) for scene in scenes if scene.needs() <= offered}
        if lacks := {name: missing for name, missing in lacks.items() if missing}:
            found[device] = lacks
    return found


def _about_real(scenes: list[Scene]) -> Json:
    return {
        "name": REAL,
        "summary": "measured trials: a CSV file, or the tosses of cube-toss",
        "installed": True,
        "install": "",
        "needs": "",
        "environment": None,
        "problem": "",
        "devices": [],
        "precision": ["float64"],
        "abilities": [],
        "scenes": [scene.name for scene in scenes if "cubes" in scene.groups()],
        "refused": {},
        "refused_on": {},
        "determinism": {},
    }


def _about_scene(name: str, scene: Scene | UsageError) -> Json:
    if isinstance(scene, UsageError):
        return {"name": name, "summary": "", "problem": str(scene), "needs": []}
    return {"name": name, "summary": scene.summary, "problem": "", "needs": titles(scene.needs())}


def _scene(name: str) -> Scene | UsageError:
    try:
        return make_scene(name)
    except UsageError as error:
        return error


def _adapter(entry: Entry) -> tuple[type[Simulator] | None, str]:
    # what a simulator declares of itself, or why it cannot be read
    try:
        return entry.adapter(), ""
    except UsageError as error:
        return None, str(error)


def details(about: Json) -> list[str]:
    """Where a simulator is installed, its devices, precision and scenes, a line each."""
    lines = _where(about)
    lines += [f"{what}: {', '.join(about[what])}" for what in ("devices", "precision", "scenes") if about[what]]
    lines += [f"not {scene}: it has no {listed(missing)}" for scene, missing in about["refused"].items()]
    return lines + [
        f"not {scene} on {device}: it has no {listed(missing)} there"
        for device, scenes in about["refused_on"].items()
        for scene, missing in scenes.items()
    ]


def _where(about: Json) -> list[str]:
    lines = []
    if about["installed"]:
        lines.append(f"needs {about['needs']}" if about["needs"] else "installed")
    elif about["environment"] is None:
        lines.append(f"not installed: {about['install']}")
    if about["problem"]:
        lines[-1:] = [f"{''.join(lines[-1:])}, but {about['problem']}".removeprefix(", ")]
    if about["environment"] is not None:
        lines += environment_lines(about["environment"])
    return lines


def _in_short(about: Json, scenes: int) -> list[str]:
    """Where it is installed; then its devices and scenes; then its levels, where it has any beside the default."""
    able = "all" if len(about["scenes"]) == scenes else ", ".join(about["scenes"])
    for device, refused in about["refused_on"].items():
        able += f" ({device}: not {', '.join(refused)})"
    told = [f"{what}: {said}" for what, said in (("devices", ", ".join(about["devices"])), ("scenes", able)) if said]
    levels = [f"determinism levels: {', '.join(about['determinism'])}"] if len(about["determinism"]) > 1 else []
    return [*_where(about), *(["; ".join(told)] if told else []), *levels]


def list_one(name: str) -> Json:
    """A simulator with its options, levels and abilities, or a scene with the simulators that run it; as of --json.

    UsageError where there is none of that name, or where its own code cannot be loaded.
    """
    known = list_all()
    for about in known["simulators"]:
        if about["name"] == name:
            return {"simulator": about if name == REAL else {**about, **_simulator(simulators()[name])}}
    if name in scene_names():
        return {"scene": _scene_in_full(name, known)}
    names = [*simulators(), REAL, *scene_names()]
    raise UsageError(f"no simulator or scene is called '{name}'; known: {', '.join(names)}{did_you_mean(name, names)}")


def lines_of(known: Json) -> list[str]:
    """What `list_one` tells, as lines for people."""
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
            {"level": level, "sets": sets, "effect_here": level not in none, "reason": none.get(level, "")}
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


def _scene_in_full(name: str, known: Json) -> Json:
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
    return f"{level['sets']}. NO EFFECT on this machine ({device}): {level['reason']}"


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
