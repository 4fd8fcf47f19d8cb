"""Where a recording comes from: two JSON attachments.

provenance.json  written before any device context exists: what was asked, by whom, on what machine, with what
                 software. A run that dies at once still says this much.
simulation.json  written once the simulator is built: the options really in force, the parameters of the scene that the
                 engine could not honour, the layout of the state.

Readers ignore keys they do not know.
"""

from __future__ import annotations

import json
import re
from dataclasses import KW_ONLY, asdict, dataclass, field
from typing import Any

from gpusimbench.schemas import FORMAT, checks
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, damage_in
from gpusimbench.schemas.fields import StateField

PROVENANCE = "provenance.json"
SIMULATION = "simulation.json"
PACKAGES = "pip-freeze.txt"
SCENE = "scene.json"
ENGINE_LOG = "engine-log.txt"
TRIALS = "trials.csv"
PROGRAM = "program.json"
"""What gsb-run says of the program that logged its states: its command, and digests of the files that this names."""

MAX_FIELDS = 256
"""State fields of a recording."""

REAL = "real"
"""Simulator name of a recording of real trials."""

LOGGED = "as the program that logged it says"
"""How a program that is no adapter came to its initial state."""


@dataclass(frozen=True)
class ReplayOf:
    """The recording whose configuration a run executed again.

    run_id        of that recording
    content_hash  of that recording
    changed       what the user had otherwise than it was recorded there: dotted name -> recorded value, empty where
                  nothing was recorded under that name
    """

    run_id: str
    content_hash: str
    changed: dict[str, str] = field(default_factory=dict)

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> ReplayOf:
        """From JSON; DamagedRecording where it cannot be read."""
        return cls(
            checks.text(record, "run_id"), checks.text(record, "content_hash"), checks.text_map(record, "changed")
        )


@dataclass(frozen=True)
class Provenance:
    """What is known before the run begins.

    run_id         unique to the run (UUID4)
    created_utc    ISO 8601, seconds
    argv           the command as the user gave it
    configuration  what was asked
    host           operating system, CPU, cores, memory
    gpus           one record per GPU that NVML shows: name, driver, memory, clocks, ECC and MIG mode; empty without any
    software       versions of Python, the recorder (with its git commit) and the packages that can change numbers
    environment    environment variables that can change numbers, such as XLA_FLAGS
    replay_of      the recording that this run is a replay of; None where it is none
    """

    run_id: str
    created_utc: str
    argv: tuple[str, ...]
    configuration: RunConfiguration
    host: dict[str, Any] = field(default_factory=dict)
    gpus: tuple[dict[str, Any], ...] = ()
    software: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    replay_of: ReplayOf | None = None

    @property
    def dated(self) -> bool:
        """Whether created_utc is a time as gsb-record writes it: such texts are in the order of their times."""
        return re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", self.created_utc) is not None

    def to_json(self) -> str:
        """As the text of the attachment."""
        record = {**asdict(self), "configuration": self.configuration.to_json(), "format": FORMAT}
        if self.replay_of is None:
            del record["replay_of"]
        return _dump(record)

    @classmethod
    def from_json(cls, text: str | bytes, budget: checks.Budget | None = None) -> Provenance:
        """From the attachment; DamagedRecording where it cannot be read, or is more than the file's budget allows."""
        record = checks.load(PROVENANCE, text, budget)
        with damage_in(PROVENANCE):
            return cls(
                run_id=checks.text(record, "run_id"),
                created_utc=checks.text(record, "created_utc"),
                argv=checks.texts(record, "argv"),
                configuration=RunConfiguration.from_json(checks.mapping(record, "configuration")),
                host=_checked_kinds(checks.mapping(record, "host"), _HOST),
                gpus=tuple(_checked_kinds(gpu, _GPU) for gpu in checks.objects(record, "gpus")),
                software=_software(checks.mapping(record, "software")),
                environment=checks.text_map(record, "environment"),
                replay_of=ReplayOf.from_json(checks.mapping(record, "replay_of")) if "replay_of" in record else None,
            )


