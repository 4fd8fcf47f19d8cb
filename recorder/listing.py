"""What gsb-record --list shows: simulators, where each is installed, what it can do, and scenes."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.environments.store import Prepared, find
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import make_scene, scene_names
from gpusimbench.recorder.simulators.registry import Entry, simulators
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import REAL

Json = dict[str, Any]


def list_all() -> Json:
    """Everything, as --json prints it."""
    scenes = {name: _scene(name) for name in scene_names()}
    measurable = [name for name, scene in scenes.items() if isinstance(scene, Scene) and "cubes" in scene.groups()]
    return {
        "simulators": [*(_about(entry) for entry in simulators().values()), _about_real(measurable)],
        "scenes": [
            {"name": name, "summary": scene.summary if isinstance(scene, Scene) else "", "problem": _problem(scene)}
            for name, scene in scenes.items()
        ],
    }


def text_of(known: Json) -> str:
    """The same for people."""
    lines = ["simulators"]
    for about in known["simulators"]:
        lines.append(f"  {about['name']:<20} {about['summary']}")
        lines += [f"{'':<23}{line}" for line in _abilities(about)]
    lines.append("scenes")
    lines += [f"  {scene['name']:<20} {scene['summary'] or scene['problem']}" for scene in known["scenes"]]
    return "\n".join(lines)


def about_environment(prepared: Prepared) -> Json:
    """A prepared environment, as --json prints it."""
    return {
        "simulator": prepared.simulator,
        "folder": str(prepared.folder),
        "python": prepared.python,
        "versions": prepared.versions,
        "size": prepared.size,
        "created": prepared.created,
        "current": prepared.current,
    }


def environment_line(environment: Json) -> str:
    """The same for people."""
    versions = ", ".join(f"{name} {version}" for name, version in environment["versions"].items())
    stale = "" if environment["current"] else "; of other requirements than this version's: set it up anew"
    size = environment["size"] / 1e9
    return f"environment: {environment['folder']} ({size:.2f} GB; Python {environment['python']}; {versions}){stale}"


def _about(entry: Entry) -> Json:
    installed = not entry.missing()
    prepared = find(entry.name)
    levels, problem = _determinism(entry) if installed or prepared else ({}, "")
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
        "scenes": list(entry.scenes),
        "determinism": levels,
    }


def _about_real(scenes: list[str]) -> Json:
    return {
        "name": REAL,
        "summary": "measured trials from a CSV file",
        "installed": True,
        "install": "",
        "needs": "",
        "environment": None,
        "problem": "",
        "devices": [],
        "precision": ["float64"],
        "scenes": scenes,
        "determinism": {},
    }


def _scene(name: str) -> Scene | UsageError:
    try:
        return make_scene(name)
    except UsageError as error:
        return error


def _problem(scene: Scene | UsageError) -> str:
    return "" if isinstance(scene, Scene) else str(scene)


def _determinism(entry: Entry) -> tuple[dict[str, str], str]:
    # levels of a simulator, or why its adapter does not tell
    try:
        adapter = entry.adapter()
        return {str(level): str(meaning) for level, meaning in adapter.determinism_levels.items()}, ""
    except UsageError as error:
        return {}, str(error)


def _abilities(about: Json) -> list[str]:
    lines = []
    if about["installed"]:
        lines.append(f"needs {about['needs']}" if about["needs"] else "installed")
    elif about["environment"] is None:
        lines.append(f"not installed: {about['install']}")
    if about["problem"]:
        lines[-1:] = [f"{''.join(lines[-1:])}, but {about['problem']}".removeprefix(", ")]
    if about["environment"] is not None:
        lines.append(environment_line(about["environment"]))
    lines += [f"{what}: {', '.join(about[what])}" for what in ("devices", "precision", "scenes") if about[what]]
    return lines + [f"--determinism {level}: {meaning}" for level, meaning in about["determinism"].items()]
