"""State hashes of a run, boiled down to what comparing environments and runs needs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.metrics.identity import distinct_over_time
from evaluator.metrics.split_tree import SplitTree, split_tree
from evaluator.streams import Fingerprints


@dataclass(frozen=True)
class Histories:
    """The captured states of one run by bits.

    steps       simulator step of each row, shape [row]
    digests     128-bit digest of the hashes of all environments, in their order, shape [row, 2]
    classes     of the environments by their whole history, numbered in order of first appearance, shape [env]
    at_step     distinct environments at that very row, shape [row]
    so_far      distinct environments by all rows up to that one, shape [row]
    first_step  the first step at which any two environments differ; None where none do
    tree        which environments left which, and when
    """

    steps: NDArray[np.int64]
    digests: NDArray[np.uint64]
    classes: NDArray[np.int64]
    at_step: NDArray[np.int64]
    so_far: NDArray[np.int64]
    first_step: int | None
    tree: SplitTree

    @property
    def n_distinct(self) -> int:
        """Environments with different histories."""
        return int(self.classes.max(initial=-1)) + 1

    def until(self, rows: int) -> bytes:
        """The first rows of all environments, as bytes that are equal exactly where those are."""
        return self.steps[:rows].tobytes() + self.digests[:rows].tobytes()


def histories_of(fingerprints: Fingerprints) -> Histories:
    """Boil down the hashes of a phase."""
    hashes = np.ascontiguousarray(fingerprints.hashes)
    digests = [hashlib.blake2b(row, digest_size=16).digest() for row in hashes]
    counted = distinct_over_time(hashes)
    apart = np.flatnonzero(counted.instant > 1)
    return Histories(
        steps=fingerprints.steps,
        digests=np.frombuffer(b"".join(digests), dtype=np.uint64).reshape(-1, 2),
        classes=counted.classes,
        at_step=counted.instant,
        so_far=counted.histories,
        first_step=int(fingerprints.steps[apart[0]]) if len(apart) else None,
        tree=split_tree(fingerprints.steps, counted),
    )
