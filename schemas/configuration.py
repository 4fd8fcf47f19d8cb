"""What one run was asked to do: stored in every recording, and enough to run it again."""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import copy
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.initial import Given, Initial, initial_words, parse_initial
from gpusimbench.schemas.treatment import VARIED, Intervention, Keep, Vary

USUAL_PHASES = ("timed", "capture")
"""Phases where nothing says which."""

OPTIONAL_PHASES = (*USUAL_PHASES, "import")
"""Phases that a run can leave out; "warmup" belongs to "timed"."""

CAPTURE_MODES = ("lossless", "memory")
"""When captured states are written: while stepping, which waits where the disk is slower, or all of them afterwards."""

MAX_ENVS = 1 << 24

MAX_VIEW = 4
"""Environments that a recording has a view of, at most."""

EPOCH_NS = 1_000_000_000
"""log_time of simulated time zero: zero itself reads as "no time" in some tools."""


Settings = tuple[tuple[str, Any], ...]
"""Some settings that are not empty, each its name and its key."""


def _text(record: dict[str, Any], name: str) -> str:
    return checks.text(record, name, default="")


def _steps(record: dict[str, Any], name: str) -> tuple[int, ...]:
    return tuple(sorted(checks.whole({name: step}, name, 0, checks.MAX_COUNT) for step in checks.items(record, name)))


def _treatment(parse: Callable[[str], Initial | Given | Vary | Intervention | Keep]) -> Callable[..., str]:
    def read(record: dict[str, Any], name: str) -> str:
        text = _text(record, name)
        try:
            return text and str(parse(text))
        except ValueError:
            raise DamagedRecording(f"{name} has an unknown value: {text[:40]!r}") from None

    return read


def _plain(key: Any) -> str:
    return f"{key:g}" if isinstance(key, float) else str(key)


@dataclass(frozen=True)
class Setting:
    """A value of RunConfiguration that came after the first version of the format.

    The JSON of a recording leaves it out where it is empty: equal to `empty`.

    read    the value that a record has by a name; DamagedRecording where the value is unknown
    title   what reports call the setting; empty where results do not depend on it: runs that differ in nothing else are
            then repetitions. All others belong to the key of a group, its label, the JSON and the page
    empty   the value where nothing was asked for: "", 0 or another value that is false
    bits    whether states depend on it: those of runs that differ in it are then not compared by bits
    key     the value as keys of groups and the JSON of results have it: a text or a number
    words   a key's value as reports show it behind the title
    label   the same within the label of a group; None: NAME=WORDS
    note    what the value means, in a sentence of gsb-info
    """

    read: Callable[[dict[str, Any], str], Any]
    title: str
    empty: Any = ""
    bits: bool = False
    key: Callable[[Any], Any] = lambda value: value
    words: Callable[[Any], str] = _plain
    label: Callable[[Any], str] | None = None
    note: str = ""

    def labelled(self, name: str, key: Any) -> str:
        """The setting of that name within the label of a group."""
        return self.label(key) if self.label else f"{name}={self.words(key)}"


def _setting(read: Callable[[dict[str, Any], str], Any], title: str, **more: Any) -> Any:
    setting = Setting(read, title, **more)
    return field(default_factory=lambda: copy(setting.empty), metadata={"setting": setting})


