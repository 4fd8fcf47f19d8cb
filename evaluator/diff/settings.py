"""What two recordings say of themselves, and where they disagree."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from gpusimbench.evaluator.diff.result import Setting
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.initial import GIVEN
from gpusimbench.schemas.model_files import COMPRESSED, MODEL
from gpusimbench.schemas.provenance import ENGINE_LOG, PACKAGES, PROVENANCE, SIMULATION
from gpusimbench.schemas.treatment import CONTROLS, SNAPSHOT

_PACKAGE = "software.packages."
UNSET = "(unset)"
"""Stands for what a recording does not say."""
_LONGEST = 200
_DEEPEST = 4
_DIGITS = 12  # of a digest that is shown
_OF_THE_RUN = ("run_index", "view", "snapshots")
_TOLD_ELSEWHERE = (PROVENANCE, SIMULATION, PACKAGES, ENGINE_LOG, GIVEN, CONTROLS, MODEL, COMPRESSED, "entropy.txt")


def differing_settings(a: Recording, b: Recording) -> tuple[Setting, ...]:
    """Everything of configuration, options, versions, machine and attachments that is not the same.

    What belongs to a run alone, such as its id, time, command line and index, is left out. Last come installed packages
    that no recorder lists among those that compute.
    """
    of_a, of_b = dict(_settings_of(a)), dict(_settings_of(b))
    names = dict.fromkeys((*of_a, *of_b))
    pairs = ((name, of_a.get(name, UNSET), of_b.get(name, UNSET)) for name in names)
    found = [Setting(name, _short(x), _short(y)) for name, x, y in pairs if x != y]
    return tuple(sorted(found, key=lambda one: is_other_package(one, a, b)))


def is_other_package(setting: Setting, a: Recording, b: Recording) -> bool:
    """Whether it is of a package that was installed and that neither recorder lists among those that compute."""
    listed = [one.provenance.software.get("packages", {}) for one in (a, b)]
    name = setting.name.removeprefix(_PACKAGE)
    return name != setting.name and not any(isinstance(one, dict) and name in one for one in listed)


def _settings_of(recording: Recording) -> Iterator[tuple[str, str]]:
    # what decides the numbers comes first
    configuration = recording.configuration.to_json()
    yield from _flat({k: v for k, v in configuration.items() if k not in _OF_THE_RUN}, "")
    simulation = recording.simulation
    if simulation:
        yield "version", simulation.version
        yield "device", simulation.device
        yield from _flat(simulation.switches, "switches.")
        yield from _flat(simulation.options, "engine.")
        yield from _flat(simulation.scene, "scene.")
        for field in simulation.fields:
            about = (field.dtype, f"{len(field.items)} x {field.width}", field.unit, f"frame {field.frame}", field.note)
            yield f"state.{field.name}", ", ".join(part for part in about if part)
            yield f"state.{field.name}.items", ", ".join(field.items)
            yield f"state.{field.name}.components", ", ".join(field.components)
            if field.item_units:
                yield f"state.{field.name}.units", ", ".join(field.item_units)
        yield "env_origins", _text(simulation.env_origins)
        for deviation in simulation.deviations:
            yield f"deviation.{deviation.parameter}", f"{deviation.used} instead of {deviation.wanted}"
        for buffer in simulation.buffers:
            yield f"buffer.{buffer.name}", f"{buffer.asked} per {buffer.per}"
        yield "fresh_start", simulation.fresh_start
    for phase, stream in recording.action_streams.items():
        told = asdict(stream)
        for digest in ("first_sha256", "last_sha256"):
            told[digest] = told[digest][:_DIGITS]
        yield from _flat(told, f"actions.{phase}.")
    for name in recording.attachment_names():
        if name not in _TOLD_ELSEWHERE and not SNAPSHOT.fullmatch(name):
            yield (
                f"attachment.{name}",
                f"sha256 {hashlib.sha256(recording.attachment(name) or b'').hexdigest()[:_DIGITS]}",
            )
    provenance = recording.provenance
    yield from _flat(provenance.environment, "environment.")
    yield from _flat(provenance.software, "software.")
    yield from _flat(provenance.host, "host.")
    for number, gpu in enumerate(provenance.gpus):
        yield from _flat(gpu, f"gpu{number}.")
    yield from _packages(recording)  # hundreds, of which those that can change numbers were named already


def _flat(record: Mapping[str, Any], prefix: str, depth: int = 0) -> Iterator[tuple[str, str]]:
    for name, value in record.items():
        if isinstance(value, dict) and depth < _DEEPEST:
            yield from _flat(value, f"{prefix}{name}.", depth + 1)
        else:
            yield f"{prefix}{name}", _text(value)


def _packages(recording: Recording) -> Iterator[tuple[str, str]]:
    # lines of pip: name==version, or name @ where it came from
    for line in (recording.attachment(PACKAGES) or b"").decode(errors="replace").splitlines():
        name, found, version = line.partition("==" if "==" in line else " @ ")
        if found:
            yield f"{_PACKAGE}{name}", version


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    try:
        return json.dumps(value, sort_keys=True)
    except RecursionError:  # as deep as its reader allowed, and this is a few calls deeper
        return "(nested too deeply to compare)"


def _short(text: str) -> str:
    if len(text) <= _LONGEST:
        return text
    return f"{text[:_LONGEST]}... (sha256 {hashlib.sha256(text.encode(errors='replace')).hexdigest()[:_DIGITS]})"
