"""The finished runs of a folder, by their own recordings: what was asked and how it ended; a lock on what is added."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gpusimbench.recorder.environments.interpreter import Interpreter
from gpusimbench.recorder.sets.sweep import Outcome, SweepRun
from gpusimbench.schemas import PARTIAL, topics
from gpusimbench.schemas.commands.folder_lock import folder_lock
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, RecordingError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.provenance import ENGINE_LOG, PROVENANCE, Provenance


@dataclass(frozen=True)
class Finished:
    """A recording with an end.

    where  machine and software that it was made with, as `where_am_i` says it
    """

    path: Path
    configuration: RunConfiguration
    outcome: Outcome
    where: str = ""


def read_folder(folder: Path) -> tuple[list[Finished], dict[Path, str]]:
    """The finished recordings of a folder, by name, and why its other .mcap and .partial files are none."""
    found: list[Finished] = []
    others: dict[Path, str] = {}
    for path in sorted([*folder.glob("*.mcap"), *folder.glob(f"*.mcap{PARTIAL}")]):
        if path.name.endswith(PARTIAL) or not path.is_file():
            others[path] = "incomplete" if path.is_file() else "not a file"
            continue
        try:
            found.append(read_end(path))
        except RecordingError as error:
            others[path] = str(error)
    return found, others


def read_end(path: Path) -> Finished:
    """What a recording says of itself, without its data. RecordingError where it is none, or has no end."""
    try:
        container = Container(path)
        end = run_end(container)
        if end is None:
            raise DamagedRecording("incomplete")
        text = container.attachment(PROVENANCE)
        if text is None:
            raise DamagedRecording("it says nothing of where it comes from")
        made = Provenance.from_json(text)
        outcome = outcome_of(end)
        if outcome.cause == "ENGINE" and _interrupted(container, outcome):
            outcome = replace(outcome, cause="INTERRUPTED")
        return Finished(path, made.configuration, outcome, _where(made.host, made.gpus, made.software))
    except RecordingError as error:
        said = str(error)
        why = said.removeprefix(f"{path}: ").removeprefix(f"{path} ")
        raise DamagedRecording(why if why == "incomplete" else f"unreadable: {why}") from None


def _interrupted(container: Container, outcome: Outcome) -> bool:
    # Older recorders took what an engine made of a signal, such as an ImportError, for a failure of the engine.
    sign = "KeyboardInterrupt"
    return sign in outcome.reason or sign.encode() in (container.attachment(ENGINE_LOG) or b"")


def run_end(container: Container) -> Any:
    """The end record; None where the run or its file was cut short. DamagedRecording where it cannot be read."""
    if not container.finished or topics.RUN_END not in container.channels:
        return None
    ends = list(container.in_sequence(topics.RUN_END))
    if len(ends) > 1:
        raise DamagedRecording("it has two ends")
    try:
        return message_class("gsb.v1.RunEnd").FromString(bytes(ends[0])) if ends else None
    except Exception as error:  # protobuf's DecodeError differs between its backends
        raise DamagedRecording(f"its end cannot be parsed: {error}") from None


def outcome_of(end: Any) -> Outcome:
    """How an end record says that the run ended. DamagedRecording where it has no status."""
    status = _name("gsb.v1.RunStatus", "RUN_STATUS_", end.status)
    if not status:
        raise DamagedRecording("its end has no status")
    return Outcome(status.lower(), _name("gsb.v1.Cause", "CAUSE_", end.cause), end.reason)


def where_am_i(interpreter: Interpreter) -> str:
    """The machine and the software that a run made now would have: CPU, GPUs and versions of packages that compute."""
    from gpusimbench.recorder.probes.gpu import Gpus
    from gpusimbench.recorder.probes.host import describe_host

    with Gpus() as gpus:
        return _where(describe_host(), gpus.describe(), interpreter.software())


def _where(host: dict[str, Any], gpus: Sequence[dict[str, Any]], software: dict[str, Any]) -> str:
    names = sorted({str(gpu.get("name", "")) for gpu in gpus})
    return json.dumps([host.get("cpu", ""), names, software.get("packages", {})], sort_keys=True)


def matching(found: Iterable[Finished], wanted: RunConfiguration, where: str = "") -> dict[SweepRun, Finished]:
    """Those that need not be made again, by their place in a sweep of `wanted` over n_env.

    where  machine and software that they must be of (`where_am_i`); empty: of any

    The number of environments, the run's number, the file's compression and view, and the time limit make no
    difference, and a complete one goes before another. An interrupted run is to be made again, and so is one that
    failed for a cause that is not known, or that timed out before the time that it would get now.
    """
    places: dict[SweepRun, Finished] = {}
    for run in found:
        if in_common(run.configuration) == in_common(wanted) and _settled(run, wanted) and where in ("", run.where):
            place = SweepRun(run.configuration.n_env, run.configuration.run_index)
            if place not in places or run.outcome.good > places[place].outcome.good:
                places[place] = run
    return places


def in_common(one: RunConfiguration) -> RunConfiguration:
    """The configuration without what makes no difference to `matching`: the same for all runs of a sweep."""
    indifferent: dict[str, Any] = {
        "n_env": 1, "run_index": 0, "compression": "none", "timeout": 0.0, "capture": "lossless", "view": (),
    }  # fmt: skip
    return replace(one, **indifferent)


def _settled(run: Finished, wanted: RunConfiguration) -> bool:
    if run.outcome.good:
        return True
    if run.outcome.cause == "TIMEOUT":
        return 0 < wanted.timeout <= run.configuration.timeout
    return run.outcome.cause not in ("", "INTERRUPTED")


def _name(enum: str, prefix: str, number: int) -> str:
    # of a value; empty for the unspecified one and for one that this version does not know
    names = {value: name.removeprefix(prefix) for name, value in enum_values(enum).items()}
    return names.get(number, "") if number else ""


def locked(folder: Path, wanted: RunConfiguration, where: str) -> AbstractContextManager[None]:
    """Hold the lock of a sweep of `wanted`, made `where` (see where_am_i), while the block runs: one command at a time
    makes its runs there. Two sweeps have one lock where recordings of one would count for the other (see matching);
    other sweeps, and sets of runs, may share the folder.

    GsbError where another process holds it, which the message names.
    """
    return folder_lock(folder, f"gsb-sweep-{_key(wanted, where)}", "makes this sweep")


def _key(wanted: RunConfiguration, where: str) -> str:
    text = json.dumps([in_common(wanted).to_json(), where], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
