"""What groups are called: by what differs within a set and by nothing else; the rest stands in footnotes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from gpusimbench.evaluator.read.described import Described
from gpusimbench.evaluator.runs.groups import GroupKey
from gpusimbench.schemas.configuration import TELLING
from gpusimbench.schemas.provenance import engine_name
from gpusimbench.schemas.text import cut, first, plural
from gpusimbench.schemas.treatment import Intervention
from gpusimbench.schemas.vector import RESET_KEYS, RESET_SEEDS, shown_seeds

Given = Mapping[str, frozenset[str]]
"""By simulator, the names of the options that a user gave for any of its runs."""

NONE_GIVEN: Given = {}

PLACE = ("scene", "device", "n_env")
"""What tables have columns for, and names of rows leave out."""

_SHOWN_SETTINGS = 4
_SHOWN_LENGTH = 60

_ATTRIBUTES = ("version", "device", "scene_hash", "n_env", "dt", "seed", "determinism", *TELLING)

_MEANINGS = (
    ("XLA_PYTHON_CLIENT", "how JAX reserves memory of the GPU; memory is not comparable"),
    ("XLA_", "flags of the XLA compiler; results and throughput may differ for it"),
    ("JAX_", "a setting of JAX; results and throughput may differ for it"),
    ("CUBLAS_", "a setting of cuBLAS; results may differ for it"),
    ("OMP_", "a setting of OpenMP; throughput may differ for it"),
)
_UNKNOWN = "results and throughput may differ for it"


def options_given(recordings: Iterable[Described]) -> Given:
    """Names of the options that a user gave for any of some recordings, by simulator."""
    found: dict[str, frozenset[str]] = {}
    for recording in recordings:
        name = engine_name(recording.configuration.simulator, recording.simulation)
        found[name] = found.get(name, frozenset()) | set(recording.configuration.options)
    return found


def labels(keys: Sequence[GroupKey], given: Given = NONE_GIVEN, *, beside: Collection[str] = ()) -> list[str]:
    """A short unique name for each key: the simulator, and what tells it from its others in the same scene.

    What was asked for comes first: version, device, size and time of the scene, determinism, and options that a user
    gave to this simulator; then the precision of the states. Where these leave two keys alike, settings that nobody
    chose, then the protocol of the throughput phase, and last environment variables and versions of packages tell them
    apart, as few as that needs: what else differs of these stands in `footnotes`. The scene is named where a simulator
    would have the same name in two scenes, or a bare name in one of several; then for all its groups of that scene.

    beside  attributes of keys that stand beside every label, such as n_env in a column of its own: labels leave them
            out, and are unique together with them
    """
    parts = [_parts(key, keys, given.get(key.simulator, frozenset()), beside) for key in keys]
    scenes = set() if "scene" in beside else _scenes_to_name(keys, parts)
    named = []
    for key, found in zip(keys, parts, strict=True):
        shown = [key.scene, *found] if (key.simulator, key.scene) in scenes else found
        named.append(f"{key.simulator} [{', '.join(shown)}]" if shown else key.simulator)
    seen = Counter((label, *(getattr(key, n) for n in beside)) for label, key in zip(named, keys, strict=True))
    return [
        label if seen[label, *(getattr(key, n) for n in beside)] == 1 else f"{label} #{i + 1}"
        for i, (label, key) in enumerate(zip(named, keys, strict=True))
    ]


def parts_of(label: str) -> tuple[str, list[str]]:
    """The simulator, and what tells it from its others, of a name that `labels` made."""
    name, _, parts = label.partition(" [")
    return name, parts.rstrip("]").split(", ") if parts else []


def row_names(keys: Sequence[GroupKey], given: Given, marks: Sequence[str]) -> list[str]:
    """A name for each key in a table with columns of `PLACE`: the simulator, and what tells it from its others.

    Levels of determinism stand without the word. Protocol settings and environment variables are in no name: `marks`,
    one for each key and empty where it has none, point at footnotes that say what they mean. Names are unique together
    with the columns: what is alike in all of that is numbered.
    """
    named = []
    for key, mark in zip(keys, marks, strict=True):
        found = _parts(key, keys, given.get(key.simulator, frozenset()), PLACE, chosen_alone=True)
        shown = ", ".join(part.removeprefix("determinism=") for part in found)
        named.append(" ".join(filter(None, (key.simulator, f"[{shown}]" if shown else "", mark))))
    places = [(name, *(getattr(key, n) for n in PLACE)) for name, key in zip(named, keys, strict=True)]
    return [
        name if places.count(place) == 1 else f"{name} #{places[: i + 1].count(place)}"
        for i, (name, place) in enumerate(zip(named, places, strict=True))
    ]


def short_device(device: str) -> str:
    """A device without what every device of its kind has in its name."""
    return re.sub(r"^(NVIDIA|AMD|Intel)(\(R\))? |\((R|TM)\)| Processor\b|\bGeForce | \d+GB( HBM\w*)?$", "", device)


def footnotes(keys: Sequence[GroupKey]) -> list[tuple[str, ...]]:
    """For each key, sentences on its protocol and environment variables where these differ from its others.

    The protocol of the throughput phase is compared with the most common one of the scene, of all simulators, since
    throughputs are; environment variables with those of the same simulator in the scene on the same device, without
    flags that its level of determinism sets: another device is another machine, with variables of its own.
    """
    usual = {scene: _usual_protocol([k for k in keys if k.scene == scene]) for scene in {k.scene for k in keys}}
    variables = {id(key): _variables(key) for key in keys}
    return [
        (
            *_protocol_note(key, usual[key.scene]),
            *_variable_notes(
                key.simulator,
                variables[id(key)],
                [variables[id(k)] for k in keys if _rivals(key, k) and k.device == key.device],
            ),
        )
        for key in keys
    ]


def _parts(key: GroupKey, keys: Sequence[GroupKey], given: frozenset[str], beside: Collection[str],
           *, chosen_alone: bool = False) -> list[str]:  # fmt: skip
    # a run that failed before it was built knows only what was asked, and would make every default stand out
    rivals = [k for k in keys if _rivals(key, k) and (k.version or not key.version)]
    telling = [name for name in _ATTRIBUTES if any(_told_apart(name, key, rival) for rival in rivals)]
    parts = [_shown(name, key) for name in telling if name not in beside and _value(name, key) not in ("", None)]
    chosen = _chosen(key, given)
    parts += _changed(chosen, [_chosen(rival, given) for rival in rivals])
    alike = [
        r for r in rivals if _chosen(r, given) == chosen and all(_value(n, r) == _value(n, key) for n in _ATTRIBUTES)
    ]
    if any(rival.precisions not in ([], key.precisions) for rival in alike):
        parts += key.precisions
        alike = [rival for rival in alike if rival.precisions in ([], key.precisions)]
    parts += first(_changed(key.parsed_settings, [rival.parsed_settings for rival in alike]), _SHOWN_SETTINGS)
    alike = [rival for rival in alike if rival.parsed_settings == key.parsed_settings]
    for settings in () if chosen_alone else (_protocol, _conditions):
        parts += _fewest(settings(key), [settings(rival) for rival in alike])
        alike = [rival for rival in alike if settings(rival) == settings(key)]
    if "version" in telling and not key.version:
        parts.append("never built")
    return parts


def _told_apart(name: str, key: GroupKey, rival: GroupKey) -> bool:
    if name == "initial" and key.told["initial"] and rival.told["initial"]:
        # states that are given to every environment differ with the number of environments, and with the measured
        # states that environments are set to later: what these follow from tells the two apart
        asked = key.told["intervention"], rival.told["intervention"]
        teaches = any(one is not None and one.kind.repeats for one in map(Intervention.of, asked))
        if key.n_env != rival.n_env or (teaches and len(set(asked)) > 1):
            return False
    return bool(_value(name, key) != _value(name, rival))


def _value(name: str, key: GroupKey) -> Any:
    return (key.told[name] or None) if name in TELLING else getattr(key, name)


def _rivals(one: GroupKey, other: GroupKey) -> bool:
    return (one.simulator, one.scene) == (other.simulator, other.scene) and one is not other


def _scenes_to_name(keys: Sequence[GroupKey], parts: Sequence[list[str]]) -> set[tuple[str, str]]:
    """Simulators and scenes whose groups are named with their scene."""
    scenes: dict[str, set[str]] = {}
    same: dict[tuple[str, ...], set[str]] = {}
    for key, found in zip(keys, parts, strict=True):
        scenes.setdefault(key.simulator, set()).add(key.scene)
        same.setdefault((key.simulator, *found), set()).add(key.scene)
    return {
        (key.simulator, key.scene)
        for key, found in zip(keys, parts, strict=True)
        if len(scenes[key.simulator]) > 1 and (not found or len(same[(key.simulator, *found)]) > 1)
    }


def _shown(name: str, key: GroupKey) -> str:
    value = _value(name, key)
    if name in TELLING:
        return TELLING[name].labelled(name, value)
    if name == "scene_hash":
        return f"scene {value[:8]}"
    if name == "device":
        # what every processor of a maker has in its name tells none apart
        return re.sub(r"\((R|TM)\)| Processor\b", "", value)
    if name == "version":
        return str(value)
    return f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"


def _changed(own: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[str]:
    # what it has comes before what only the others have
    names = sorted(_differing(own, others), key=lambda n: (n not in own, n))
    return [_setting(n, own.get(n, "unset")) for n in names]


def _fewest(own: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[str]:
    """As many settings as tell it from all others, in order of their names, those that it has before the others."""
    left, told = [other for other in others if other != own], []
    for name in sorted(set(own).union(*left), key=lambda name: (name not in own, name)):
        if any(other.get(name) != own.get(name) for other in left):
            told.append(_setting(name, own.get(name, "unset")))
            left = [other for other in left if other.get(name) == own.get(name)]
    return told


def _setting(name: str, value: Any) -> str:
    shown = shown_seeds(name, str(value)) if name in (RESET_KEYS, RESET_SEEDS) else value
    return cut(f"{name}={shown}", _SHOWN_LENGTH)


def _chosen(key: GroupKey, given: frozenset[str]) -> dict[str, Any]:
    return {name: value for name, value in key.parsed_options.items() if name in given}


def _protocol(key: GroupKey) -> dict[str, Any]:
    return {"timed_steps": key.timed_steps, "warmup": key.warmup}


def _conditions(key: GroupKey) -> dict[str, Any]:
    return key.parsed_conditions


def _usual_protocol(keys: Sequence[GroupKey]) -> tuple[int, int] | None:
    """The most common protocol of those that were timed, of equals the longest; None where none was."""
    timed = Counter((key.warmup, key.timed_steps) for key in keys if key.timed_steps)
    return max(timed, key=lambda protocol: (timed[protocol], protocol), default=None)


def _protocol_note(key: GroupKey, usual: tuple[int, int] | None) -> tuple[str, ...]:
    if usual is None or not key.timed_steps or (key.warmup, key.timed_steps) == usual:
        return ()
    return (
        f"timed over {plural(key.timed_steps, 'step', spec=',')} after {key.warmup:,} warm-up steps, others of "
        f"{key.scene} over {usual[1]:,} after {usual[0]:,}: throughput not comparable",
    )


def _variable_notes(simulator: str, own: Mapping[str, str], others: Sequence[Mapping[str, str]]) -> list[str]:
    return [
        f"run with {_setting(name, own.get(name, 'unset'))}, unlike others of {simulator}: {_meaning(name)}"
        for name in sorted(_differing(own, others))
    ]


def _differing(own: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> set[str]:
    """Names of the settings that any other has otherwise, or has alone."""
    left = [other for other in others if other != own]
    return {n for n in set(own).union(*left) if any(other.get(n) != own.get(n) for other in left)}


def _variables(key: GroupKey) -> dict[str, str]:
    """Environment variables, without the flags that the level of determinism sets."""
    by_level = str(key.parsed_settings.get("xla_flags_of_level", "")).split()
    found = {
        name: " ".join(word for word in str(value).split() if word not in by_level)
        for name, value in _conditions(key).items()
        if name.isupper()  # packages and the driver are not
    }
    return {name: value for name, value in found.items() if value}


def _meaning(name: str) -> str:
    return next((meaning for start, meaning in _MEANINGS if name.startswith(start)), _UNKNOWN)