@dataclass(frozen=True)
class Deviation:
    """A parameter of the scene that the engine could not honour.

    parameter  dotted name, for example "cubes.restitution"
    wanted     the scene's value
    used       what the engine has instead, in words or as a number
    reason     why
    """

    parameter: str
    wanted: str
    used: str
    reason: str


@dataclass(frozen=True)
class Buffer:
    """A capacity that the engine was given, beyond which it drops what it should have computed.

    name      as the engine calls it
    asked     how many entries it was given
    per       "env", or "all" where environments share them
    counter   name of the counter that shows how many were needed; empty where none does
    sized_by  how the number came about, in words
    """

    name: str
    asked: int
    per: str
    counter: str = ""
    sized_by: str = ""


@dataclass(frozen=True)
class Counter:
    """Something that is counted at each step in each environment: the topics /count/<phase>/<name>.

    name     such as "contacts", "constraint_rows", "solver_iterations", "awake_bodies", "candidate_pairs"
    meaning  one sentence
    """

    name: str
    meaning: str


MISPLACED_CONTACTS = "misplaced_contacts"
"""Name of the counter of contacts that lie outside of one of their two shapes: a step that has any is wrong."""


@dataclass(frozen=True)
class OverflowBit:
    """What a bit of the topics /overflow/<phase> means.

    bit    number of the bit, from 0
    name   as the engine calls it
    fatal  something was dropped, so that the run is invalid
    """

    bit: int
    name: str
    fatal: bool


MODIFIED = "modified"
"""The switch that says, in a clause, how the engine that computed differs from the one that its makers released. It is
absent where there is no difference. Tables put MODIFIED behind the name of such a simulator."""


