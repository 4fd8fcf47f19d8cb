"""Which recordings belong together: by what they hold, never by their names."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any, Generic, TypeVar

from gpusimbench.evaluator.read.described import Described
from gpusimbench.schemas.configuration import TELLING, Settings
from gpusimbench.schemas.provenance import REAL, Simulation, engine_name

_D = TypeVar("_D", bound=Described, covariant=True)
_R = TypeVar("_R", bound=Described)


@dataclass(frozen=True)
class GroupKey:
    """What the runs of a group have in common.

    Two runs of one key were asked for the same, on the same device, with the same settings, versions of what computes,
    GPU driver and environment variables; only how long and how densely states were captured may differ.

    simulator, version  of the engine, MODIFIED behind the name where it is not the released one; the version is empty
                        where the run ended before the engine said it
    device              that steps, by name
    scene, scene_hash   name and SHA-256 of the description
    n_env, dt, seed     as asked; dt in seconds
    warmup, timed_steps protocol of the throughput phase, 0 where it was left out
    determinism         level that was asked for
    options             of the engine in force, JSON; as asked where the engine does not say them
    switches            determinism switches and precision in force, JSON
    conditions          environment variables, versions and driver that can change numbers, JSON
    layout              names, shapes, precision and frames of the state fields, JSON
    origins             of the environments, JSON
    settings            what else was asked for that results can depend on: RunConfiguration.settings
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
    determinism: str
    options: str
    switches: str
    conditions: str
    layout: str
    origins: str
    settings: Settings = ()

    # labels ask each key about each other: what they ask for is parsed once
    @cached_property
    def told(self) -> dict[str, Any]:
        """Every setting of TELLING by name, those that are empty included."""
        given = dict(self.settings)
        return {name: given.get(name, setting.key(setting.empty)) for name, setting in TELLING.items()}

    @cached_property
    def parsed_options(self) -> dict[str, Any]:
        """`options` by name."""
        return _parsed(self.options)

    @cached_property
    def parsed_settings(self) -> dict[str, Any]:
        """`switches` and `options` by name; options before switches of one name."""
        return {**_parsed(self.switches), **self.parsed_options}

    @cached_property
    def parsed_conditions(self) -> dict[str, Any]:
        """`conditions` by name."""
        return _parsed(self.conditions)

    @cached_property
    def precisions(self) -> list[str]:
        """Number types of the states; empty where the run ended before they were known."""
        return sorted({dtype for dtype, *_ in _parsed(self.layout).values()})

    def with_settings(self, **values: Any) -> GroupKey:
        """The same key with other settings: by name, each as `told` has it."""
        told = {**self.told, **values}
        return replace(self, settings=tuple((name, value) for name, value in told.items() if value))


@dataclass(frozen=True)
class Group(Generic[_D]):
    """Recordings of one key, in order of run index and time; `complete` are those that metrics are computed from."""

    key: GroupKey
    recordings: tuple[_D, ...]

    @property
    def complete(self) -> tuple[_D, ...]:
        """The runs that ended well and lost nothing."""
        return tuple(r for r in self.recordings if r.usable)

    @property
    def measured(self) -> bool:
        """Whether these are real trials."""
        return self.key.simulator == REAL

    @property
    def outcomes(self) -> dict[str, int]:
        """How many runs are complete, invalid, failed, incomplete, or complete but for lost data; zeros included."""
        found = Counter("lost data" if r.status == "complete" and not r.usable else r.status for r in self.recordings)
        return {name: found[name] for name in ("complete", "invalid", "failed", "incomplete", "lost data")}

    @cached_property
    def asked(self) -> GroupKey:
        """The `settings_asked` of its recordings, which every group is asked for beside every other."""
        return settings_asked(self.recordings)

    @property
    def captured(self) -> bool:
        """Whether any complete run captured states."""
        return any("capture" in r.configuration.phases for r in self.complete)


def shown_status(recording: Described) -> str:
    """A run's status with what kind of thing ended it; INVALID stands out."""
    status = "INVALID" if recording.status == "invalid" else recording.status
    return f"{status} ({recording.cause})" if recording.cause else status


