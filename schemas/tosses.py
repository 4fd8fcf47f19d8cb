"""Tosses: motions of one thrown cube, measured or synthetic, and what a recording of them says of itself.

A recording of tosses has one environment for each toss, in the order of the set. Its states are the measured rows at
their times. A toss that is shorter than the longest keeps its last row, and `rows` says how many rows were measured.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

TOSSES = "tosses.json"
"""Attachment of a recording of tosses."""

NOTICE = "notice"
"""Name of the licence text among arrays of initial states that hold measured data."""

GROUP = "cubes"
"""The cube's group of bodies."""

MAX_TOSSES = 1 << 16

EVEN, ODD = "even tosses", "odd tosses"
"""Tosses by their number from 0: options are fitted on the even ones, and judged by the odd ones."""


def judged_on(fitted: Mapping[str, str]) -> str:
    """The tosses that a run is judged by: ODD where its options were fitted on EVEN, empty for all where none was.

    fitted  as of a RunConfiguration

    ValueError where options were fitted on something else, so that no toss is left to judge by.
    """
    if others := sorted(f"{name} to {data}" for name, data in fitted.items() if data != EVEN):
        raise ValueError(
            f"it was fitted ({', '.join(others)}), and only options that were fitted to '{EVEN}' leave tosses to judge "
            "by, which are the odd ones"
        )
    return ODD if fitted else ""


SYNTHETIC = "synthetic tosses, made by a simulation"
"""The source of a set that nobody measured, such as the set that the recorder ships."""


@dataclass(frozen=True)
class TossSet:
    """What is known of a set of tosses.

    source        what the set is, in words
    sha256        of the set as it was read, before anything was corrected [hex]
    rows          measured rows of each toss
    length_scale  by which measured lengths were multiplied
    corrections   what else was done to the measured numbers, a sentence each
    """

    source: str
    sha256: str
    rows: tuple[int, ...]
    length_scale: float
    corrections: tuple[str, ...]

    @property
    def kind(self) -> str:
        """For titles: whether the set was measured."""
        return "synthetic tosses" if self.source == SYNTHETIC else "measured tosses"

    def to_json(self) -> str:
        """As the attachment has it."""
        record: dict[str, Any] = {
            "source": self.source,
            "sha256": self.sha256,
            "rows": list(self.rows),
            "length_scale": self.length_scale,
            "corrections": list(self.corrections),
        }
        return json.dumps(record, indent=1) + "\n"

    @classmethod
    def from_json(cls, data: bytes, n_env: int, budget: checks.Budget | None = None) -> TossSet:
        """From the attachment of a recording of so many environments; DamagedRecording where it cannot be so."""
        record = checks.load(TOSSES, data, budget)
        rows = tuple(checks.whole({"rows": row}, "rows", 2, checks.MAX_COUNT) for row in checks.items(record, "rows"))
        if len(rows) != n_env:
            raise DamagedRecording(f"{TOSSES} has {len(rows)} tosses, and the recording {n_env} environments")
        return cls(
            source=checks.text(record, "source"),
            sha256=checks.text(record, "sha256"),
            rows=rows,
            length_scale=checks.number(record, "length_scale", 0.1, 10.0),
            corrections=checks.texts(record, "corrections"),
        )
