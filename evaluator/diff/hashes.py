"""State hashes of two selections at the steps that both recorded."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.common import CommonField, common_steps
from gpusimbench.evaluator.diff.result import Basis
from gpusimbench.evaluator.diff.selection import Selection
from gpusimbench.evaluator.missing import Missing
from gpusimbench.schemas.errors import DamagedRecording

PHASES = ("capture", "timed")


@dataclass(frozen=True)
class CommonHashes:
    """Recorded hashes of whole states, comparable with each other.

    phase             of the runs that they are of
    steps_a, steps_b  common steps, shape [step]
    a, b              shape [step, env]
    """

    phase: str
    steps_a: NDArray[np.int64]
    steps_b: NDArray[np.int64]
    a: NDArray[np.uint64]
    b: NDArray[np.uint64]

    def unseen(self, steps_a: NDArray[np.int64]) -> int:
        """At how many steps hashes differ of which no state is known; states are of these captured steps."""
        captured = self.phase == "capture"
        unseen = ~np.isin(self.steps_a, steps_a) if captured else np.ones(len(self.steps_a), dtype=bool)
        return int(np.count_nonzero((self.a[unseen] != self.b[unseen]).any(axis=1)))

    def check(self, steps_a: NDArray[np.int64], differ: NDArray[np.bool_], a: Selection, b: Selection) -> None:
        """Hold the hashes against states, [step, pair]; DamagedRecording where they say otherwise."""
        if self.phase != "capture":
            return
        _, mine, theirs = np.intersect1d(self.steps_a, steps_a, assume_unique=True, return_indices=True)
        wrong = ((self.a[mine] != self.b[mine]) != differ[theirs]).any(axis=1)
        if wrong.any():
            step = int(steps_a[theirs[np.argmax(wrong)]])
            raise DamagedRecording(
                f"{a.recording.path}, {b.recording.path}: the state hashes at step {step} are not those of the states"
            )


def common_hashes(
    a: Selection, b: Selection, fields: tuple[CommonField, ...], ratio: Fraction, *, states: bool
) -> CommonHashes | Missing:
    """Hashes that both sides recorded, or why they cannot be used.

    states  whether there are common states: then hashes are those of the same phase, the capture's
    """
    why_not = _why_not(a, b, fields)
    if why_not:
        return Missing(why_not)
    for phase in PHASES[:1] if states else PHASES:
        found = _of_phase(phase, a, b, ratio)
        if found is not None:
            return found
    return Missing("not both recordings have state hashes of a common step")


def timed_hashes(
    a: Selection, b: Selection, fields: tuple[CommonField, ...], ratio: Fraction, hashes: CommonHashes | None
) -> CommonHashes | None:
    """Hashes of the timed phase beside those of the capture; None where there are none that can be compared.

    hashes  those that are compared already
    """
    if _why_not(a, b, fields) or (hashes is not None and hashes.phase == PHASES[1]):
        return None
    return _of_phase(PHASES[1], a, b, ratio)


def _of_phase(phase: str, a: Selection, b: Selection, ratio: Fraction) -> CommonHashes | None:
    of_a = a.recording.fingerprints(phase)
    of_b = of_a if b.recording is a.recording else b.recording.fingerprints(phase)
    if of_a is None or of_b is None:
        return None
    steps_a, steps_b = common_steps(of_a.steps, of_b.steps, ratio)
    if not len(steps_a):
        return None
    return CommonHashes(
        phase, steps_a, steps_b,
        of_a.hashes[np.searchsorted(of_a.steps, steps_a), a.slice],
        of_b.hashes[np.searchsorted(of_b.steps, steps_b), b.slice],
    )  # fmt: skip


def _why_not(a: Selection, b: Selection, fields: tuple[CommonField, ...]) -> str:
    # a hash is over the whole state, field after field
    if [f.name for f in a.recording.fields] != [f.name for f in b.recording.fields]:
        return "the recordings have different fields, and a hash is over all of them"
    if len(fields) < len(a.recording.fields) or not all(field.whole for field in fields):
        return "the recordings have different items, and a hash is over all of them"
    if any(field.basis is Basis.FLOAT32 for field in fields):
        return "one recording is float32, the other float64"
    if any(field.basis is Basis.LOCAL for field in fields):
        return "the environments have different origins, which are part of the hashed positions"
    return "" if fields else "no fields are described"
