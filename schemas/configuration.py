"""What one run was asked to do: stored in every recording, and enough to run it again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.treatment import Given, Initial, Intervention, Keep, Vary, parse_initial

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
    initial      how environments begin, as of treatment.Initial or Given; empty: in the scene's first state
    vary         which of their parameters differ, as of treatment.Vary; empty: none
    intervention what is done to their state on the way, as of treatment.Intervention; empty: nothing
    keep         which of the captured states are written, as of treatment.Keep; empty: all
    view         environments whose captured states are written as what viewers draw, too
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
    initial: str = ""
    intervention: str = ""
    snapshots: tuple[int, ...] = ()
    keep: str = ""
    model: str = ""
    keyframe: str = ""
    actions: str = ""
    fitted: dict[str, str] = field(default_factory=dict)
    vary: str = ""

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
        return {name: value for name, value in record.items() if value or name not in _LATER}

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
            timeout=checks.number(record, "timeout", 0, 1e9) if "timeout" in record else 0.0,
            capture=checks.text(record, "capture", default=CAPTURE_MODES[0]),
            view=tuple(checks.whole({"view": env}, "view", 0, n_env - 1) for env in checks.items(record, "view")),
            **{name: read(record, name) for name, read in _LATER.items()},
        )
        if made.captured_steps < 1:
            raise DamagedRecording(f"it begins at step {made.first_step} and ends at step {made.steps}")
        return made


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
            raise DamagedRecording(f"{name} is none that is known: {text[:40]!r}") from None

    return read


_LATER: dict[str, Callable[[dict[str, Any], str], Any]] = {
    "initial": _treatment(parse_initial),
    "vary": _treatment(Vary.parse),
    "intervention": _treatment(Intervention.parse),
    "keep": _treatment(Keep.parse),
    "snapshots": _steps,
    "model": _text,
    "keyframe": _text,
    "actions": _text,
    "fitted": checks.text_map,
}
"""Values that came later than the others, and how each is read; what is empty of them is left out of the JSON."""


def open_end(stride: int) -> int:
    """What `steps` is until the end of a recording that does not announce them: the largest that `stride` divides.

    No recording has as many, so that a file whose program was killed lacks steps for every reader.
    """
    return checks.MAX_COUNT // max(1, stride) * max(1, stride)


def sim_time_ns(step: int, dt: float) -> int:
    """Simulated time of a step [ns]."""
    return round(step * dt * 1e9)