def shown_ending(recording: Described) -> str:
    """The status, and why."""
    return f"{shown_status(recording)}: {beside_cause(recording.cause, recording.reason)}"


def beside_cause(cause: str, reason: str) -> str:
    """The reason as it stands behind the kind of thing that ended a run, which it does not repeat."""
    return reason.removeprefix(f"{cause}: ")


def status_notes(group: Group[Described]) -> list[str]:
    """What a reader must know of runs that no metric is computed from, or that may not be on the disk."""
    found: dict[str, list[int]] = {}
    for recording in group.recordings:
        run = recording.configuration.run_index
        if recording.status != "complete":
            found.setdefault(shown_ending(recording), []).append(run)
        if why := recording.unconfirmed:
            found.setdefault(why, []).append(run)
        for lost in recording.dropouts:
            found.setdefault(f"lost data: {lost}", []).append(run)
    return [_note(what, runs) for what, runs in found.items()]


def _note(what: str, runs: Sequence[int]) -> str:
    one = len(runs) == 1
    said = what if what.startswith("lost data") else f"{'is' if one else 'are'} {what}"
    return f"run{'' if one else 's'} {', '.join(map(str, runs))} {said}"


def key_of(recording: Described) -> GroupKey:
    """The key of one recording."""
    c = recording.configuration
    simulation = recording.simulation
    timed = "timed" in c.phases
    conditions = _conditions(recording)
    return GroupKey(
        simulator=engine_name(c.simulator, simulation),
        version=simulation.version if simulation else "",
        device=_device(recording),
        scene=c.scene,
        scene_hash=str(simulation.scene.get("sha256", "")) if simulation else "",
        n_env=c.n_env,
        dt=c.dt,
        seed=c.seed,
        warmup=c.warmup if timed else 0,
        timed_steps=c.timed_steps if timed else 0,
        determinism=c.determinism,
        options=_canonical(_in_force(_options(c.simulator, simulation, c.options))),
        # the level that was asked for has a place of its own, and so have the versions of packages
        switches=_canonical(_without(simulation.switches, ("determinism", *conditions))) if simulation else "",
        conditions=_canonical(conditions),
        layout=_canonical({f.name: [f.dtype, f.frame, len(f.items), f.width] for f in recording.fields}),
        origins=json.dumps(simulation.env_origins if simulation else []),
        settings=c.settings,
    )


def _options(simulator: str, simulation: Simulation | None, given: Mapping[str, str]) -> Mapping[str, Any]:
    """Those in force, and as they were given those that the engine does not tell: runs that differ in these were asked
    for something else."""
    if simulation is None:
        return given
    buffers = {one.name for one in simulation.buffers}
    told = {*simulation.options, *simulation.switches, *buffers, "device"}
    told |= {option for option, name in TOLD_AS.get(simulator, {}).items() if name in told}
    # a size that nobody asked for follows from the scene and the number of environments
    return {**_without(given, told), **_without(simulation.options, buffers - set(given))}


TOLD_AS = {
    "genesis": {
        "broad_phase_multiplier": "multiplier_collision_broad_phase",
        "broadphase": "broadphase_traversal",
        "cone": "friction_cone",
        "mujoco_compatibility": "enable_mujoco_compatibility",
        "solver": "constraint_solver",
    }
}
"""Options that an engine tells by names of its own, by simulator."""


# what follows from the scene or from the number of environments, and is no choice: rows that wait on the device to be
# read, the form of a matrix
_FOLLOWING = ("ring", "sparse")


def _in_force(options: Mapping[str, Any]) -> dict[str, Any]:
    # an option without a value does nothing, and an older recorder may not have had it
    return {name: value for name, value in _without(options, _FOLLOWING).items() if value is not None}


VARIABLES_WITHOUT_EFFECT = ("CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES", "WARP_CACHE_PATH")
"""Environment variables that change no result: the first two select a GPU, which a recording names anyway, and the
last is the folder of compiled kernels."""

# these packages store numbers, and compute none
_NOT_NUMERIC = (*VARIABLES_WITHOUT_EFFECT, "mcap", "protobuf")

