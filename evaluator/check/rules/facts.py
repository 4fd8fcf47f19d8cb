"""What rules can ask of a file: a closed list of facts, each with a name, a kind and a meaning.

A fact that a file cannot give is Unknown with a reason; no rule holds or is broken for it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from gpusimbench.evaluator.check import hardware
from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.check.rules import work_facts
from gpusimbench.evaluator.check.rules.fact import (
    Fact,
    FactType,
    NotThere,
    Unknown,
    configuration_of,
    described_of,
    provenance_of,
    recording_of,
    scene_of,
    simulation_of,
)
from gpusimbench.evaluator.check.rules.work_facts import WORK_FACTS
from gpusimbench.evaluator.json_values import brief
from gpusimbench.evaluator.read.known_errors import known_errors
from gpusimbench.evaluator.runs.groups import VARIABLES_WITHOUT_EFFECT
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, GsbError
from gpusimbench.schemas.provenance import PACKAGES, REAL


def fact_of(name: str, file: Integrity) -> Any:
    """The value of a fact, or Unknown."""
    try:
        return FACTS[name].read(file)
    except (NotThere, GsbError) as error:
        return Unknown(str(error))
    except NUMBERS_OF_A_STRANGER as error:
        return Unknown(str(error) or type(error).__name__)


def _sample_step_recorded(file: Integrity) -> bool:
    recording = recording_of(file)
    step = round(checks.number(scene_of(file), "sample_time", 0, 1e9) / configuration_of(file).dt)
    arrays = [recording.state(field.group, field.field) for field in recording.fields]
    return bool(arrays) and all(step in array.steps for array in arrays)


def _checkpoints(file: Integrity, source: str) -> tuple[str, ...]:
    trace = recording_of(file).memory.get(source)
    return tuple(dict.fromkeys(name for name in trace.checkpoint if name)) if trace else ()


def _timed_readings(file: Integrity) -> int:
    recording = recording_of(file)
    trace = recording.memory.get("gpu0/device" if recording.provenance.gpus else "host")
    return sum(phase == "timed" for phase in trace.phase) if trace else 0


def _phases(file: Integrity) -> tuple[str, ...]:
    events = recording_of(file).events
    ended = {event.phase for event in events if event.kind == "PHASE_END"}
    return tuple(event.phase for event in events if event.kind == "PHASE_BEGIN" and event.phase in ended)


def _missing(file: Integrity) -> tuple[str, ...]:
    provenance = provenance_of(file)
    recorder = provenance.software.get("recorder")
    said = {
        "run_id": provenance.run_id,
        "created_utc": provenance.created_utc,
        "argv": provenance.argv,
        "software.python": provenance.software.get("python"),
        "software.recorder.version": recorder.get("version") if isinstance(recorder, dict) else None,
        "software.packages": provenance.software.get("packages"),
    }
    if provenance.configuration.simulator != REAL:
        said |= {f"host.{key}": provenance.host.get(key) for key in ("cpu", "usable_threads", "memory_bytes", "system")}
        if file.simulation is not None:
            attached = file.scan.attachments if file.scan else {}
            said |= {PACKAGES: PACKAGES in attached, "simulation.version": file.simulation.version}
            if file.simulation.device != "cpu":
                said["gpus"] = provenance.gpus
    return tuple(f"{name} is not told" for name, value in said.items() if not value)


def _machine(file: Integrity) -> dict[str, Any]:
    host = provenance_of(file).host
    return {
        key: brief(host.get(key))
        for key in ("cpu", "cores", "usable_threads", "memory_bytes", "system", "kernel", "libc")
    }


def _gpus(file: Integrity) -> dict[str, Any]:
    keys = ("name", "driver", "memory_bytes", "ecc", "mig", "power_limit_mw")
    gpus = provenance_of(file).gpus
    return {f"gpu{i}.{key}": brief(gpu.get(key)) for i, gpu in enumerate(gpus) for key in keys}


def _software(file: Integrity) -> dict[str, Any]:
    software = provenance_of(file).software
    packages, recorder = software.get("packages"), software.get("recorder")
    told = {
        "python": software.get("python"),
        **(recorder if isinstance(recorder, dict) else {}),
        **(packages if isinstance(packages, dict) else {}),
    }
    return {name: brief(value) for name, value in told.items()}


def _environment(file: Integrity) -> dict[str, Any]:
    variables = provenance_of(file).environment
    return {name: value for name, value in variables.items() if name not in VARIABLES_WITHOUT_EFFECT}


def _engine(file: Integrity) -> dict[str, Any]:
    simulation = simulation_of(file)
    return {
        "version": simulation.version,
        "device": simulation.device,
        "scene": brief(simulation.scene.get("sha256")),
        **{f"option {name}": brief(value) for name, value in simulation.options.items()},
        **{f"switch {name}": brief(value) for name, value in simulation.switches.items()},
    }


def _asked_of_the_set(file: Integrity) -> dict[str, Any]:
    of_the_run = ("run_index", "view")
    return {name: value for name, value in configuration_of(file).to_json().items() if name not in of_the_run}


def _recorder(file: Integrity) -> dict[str, Any]:
    recorder = provenance_of(file).software.get("recorder")
    return recorder if isinstance(recorder, dict) else {}


def _modified(file: Integrity) -> bool:
    modified = _recorder(file).get("modified")
    if modified is None:
        raise NotThere("the recording does not tell whether the recorder's checkout had changes")
    return bool(modified)


def _problems(kind: Kind) -> Fact:
    def read(file: Integrity) -> tuple[str, ...]:
        found = file.of(kind)
        if not found and (reason := file.problems.skipped(kind)):
            raise NotThere(reason)
        return found

    return Fact(FactType.list, f"{kind.value}: each of them", read)


def _content_hash(file: Integrity) -> str:
    if file.end is None:
        raise NotThere("there is no end record")
    return str(file.end.content_hash)


_ASKED = {
    "simulator": (FactType.text, "name of the simulator"),
    "scene": (FactType.text, "name of the scene"),
    "n_env": (FactType.number, "environments"),
    "dt": (FactType.number, "step [s]"),
    "steps": (FactType.number, "steps to capture"),
    "stride": (FactType.number, "every how many steps a state is recorded"),
    "warmup": (FactType.number, "steps of the warm-up"),
    "timed_steps": (FactType.number, "steps of the timed phase"),
    "seed": (FactType.number, "seed of the scene"),
    "run_index": (FactType.number, "number of the run in its set"),
    "determinism": (FactType.text, "level of determinism that was asked for"),
}


def _field(name: str) -> Callable[[Integrity], Any]:
    return lambda file: getattr(configuration_of(file), name)


FACTS: dict[str, Fact] = {
    **WORK_FACTS,
    **{f"problems.{kind.name}": _problems(kind) for kind in Kind},
    **{name: Fact(type_, meaning, _field(name)) for name, (type_, meaning) in _ASKED.items()},
    "asked_phases": Fact(
        FactType.list, "phases that were asked for: timed, capture", lambda f: tuple(configuration_of(f).phases)
    ),
    "phases": Fact(FactType.list, "phases that began and ended", _phases),
    "asked": Fact(FactType.object, "all that was asked of the run but its number", _asked_of_the_set),
    "status": Fact(FactType.text, "complete, failed, invalid or incomplete", lambda f: described_of(f).status),
    "complete": Fact(FactType.flag, "the run is complete and no data was lost", lambda f: described_of(f).usable),
    "run_id": Fact(FactType.text, "unique name of the run", lambda f: provenance_of(f).run_id),
    "content_hash": Fact(FactType.text, "identity of the content, by the end record", _content_hash),
    "scene_sha256": Fact(
        FactType.text, "hash of the scene's description", lambda f: str(brief(simulation_of(f).scene.get("sha256", "")))
    ),
    "scene_dt": Fact(FactType.number, "step of the scene [s]", lambda f: checks.number(scene_of(f), "dt", 0, 1e9)),
    "sample_step_recorded": Fact(
        FactType.flag, "the state at the scene's sample time is in the file", _sample_step_recorded
    ),
    "host_checkpoints": Fact(
        FactType.list, "checkpoints at which the host's memory was read", lambda f: _checkpoints(f, "host")
    ),
    "gpu_checkpoints": Fact(
        FactType.list, "checkpoints at which the GPU's memory was read", lambda f: _checkpoints(f, "gpu0/device")
    ),
    "timed_memory_readings": Fact(
        FactType.number, "memory readings in the timed phase, of the GPU where there is one", _timed_readings
    ),
    "provenance_missing": Fact(FactType.list, "what a reader must know of a run, and is not told", _missing),
    "machine": Fact(FactType.object, "processor, threads, memory, system", _machine),
    "gpus": Fact(FactType.object, "GPUs with driver and modes", _gpus),
    "software": Fact(FactType.object, "versions of Python, recorder and packages", _software),
    "environment": Fact(FactType.object, "environment variables that can change numbers", _environment),
    "engine": Fact(FactType.object, "version, device, options and switches in force, scene", _engine),
    "recorder_commit": Fact(
        FactType.text, "git commit of the recorder, or empty", lambda f: str(brief(_recorder(f).get("commit")) or "")
    ),
    "known_errors": Fact(
        FactType.list,
        "errors of the recorder that were found later, and that the file shows",
        lambda f: tuple(error.said for error in known_errors(described_of(f))),
        apart=True,
    ),
    "recorder_modified": Fact(FactType.flag, "the recorder's checkout had changes", _modified),
}
"""All facts, by name."""


def _built(file: Integrity) -> bool:
    # unknown of a file whose description may be in what cannot be read
    if file.simulation is None and file.recording is None:
        raise NotThere(file.not_opened)
    return file.simulation is not None


CONDITIONS: dict[str, tuple[str, Callable[[Integrity], bool]]] = {
    "simulated": ("the run is no measurement", lambda f: configuration_of(f).simulator != REAL),
    "measured": ("these are real trials", lambda f: configuration_of(f).simulator == REAL),
    "timed": ("a timed phase was asked for", lambda f: "timed" in configuration_of(f).phases),
    "captured": ("a capture phase was asked for", lambda f: "capture" in configuration_of(f).phases),
    "complete": ("the run is complete by its own word", lambda f: described_of(f).status == "complete"),
    "counted": ("contacts are counted in the timed phase", lambda f: work_facts.contacts(recording_of(f)) is not None),
    "motion-counted": (
        "the recorder counted what moves at the beginning and the end of the timed phase",
        lambda f: work_facts.moving(recording_of(f)) is not None,
    ),
    "misplaced-counted": (
        "contacts outside of their bodies are counted",
        lambda f: work_facts.misplaced_counted(recording_of(f)),
    ),
    "throttling-known": (
        "the GPU tells in the timed phase why its clocks are not higher",
        lambda f: hardware.timed_throttled_share(recording_of(f)) is not None,
    ),
    "built": ("the simulator was built", _built),
    "on-gpu": ("the simulator steps on a GPU", lambda f: _built(f) and simulation_of(f).device not in ("cpu", "real")),
}
"""What a rule can be limited to, by name, each with its meaning."""


def applies(name: str, file: Integrity) -> bool | Unknown:
    """Whether a condition is met."""
    try:
        return CONDITIONS[name][1](file)
    except (NotThere, GsbError) as error:
        return Unknown(str(error))


def point_of(file: Integrity) -> tuple[str, ...] | None:
    """What the runs of one point of a benchmark share: simulator, scene, environments, options, level of determinism.

    None of a file that does not say.
    """
    if file.provenance is None:
        return None
    c = file.provenance.configuration
    return (c.simulator, c.scene, f"{c.n_env}", json.dumps(c.options, sort_keys=True), c.determinism)
