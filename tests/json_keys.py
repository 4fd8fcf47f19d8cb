"""The keys of the JSON of commands, and the list of them that a version promises."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gpusimbench.schemas.commands import SCHEMA_VERSION

KEPT = Path(__file__).resolve().parent / "golden" / "keys.json"

NAMES = {"metrics", "options", "switches", "memory_models", "checks", "by_rule", "protocol_not_met", "radar", "values",
         "scenes", "failed"}  # fmt: skip
"""Keys whose objects have names of metrics, options, rules, groups and scenes."""

TWICE = {"radar", "refused_on"}
"""Keys whose objects have names that have names."""

NAMES_OF = {
    "bisect": {"files", "tested"},
    "fit": {"start", "fitted"},
    "info": {
        "attachments", "chunks", "clocks", "counters", "hardware", "hashes", "integrity", "memory", "phases", "program",
        "unchecked",
    },
    "record": {"across_releases", "determinism", "groups", "refused", "state", "versions"},
    "run": {"peaks_bytes"},
    "verify": {"written_by"},
}  # fmt: skip
"""The same of one command."""

FOREIGN = {"audit": {"replay_of"}, "info": {"provenance", "simulation"}, "leaderboard": {"replay_of"}}
"""Keys whose objects stand in the recording as they are: schemas/README.md says what they have."""

_TYPES = {bool: "bool", int: "number", float: "number", str: "text", type(None): "null"}
Keys = dict[str, list[str]]


def keys_of(documents: Iterable[Any], command: str = "") -> Keys:
    """The path of each key with the types of its values; `[]` is each entry of a list, `*` each name.

    command  what wrote the documents, if it has names of its own
    """
    found: dict[str, set[str]] = {}
    names = NAMES | NAMES_OF.get(command, set())

    def gather(value: Any, place: str, named: int) -> None:
        if isinstance(value, dict):
            for key, below in value.items():
                within = f"{place}.*" if named else f"{place}.{key}".lstrip(".")
                left = named - 1 if named else 2 if key in TWICE else int(key in names)
                if key in FOREIGN.get(command, ()) and below is not None:
                    found.setdefault(within, set()).add("object")
                else:
                    gather(below, within, left)
        elif isinstance(value, list):
            found.setdefault(place, set()).add("list")
            for each in value:
                gather(each, f"{place}[]", 0)
        else:
            found.setdefault(place, set()).add(_TYPES[type(value)])

    for document in documents:
        gather(document, "", 0)
    return {place: sorted(types) for place, types in sorted(found.items())}


def broken(kept: Keys, found: Keys) -> list[str]:
    """What programs that know the kept keys no longer find: keys that vanished, or whose values have other types."""
    gone = [f"{place} has vanished" for place in kept if place not in found]
    return gone + [
        f"{place} is {' or '.join(found[place])}, was {' or '.join(types)}"
        for place, types in kept.items()
        if found.get(place, types) != types
    ]


def check(command: str, found: Keys) -> list[str]:
    """How the keys of a command break the promise of their version, or are not listed."""
    everything = json.loads(KEPT.read_text(encoding="utf-8"))
    kept: Keys = everything["keys"][command]
    if everything["schema_version"] != SCHEMA_VERSION:
        return [f"{KEPT.name} lists version {everything['schema_version']}: write it anew"]
    wrong = [f"{said}: raise SCHEMA_VERSION" for said in broken(kept, found)]
    return wrong + [f"{place} is new: write {KEPT.name} anew" for place in found if place not in kept]


def write(command: str, found: Keys) -> None:
    """List the keys of a command; refuses to drop a key of the version that is listed already."""
    everything = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {"schema_version": 0, "keys": {}}
    if everything["schema_version"] == SCHEMA_VERSION and (wrong := broken(everything["keys"].get(command, {}), found)):
        raise SystemExit("\n".join([*wrong, "these break programs that read the JSON: raise SCHEMA_VERSION"]))
    everything = {"schema_version": SCHEMA_VERSION, "keys": {**everything["keys"], command: found}}
    lines = [
        f' "{name}": {{\n' + ",\n".join(f"  {json.dumps(key)}: {json.dumps(types)}" for key, types in keys.items())
        + "\n }"
        for name, keys in sorted(everything["keys"].items())
    ]  # fmt: skip
    text = f'{{"schema_version": {SCHEMA_VERSION}, "keys": {{\n' + ",\n".join(lines) + "\n}}\n"
    KEPT.write_text(text, encoding="utf-8")
