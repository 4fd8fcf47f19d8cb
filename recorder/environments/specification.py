"""What the environment of each simulator is made of."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.schemas.commands.suggestion import did_you_mean
from gpusimbench.schemas.errors import UsageError

FOLDER = Path(__file__).parent / "requirements"


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
        """Of all that says what is installed [hex]."""
        text = "\n".join((*self.beforehand, self.requirements.read_text()))
        return hashlib.sha256(text.encode()).hexdigest()


_TORCH = ("torch==2.13.0",)

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
