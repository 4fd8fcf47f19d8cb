"""What a fact is, and the parts of an examined file that facts are read from."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.read.described import Described
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas import checks
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION, Provenance, Simulation


class FactType(Enum):
    """What a fact's value is in Python."""

    flag = bool
    number = float
    text = str
    list = tuple
    object = dict


@dataclass(frozen=True)
class Unknown:
    """Stands for the value of a fact that a file does not give."""

    reason: str


class NotThere(Exception):
    """A file does not give what a fact is read from; the message is the reason."""


@dataclass(frozen=True)
class Fact:
    """Something that is true of one file.

    meaning  one sentence; of numbers with their unit in brackets at its end
    read     raises NotThere, or an error of the file, where it cannot be told
    apart    whether each item of a list is a finding of its own, the same in every file that has it
    """

    type: FactType
    meaning: str
    read: Callable[[Integrity], Any]
    apart: bool = False

    @property
    def unit(self) -> str:
        """The unit of a number, as its meaning has it; empty where it has none."""
        found = re.search(r"\[([^\]]+)\]$", self.meaning)
        return found[1] if found and self.type is FactType.number else ""


def recording_of(file: Integrity) -> Recording:
    """The recording, opened."""
    if not isinstance(file.recording, Recording):
        raise NotThere(file.not_opened)
    return file.recording


def described_of(file: Integrity) -> Described:
    """What the recording says of itself, also where it was closed."""
    if file.recording is None:
        raise NotThere(file.not_opened)
    return file.recording


def provenance_of(file: Integrity) -> Provenance:
    """What the file says of who made it, where and with what."""
    if file.provenance is None:
        raise NotThere(file.not_opened or f"{PROVENANCE} cannot be read")
    if file.doubtful(PROVENANCE):
        raise NotThere(f"{PROVENANCE} is not what was recorded")
    return file.provenance


def configuration_of(file: Integrity) -> RunConfiguration:
    """The configuration that was asked of the run."""
    return provenance_of(file).configuration


def simulation_of(file: Integrity) -> Simulation:
    """What the simulator said of itself."""
    if file.simulation is None:
        raise NotThere("the run ended before its simulator was built")
    if file.doubtful(SIMULATION):
        raise NotThere(f"{SIMULATION} is not what was recorded")
    return file.simulation


def scene_of(file: Integrity) -> dict[str, Any]:
    """The scene's description."""
    if file.scan is None and isinstance(file.recording, Recording):
        return file.recording.scene
    if file.scan is None or SCENE not in file.scan.attachments:
        raise NotThere(f"there is no {SCENE}")
    if file.doubtful(SCENE):
        raise NotThere(f"{SCENE} is not what was recorded")
    if isinstance(file.recording, Recording):
        return file.recording.scene
    return checks.load(SCENE, bytes(file.scan.attachments[SCENE]))
