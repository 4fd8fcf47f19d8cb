"""What the environment of each simulator is made of, and the folder in which prepared environments lie."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import did_you_mean
from gpusimbench.schemas.writing import write_file

FOLDER = Path(__file__).parent / "requirements"

_TORCH = ("torch==2.13.0",)
FOLDER_VARIABLE = "GSB_ENVIRONMENTS"
"""Environment variable that says where they lie."""

MANIFEST = "gsb-environment.json"  # written last: an environment without it was never finished


@dataclass(frozen=True)
class Specification:
    """How an environment is made.

    simulator  whose it is; its requirements, pinned and hashed, are in requirements/<simulator>.txt
    pythons    minor versions of Python 3 that it can be made with, the preferred one first
    beforehand requirements that come from the user's own index with what they depend on, neither hashed nor locked:
               which build of torch is right, CPU or CUDA and which, is a matter of the machine
    """

    simulator: str
    pythons: tuple[int, ...] = (11, 12, 13)
    beforehand: tuple[str, ...] = ()

    @property
    def requirements(self) -> Path:
        """Every distribution of the environment but those of `beforehand`, with its hashes."""
        return FOLDER / f"{self.simulator}.txt"

    def sha256(self) -> str:
        """The digest of all that says what is installed [hex]."""
        text = "\n".join((*self.beforehand, self.requirements.read_text()))
        return hashlib.sha256(text.encode()).hexdigest()


SPECIFICATIONS = {
    specification.simulator: specification
    for specification in (
        Specification("calibration", pythons=(11, 12, 13)),
        Specification("genesis", beforehand=_TORCH),
        Specification("isaaclab", pythons=(12,), beforehand=("torch==2.11.0",)),
        Specification("maniskill", beforehand=_TORCH),
        Specification("physx"),
        Specification("sapien"),
    )
}
"""By simulator."""


def specification_of(simulator: str) -> Specification:
    """How the environment of a simulator is made; UsageError names those that have one."""
    if simulator not in SPECIFICATIONS:
        raise UsageError(
            f"there is no environment for '{simulator}' to set up; there is one for: {', '.join(SPECIFICATIONS)}"
            f"{did_you_mean(simulator, SPECIFICATIONS)}"
        )
    return SPECIFICATIONS[simulator]


@dataclass(frozen=True)
class Prepared:
    """A finished environment, as it said of itself when it was made.

    requirements  Specification.sha256 of what it was made from
    python        version of Python
    versions      of the distributions that decide which numbers come out
    size          [bytes]
    created       UTC, ISO 8601
    """

    simulator: str
    requirements: str
    python: str
    versions: dict[str, str]
    size: int
    created: str

    @property
    def folder(self) -> Path:
        """Where it lies."""
        return folder_of(self.simulator)

    @property
    def interpreter(self) -> Path:
        """Its Python."""
        return self.folder / "bin" / "python"

    @property
    def current(self) -> bool:
        """Whether it was made from the requirements of this version."""
        return self.requirements == SPECIFICATIONS[self.simulator].sha256()

    def write(self) -> None:
        """Say that it is finished."""
        write_file(self.folder / MANIFEST, json.dumps(asdict(self), indent=1) + "\n")


def store() -> Path:
    """$GSB_ENVIRONMENTS, else gpusimbench/environments in the user's folder for data.

    UsageError where there is neither.
    """
    if given := os.environ.get(FOLDER_VARIABLE):
        return Path(given).absolute()
    try:
        data = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    except RuntimeError:
        raise UsageError(f"there is no home folder for environments; name a folder with {FOLDER_VARIABLE}") from None
    return Path(data).absolute() / "gpusimbench" / "environments"


def folder_of(simulator: str) -> Path:
    """Where the environment of a simulator lies, made or not."""
    return store() / simulator


def find(simulator: str) -> Prepared | None:
    """The finished environment of a simulator; None where there is none, or one that was not finished."""
    if simulator not in SPECIFICATIONS:
        return None
    try:
        prepared = Prepared(**json.loads((folder_of(simulator) / MANIFEST).read_text()))
    except (OSError, ValueError, TypeError, UsageError):
        return None
    return prepared if prepared.simulator == simulator and prepared.interpreter.exists() else None


def prepared() -> Iterator[Prepared]:
    """All finished environments, by name."""
    for simulator in sorted(SPECIFICATIONS):
        if there := find(simulator):
            yield there