@dataclass(frozen=True)
class EngineFacts:
    """What a built simulator says of itself.

    version        of the engine
    device         "cpu", or the name of the GPU that steps
    options        every option in force, defaults included
    switches       whatever decides which numbers come out: determinism modes, implementations, precision
    deviations     parameters of the scene that the engine could not honour
    fields         layout of the state, in recording order
    timing_covers  what lies between two clock readings of the phase "timed"
    env_origins    origin of each environment in the engine's world frame [m]; empty when all are at zero
    buffers        capacities beyond which the engine drops contacts or constraints; measured, never left at a default
    counters       what is counted at each step
    overflow_bits  what the bits of the topics /overflow/<phase> mean
    remarks        what the engine had to say as it was built, such as warnings, and what its adapter says of recorded
                   states; no setting: runs that differ in this alone are alike
    """

    version: str
    device: str
    options: dict[str, Any]
    switches: dict[str, Any]
    deviations: tuple[Deviation, ...]
    fields: tuple[StateField, ...]
    timing_covers: str = ""
    _: KW_ONLY
    env_origins: tuple[tuple[float, float, float], ...] = ()
    buffers: tuple[Buffer, ...] = ()
    counters: tuple[Counter, ...] = ()
    overflow_bits: tuple[OverflowBit, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Simulation(EngineFacts):
    """What a recording says of the simulator that was built.

    scene        the scene's name and parameters, and the SHA-256 of its description
    fresh_start  how the capture phase came to its initial state
    """

    scene: dict[str, Any]
    fresh_start: str = "rebuilt"

    def to_json(self) -> str:
        """As the text of the attachment, with the origin of each environment on one line: MCAP compresses no
        attachments, and on three lines an origin has 1.6 times the bytes."""
        return _TRIPLE.sub(r"[\1, \2, \3]", _dump(asdict(self)))

    @classmethod
    def from_json(cls, text: str | bytes, budget: checks.Budget | None = None) -> Simulation:
        """From the attachment; DamagedRecording where it cannot be read, or is more than the file's budget allows."""
        record = checks.load(SIMULATION, text, budget)
        with damage_in(SIMULATION):
            switches, remarks = _apart(checks.mapping(record, "switches"))
            return cls(
                version=checks.text(record, "version"),
                device=checks.text(record, "device"),
                options=checks.mapping(record, "options"),
                switches=switches,
                deviations=tuple(
                    Deviation(*(checks.text(d, key) for key in ("parameter", "wanted", "used", "reason")))
                    for d in checks.objects(record, "deviations")
                ),
                fields=_fields(checks.objects(record, "fields")),
                scene=_checked_kinds(checks.mapping(record, "scene"), {"name": str, "sha256": str, "parameters": dict}),
                env_origins=tuple(_point(o) for o in checks.items(record, "env_origins")),
                timing_covers=checks.text(record, "timing_covers", default=""),
                fresh_start=checks.text(record, "fresh_start", default=""),
                buffers=tuple(_buffer(b) for b in checks.objects(record, "buffers")),
                counters=tuple(
                    Counter(checks.text(c, "name"), checks.text(c, "meaning", default=""))
                    for c in checks.objects(record, "counters")
                ),
                overflow_bits=tuple(
                    OverflowBit(checks.whole(b, "bit", 0, 31), checks.text(b, "name"), checks.flag(b, "fatal"))
                    for b in checks.objects(record, "overflow_bits")
                ),
                remarks=(*remarks, *checks.texts(record, "remarks")),
            )


def _apart(switches: dict[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Switches, and remarks: the first recorders had those among the switches, as `warnings`."""
    said = switches.get("warnings")
    if not isinstance(said, list) or not all(isinstance(sentence, str) for sentence in said):
        return switches, ()
    return {name: value for name, value in switches.items() if name != "warnings"}, tuple(said)


def engine_name(simulator: str, simulation: Simulation | None) -> str:
    """What tables call a simulator: by its name alone only where the engine is the released one, see MODIFIED."""
    return f"{simulator} MODIFIED" if simulation and simulation.switches.get(MODIFIED) else simulator


_HOST: dict[str, type] = {
    **dict.fromkeys(("cpu", "kernel", "libc", "machine", "system"), str),
    **dict.fromkeys(("cores", "memory_bytes", "threads", "usable_threads"), int),
}
_GPU: dict[str, type] = {
    "name": str, "driver": str, "memory_bytes": int, "power_limit_mw": int, "ecc": bool, "mig": bool,
}  # fmt: skip
_SOFTWARE: dict[str, type] = {"python": str, "implementation": str, "recorder": dict, "packages": dict}
_RECORDER: dict[str, type] = {"name": str, "version": str, "commit": str, "modified": bool}


def _checked_kinds(record: dict[str, Any], kinds: dict[str, type]) -> dict[str, Any]:
    """The record, whose known keys have values of the right kind or null: a machine may not tell everything."""
    for key, kind in kinds.items():
        value = record.get(key)
        if value is None:
            continue
        if kind is str:
            checks.text(record, key)
        elif kind is bool:
            checks.flag(record, key)
        elif kind is dict:
            checks.mapping(record, key)
        else:
            checks.whole(record, key, 0, 2**63)
    return record


def _software(record: dict[str, Any]) -> dict[str, Any]:
    _checked_kinds(record, _SOFTWARE)
    _checked_kinds(record.get("recorder") or {}, _RECORDER)
    if record.get("packages"):
        checks.text_map(record, "packages")
    return record


def _fields(records: list[dict[str, Any]]) -> tuple[StateField, ...]:
    if len(records) > MAX_FIELDS:
        raise DamagedRecording(f"{len(records)} state fields are more than the {MAX_FIELDS} that are read")
    fields = tuple(StateField.from_json(f) for f in records)
    for field_ in fields:
        if not field_.items or not field_.components:
            raise DamagedRecording(f"the state field {field_.name} has no items or no components")
    if len({f.name for f in fields}) < len(fields):
        raise DamagedRecording("a state field is there twice")
    return fields


def _buffer(record: dict[str, Any]) -> Buffer:
    return Buffer(
        name=checks.text(record, "name"),
        asked=checks.whole(record, "asked", 0, 2**63),
        per=checks.text(record, "per"),
        counter=checks.text(record, "counter", default=""),
        sized_by=checks.text(record, "sized_by", default=""),
    )


def _point(value: Any) -> tuple[float, float, float]:
    x, y, z = checks.vector(value, 3, "an env origin")
    return x, y, z


_TRIPLE = re.compile(r"\[\n +([^][{}\s\",]+),\n +([^][{}\s\",]+),\n +([^][{}\s\",]+)\n +\]")
"""A list of three numbers as json.dumps indents it; no string of JSON has an end of line in it."""


def _dump(record: dict[str, Any]) -> str:
    return json.dumps(record, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