@dataclass(frozen=True)
class RunConfiguration:
    """Configuration of one run.

    simulator    name in the registry of simulators
    scene        name in the registry of scenes
    n_env        number of identical environments
    dt           simulator step [s]
    steps        last captured step; the scene's first state is step 0. See open_end
    stride       every how many steps a state is recorded; divides `steps`
    warmup       steps before the timed ones, excluded from throughput
    timed_steps  steps that throughput is computed from
    phases       which of OPTIONAL_PHASES happen
    seed         seed of whatever the scene draws at random
    run_index    number of the run within its set, from 0
    compression  of the file's chunks: "none", "lz4" or "zstd"
    options      options of the simulator, by name, as text
    determinism  level that the simulator was asked for; "default" leaves the engine as it ships
    timeout      the run is ended after so many seconds; 0: never
    capture      one of CAPTURE_MODES
    view         environments whose captured states are written as what viewers draw, too
    initial      how environments begin, as of schemas.initial; empty: in the scene's first state. This and
                 all that follow are a Setting each
    vary         which of their parameters differ, as of treatment.Vary; empty: none
    intervention what is done to their state on the way, as of treatment.Intervention; empty: nothing
    keep         which of the captured states are written, as of treatment.Keep; empty: all
    snapshots    captured steps after which the engine's whole state is saved, ascending
    model        SHA-256 of the model's files, which the recording has attached; empty: the scene is a registered one
    keyframe     of the model that environments begin in; empty without a model
    actions      what the model's actuators are given; empty without a model
    fitted       options whose values were fitted to measured motions, by name, each with which these were, such as
                 "even tosses"
    """

    simulator: str
    scene: str
    n_env: int
    dt: float
    steps: int
    stride: int = 1
    warmup: int = 100
    timed_steps: int = 1000
    phases: tuple[str, ...] = USUAL_PHASES
    seed: int = 0
    run_index: int = 0
    compression: str = "none"
    options: dict[str, str] = field(default_factory=dict)
    determinism: str = "default"
    timeout: float = 0.0
    capture: str = CAPTURE_MODES[0]
    view: tuple[int, ...] = ()
    initial: str = _setting(
        _treatment(parse_initial),
        "initial states",
        bits=True,
        words=initial_words,
        label=lambda text: f"initial={re.sub(r'(?<=:[0-9a-f]{8})[0-9a-f]+', '', text)}",
        note="environments do not begin in the scene's first state",
    )
    vary: str = _setting(
        _treatment(Vary.parse), "varied parameters", bits=True, note=f"factors of each environment, in {VARIED}"
    )
    intervention: str = _setting(_treatment(Intervention.parse), "intervention", bits=True)
    keep: str = _setting(_treatment(Keep.parse), "states kept")
    snapshots: tuple[int, ...] = _setting(_steps, "", empty=())
    model: str = _setting(_text, "")
    keyframe: str = _setting(_text, "")
    actions: str = _setting(_text, "")
    fitted: dict[str, str] = _setting(
        checks.text_map,
        "fitted options",
        empty={},
        key=lambda fitted: ", ".join(f"{name} to {data}" for name, data in sorted(fitted.items())),
        label=lambda text: f"fitted {text}",
    )

    @property
    def settings(self) -> Settings:
        """Name and key of each of TELLING that is not empty."""
        found = ((name, setting.key(getattr(self, name))) for name, setting in TELLING.items())
        return tuple((name, key) for name, key in found if key)

    @property
    def option_words(self) -> list[str]:
        """The simulator's options as the command takes them, NAME=VALUE, sorted."""
        return sorted(f"{name}={value}" for name, value in self.options.items())

    @property
    def registered_scene(self) -> str | None:
        """Name of the scene in the registry; None where the run brings a model of its own."""
        return None if self.model else self.scene

    @property
    def varied(self) -> dict[str, float]:
        """The spread of each quantity that differs from environment to environment."""
        return dict(Vary.parse(self.vary).spreads) if self.vary else {}

    @property
    def is_open(self) -> bool:
        """Whether a program writes, or wrote until it was killed, as many steps as it makes."""
        return self.steps == open_end(self.stride)

    @property
    def first_step(self) -> int:
        """The first captured step: 0, or the step of another run that this run continues."""
        how = parse_initial(self.initial) if self.initial else None
        return how.step or 0 if isinstance(how, Given) else 0

    @property
    def captured_steps(self) -> int:
        """Steps that the capture makes."""
        return self.steps - self.first_step

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        record = {**asdict(self), "phases": list(self.phases), "view": list(self.view)}
        record["snapshots"] = list(self.snapshots)
        return {name: value for name, value in record.items() if value or name not in SETTINGS}

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> RunConfiguration:
        """From JSON; keys that this version does not know are ignored, as the format's evolution rules ask.

        DamagedRecording names the first value that is of the wrong kind or size.
        """
        phases = checks.texts(record, "phases")
        if not set(phases) <= set(OPTIONAL_PHASES):
            raise DamagedRecording(f"phases are not among {OPTIONAL_PHASES}: {phases}")
        timed = "timed" in phases
        n_env = checks.whole(record, "n_env", 1, MAX_ENVS)
        made = cls(
            simulator=checks.text(record, "simulator"),
            scene=checks.text(record, "scene"),
            n_env=n_env,
            dt=checks.number(record, "dt", 1e-9, 1e9),
            steps=checks.whole(record, "steps", 1, checks.MAX_COUNT),
            stride=checks.whole(record, "stride", 1, checks.MAX_COUNT, default=1),
            warmup=checks.whole(record, "warmup", 0, checks.MAX_COUNT, default=0),
            timed_steps=checks.whole(record, "timed_steps", int(timed), checks.MAX_COUNT, default=0),
            phases=phases,
            seed=checks.whole(record, "seed", -(2**63), 2**64, default=0),
            run_index=checks.whole(record, "run_index", 0, checks.MAX_COUNT, default=0),
            compression=checks.text(record, "compression", default=""),
            options=checks.text_map(record, "options"),
            determinism=checks.text(record, "determinism", default="default"),
            timeout=checks.number(record, "timeout", 0, 1e9, default=0),
            capture=checks.text(record, "capture", default=CAPTURE_MODES[0]),
            view=tuple(checks.whole({"view": env}, "view", 0, n_env - 1) for env in checks.items(record, "view")),
            **{name: setting.read(record, name) for name, setting in SETTINGS.items()},
        )
        if made.captured_steps < 1:
            raise DamagedRecording(f"it begins at step {made.first_step} and ends at step {made.steps}")
        return made


SETTINGS: dict[str, Setting] = {
    one.name: one.metadata["setting"] for one in fields(RunConfiguration) if "setting" in one.metadata
}
"""All of a configuration, by name."""

TELLING = {name: setting for name, setting in SETTINGS.items() if setting.title}
"""Settings that results can depend on, by name."""


def deciding(settings: Settings) -> Settings:
    """Those that states depend on."""
    return tuple((name, key) for name, key in settings if TELLING[name].bits)


def open_end(stride: int) -> int:
    """What `steps` is until the end of a recording that does not announce them: the largest that `stride` divides.

    No recording has as many, so that a file whose program was killed lacks steps for every reader.
    """
    return checks.MAX_COUNT // max(1, stride) * max(1, stride)


def sim_time_ns(step: int, dt: float) -> int:
    """Simulated time of a step [ns]."""
    return round(step * dt * 1e9)