# engines that only these simulators execute: for another simulator, that an engine is installed beside it is no
# condition. Simulators that are not built in may execute any of them.
_EXECUTED_BY: dict[str, tuple[str, ...]] = {
    "brax": ("brax", "playground"),
    "genesis-world": ("genesis",),
    "isaaclab": ("isaaclab",),
    "mani-skill": ("maniskill",),
    "newton": ("newton", "isaaclab"),
    "ovphysx": ("physx", "isaaclab"),
    "ovstage": ("physx", "isaaclab"),
    "playground": ("playground",),
    "quadrants": ("genesis",),
    "sapien": ("sapien", "maniskill"),
    "taichi": ("calibration",),
}
_BUILT_IN = frozenset(("mujoco", "warp", "mjx", "madrona", *chain.from_iterable(_EXECUTED_BY.values())))


def _conditions(recording: Described) -> dict[str, Any]:
    provenance = recording.provenance
    packages = provenance.software.get("packages", {})
    found = {**provenance.environment, **(packages if isinstance(packages, dict) else {})}
    if provenance.gpus:
        found["driver"] = provenance.gpus[0].get("driver", "")
    simulator = recording.configuration.simulator
    idle = [name for name, users in _EXECUTED_BY.items() if simulator in _BUILT_IN and simulator not in users]
    return _without(found, (*_NOT_NUMERIC, *idle))


def _without(settings: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name not in names}


def group(recordings: Sequence[_R]) -> list[Group[_R]]:
    """Recordings by key, in a fixed order.

    A run that failed before its simulator was built joins the group that was asked for the same, if there is one.
    """
    built = {asked(r): key_of(r) for r in recordings if r.simulation}
    members: dict[GroupKey, list[_R]] = {}
    for recording in recordings:
        key = key_of(recording)
        if not recording.simulation:
            key = built.get(asked(recording), key)
        members.setdefault(key, []).append(recording)
    ordered = sorted(members.items(), key=lambda item: _order(item[0]))
    return [
        Group(key, tuple(sorted(found, key=lambda r: (r.configuration.run_index, r.provenance.created_utc))))
        for key, found in ordered
    ]


def asked(recording: Described) -> GroupKey:
    """What is known of a run's key before its simulator is built: enough to tell which runs were asked for the same."""
    host, gpus = recording.provenance.host, recording.provenance.gpus
    machine = [host.get("cpu"), host.get("usable_threads"), *(gpu.get("name") for gpu in gpus)]
    c = recording.configuration
    known = replace(key_of(recording), version="", scene_hash="", switches="", layout="", origins="")
    return replace(known, simulator=c.simulator, device=json.dumps(machine), options=_canonical(c.options))


def settings_asked(recordings: Sequence[Described]) -> GroupKey:
    """What some runs of one group or sweep have in common with those of another scene, step or number of environments.

    With the options that were given: those in force, such as sizes of buffers, may follow from the scene.
    """
    recording = next((r for r in recordings if r.simulation), recordings[0])
    return replace(
        key_of(recording), options=_canonical(recording.configuration.options), scene="", scene_hash="", n_env=0,
        dt=0.0, seed=0, warmup=0, timed_steps=0, layout="", origins="",
    )  # fmt: skip


def is_instrument(key: GroupKey) -> bool:
    """Whether this is a control with a known answer, as its adapter declares it among its switches."""
    return _parsed(key.switches).get("instrument") is True


def _order(key: GroupKey) -> tuple[Any, ...]:
    settings = (key.determinism, *key.told.values(), key.n_env, key.dt, key.switches, key.options)
    return (key.scene, key.simulator == REAL, key.simulator, key.version, *settings)


def _device(recording: Described) -> str:
    device = recording.simulation.device if recording.simulation else ""
    if device != "cpu":
        return device
    host = recording.provenance.host
    return f"{host.get('cpu', 'cpu')}, {host.get('usable_threads', '?')} threads"


def _canonical(record: dict[str, Any]) -> str:
    return json.dumps(record, sort_keys=True)


def _parsed(canonical: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(canonical or "{}")
    return found
