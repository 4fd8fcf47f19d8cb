"""Which recordings belong together: by what they hold, never by their names."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from evaluator.recording import Recording
from schemas.provenance import REAL


@dataclass(frozen=True)
class GroupKey:
    """What the runs of a group have in common.

    Two runs of one key were asked for the same, on the same device, with the same settings, versions of what computes,
    GPU driver and environment variables; only how long and how densely states were captured may differ.

    simulator, version  of the engine; the version is empty where the run ended before the engine said it
    device              that steps, by name
    scene, scene_hash   name and SHA-256 of the description
    n_env, dt, seed     as asked; dt in seconds
    warmup, timed_steps protocol of the throughput phase, 0 where it was left out
    options             of the engine in force, JSON; as asked where the run ended before the engine said them
    switches            determinism switches and precision in force, JSON
    conditions          environment variables, versions and driver that can change numbers, JSON
    layout              names, shapes, precision and frames of the state fields, and the env origins, JSON
    """

    simulator: str
    version: str
    device: str
    scene: str
    scene_hash: str
    n_env: int
    dt: float
    seed: int
    warmup: int
    timed_steps: int
    options: str
    switches: str
    conditions: str
    layout: str


@dataclass(frozen=True)
class Group:
    """Recordings of one key, in order of run index and time; `complete` are those that metrics are computed from."""

    key: GroupKey
    recordings: tuple[Recording, ...]

    @property
    def complete(self) -> tuple[Recording, ...]:
        """The runs that ended well and lost nothing."""
        return tuple(r for r in self.recordings if r.usable)

    @property
    def measured(self) -> bool:
        """Whether these are real trials."""
        return self.key.simulator == REAL


def status_notes(group: Group) -> list[str]:
    """What a reader must know of the runs that no metric is computed from."""
    notes = []
    for recording in group.recordings:
        run = f"run {recording.configuration.run_index}"
        if recording.status != "complete":
            notes.append(f"{run} is {recording.status}: {recording.reason}")
        notes += [f"{run} lost data: {lost}" for lost in recording.dropouts]
    return notes


def key_of(recording: Recording) -> GroupKey:
    """The key of one recording."""
    c = recording.configuration
    simulation = recording.simulation
    timed = "timed" in c.phases
    return GroupKey(
        simulator=c.simulator,
        version=simulation.version if simulation else "",
        device=_device(recording),
        scene=c.scene,
        scene_hash=str(simulation.scene.get("sha256", "")) if simulation else "",
        n_env=c.n_env,
        dt=c.dt,
        seed=c.seed,
        warmup=c.warmup if timed else 0,
        timed_steps=c.timed_steps if timed else 0,
        options=_canonical(simulation.options if simulation else c.options),
        switches=_canonical(simulation.switches) if simulation else "",
        conditions=_canonical(_conditions(recording)),
        layout=_canonical({f.name: [f.dtype, f.frame, len(f.items), f.width] for f in recording.fields})
        + (_canonical({"env_origins": simulation.env_origins}) if simulation else ""),
    )


# which devices are visible is said by the device; these packages carry numbers and do not compute them
_NOT_NUMERIC = ("CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES", "mcap", "protobuf")


def _conditions(recording: Recording) -> dict[str, Any]:
    provenance = recording.provenance
    packages = provenance.software.get("packages", {})
    found = {**provenance.environment, **(packages if isinstance(packages, dict) else {})}
    if provenance.gpus:
        found["driver"] = provenance.gpus[0].get("driver", "")
    return {name: value for name, value in found.items() if name not in _NOT_NUMERIC}


def group(recordings: Sequence[Recording]) -> list[Group]:
    """Recordings by key, in a fixed order.

    A run that failed before its simulator was built joins the group that was asked for the same, if there is one.
    """
    built = {_asked(r): key_of(r) for r in recordings if r.simulation}
    members: dict[GroupKey, list[Recording]] = {}
    for recording in recordings:
        key = key_of(recording)
        if not recording.simulation:
            key = built.get(_asked(recording), key)
        members.setdefault(key, []).append(recording)
    ordered = sorted(members.items(), key=lambda item: _order(item[0]))
    return [
        Group(key, tuple(sorted(found, key=lambda r: (r.configuration.run_index, r.provenance.created_utc))))
        for key, found in ordered
    ]


def labels(groups: Sequence[Group]) -> list[str]:
    """A short unique name for each group: the simulator, and whatever tells it from the others of that simulator."""
    named = []
    for one in groups:
        # a run that failed before it was built knows only what was asked, and would make every default stand out
        built = [g.key for g in groups if g.key.version or not one.key.version]
        rivals = [k for k in built if k.simulator == one.key.simulator and k is not one.key]
        parts = [_shown(name, one.key) for name in _DISTINGUISHING if any(_differs(name, one.key, r) for r in rivals)]
        parts += _changed_settings(one.key, rivals)
        named.append(f"{one.key.simulator} [{', '.join(parts)}]" if parts else one.key.simulator)
    return [label if named.count(label) == 1 else f"{label} #{i + 1}" for i, label in enumerate(named)]


_SHOWN_SETTINGS = 4
_SHOWN_LENGTH = 60

_DISTINGUISHING = ("version", "device", "scene", "scene_hash", "n_env", "dt", "seed", "warmup", "timed_steps")


def _differs(name: str, one: GroupKey, other: GroupKey) -> bool:
    if name == "scene_hash" and one.scene != other.scene:
        return False  # its name says it
    return bool(getattr(one, name) != getattr(other, name))


def _shown(name: str, key: GroupKey) -> str:
    value = getattr(key, name)
    if name == "scene_hash":
        return f"scene {value[:8]}" if value else "scene unknown"
    if name in ("version", "device", "scene"):
        return str(value) or f"no {name}"
    return f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"


def _changed_settings(key: GroupKey, rivals: Sequence[GroupKey]) -> list[str]:
    changed = _changed(_settings(key), [_settings(rival) for rival in rivals])
    # another machine has other packages and variables anyway; beside its name they would only hide what matters
    at_home = [rival for rival in rivals if rival.device == key.device]
    changed += _changed(json.loads(key.conditions), [json.loads(rival.conditions) for rival in at_home])
    more = len(changed) - _SHOWN_SETTINGS
    return [*changed[:_SHOWN_SETTINGS], *([f"and {more} more"] if more > 0 else [])]


def _changed(own: dict[str, Any], others: Sequence[dict[str, Any]]) -> list[str]:
    names = sorted(set(own).union(*others))
    return [_setting(n, own.get(n, "unset")) for n in names if any(other.get(n) != own.get(n) for other in others)]


def _setting(name: str, value: Any) -> str:
    text = f"{name}={value}"
    return text if len(text) <= _SHOWN_LENGTH else f"{text[: _SHOWN_LENGTH - 3]}..."


def _settings(key: GroupKey) -> dict[str, Any]:
    return {**json.loads(key.options), **json.loads(key.switches or "{}")}


def _asked(recording: Recording) -> str:
    return _canonical(replace(recording.configuration, run_index=0).to_json())


def _order(key: GroupKey) -> tuple[Any, ...]:
    return (key.scene, key.simulator == REAL, key.simulator, key.version, key.n_env, key.dt, key.switches, key.options)


def _device(recording: Recording) -> str:
    device = recording.simulation.device if recording.simulation else ""
    if device != "cpu":
        return device
    host = recording.provenance.host
    return f"{host.get('cpu', 'cpu')}, {host.get('usable_threads', '?')} threads"


def _canonical(record: dict[str, Any]) -> str:
    return json.dumps(record, sort_keys=True)
