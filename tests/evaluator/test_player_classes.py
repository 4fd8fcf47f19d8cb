"""Classes of environments that are bit-identical so far: against every history written out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.identity import distinct_over_time
from gpusimbench.evaluator.player.classes import ComparableHashes, changes, compared, representatives
from gpusimbench.evaluator.read.recording import Recording
from tests.synthetic import cubes_field, grid, write_recording

HASHES = st.integers(1, 6).flatmap(
    lambda n: st.lists(st.lists(st.integers(0, 2), min_size=n, max_size=n), min_size=1, max_size=8)
).map(lambda rows: np.array(rows, dtype=np.uint64))  # fmt: skip


def _members(hashes: NDArray[np.uint64]) -> ComparableHashes:
    n_row, n = hashes.shape
    return ComparableHashes(np.zeros(n, dtype=np.int64), np.arange(n), 10 * np.arange(n_row), hashes, "")


def _histories(hashes: NDArray[np.uint64], row: int) -> list[tuple[int, ...]]:
    return [tuple(column) for column in hashes[: row + 1].T.tolist()]


@given(HASHES)
def test_classes_are_those_of_whole_histories(hashes: NDArray[np.uint64]) -> None:
    """Give at every step the count, leader and size that all hashes up to it have."""
    shown = list(range(0, hashes.shape[1], 2))
    found = changes(_members(hashes), shown)
    for row in range(len(hashes)):
        at = int(np.searchsorted(found.steps, 10 * row, side="right")) - 1
        histories = _histories(hashes, row)
        assert found.so_far[at] == len(set(histories))
        assert found.instant[at] == len(set(hashes[row].tolist()))
        mine = [histories[index] for index in shown]
        assert found.leader[at].tolist() == [mine.index(one) for one in mine]
        assert found.size[at].tolist() == [histories.count(one) for one in mine]


@given(HASHES)
def test_counts_are_those_of_the_metric(hashes: NDArray[np.uint64]) -> None:
    """Agree with the metric of distinct states over time, and part where it grows."""
    found, metric = changes(_members(hashes), [0]), distinct_over_time(hashes)
    grown = np.flatnonzero(np.diff(np.concatenate([[1], metric.histories])) > 0)
    assert found.splits.tolist() == (10 * grown).tolist()
    assert found.first_divergence == (10 * int(grown[0]) if grown.size else None)
    assert found.so_far[-1] == metric.histories[-1]


@given(HASHES, st.integers(1, 8))
def test_representatives_are_of_different_classes(hashes: NDArray[np.uint64], most: int) -> None:
    """Name one environment a class, as many as are asked for, those that part first ahead."""
    chosen = representatives(_members(hashes), most)
    histories = _histories(hashes, len(hashes) - 1)
    assert chosen[0] == 0
    assert len({histories[index] for index in chosen}) == len(chosen) == min(most, len(set(histories)))
    parted = [
        next((r for r in range(len(hashes)) if _apart(hashes, r, chosen[:k], c)), -1) for k, c in enumerate(chosen)
    ]
    assert parted[1:] == sorted(parted[1:])


def _apart(hashes: NDArray[np.uint64], row: int, before: list[int], one: int) -> bool:
    histories = _histories(hashes, row)
    return bool(before) and all(histories[one] != histories[other] for other in before)


def test_runs_are_compared_with_each_other(tmp_path: Path) -> None:
    """Count environments of all runs together; a run that ends elsewhere is a class of its own."""
    final = grid(2)
    runs = [write_recording(tmp_path, final + 0.001 * (run == 2), run=run) for run in range(3)]
    found = compared([Recording(path) for path in runs])
    assert found.hashes.shape == (6, 6)
    assert changes(found, [0, 4]).so_far.tolist() == [1, 2]
    assert representatives(found, 6) == [0, 4]
    assert found.member(2, 1) == 5


def test_bits_that_cannot_be_compared_give_a_reason(tmp_path: Path) -> None:
    """Refuse different precision and different origins in words, and compare runs at the origin they share."""
    double = Recording(write_recording(tmp_path, grid(2)))
    single = Recording(write_recording(tmp_path, grid(2, "float32"), field=cubes_field("float32")))
    assert "precision" in str(compared([double, single]))
    origins = ((0.0, 0.0, 0.0), (0.0, 5.0, 0.0))
    apart = [Recording(write_recording(tmp_path, grid(2), run=run, origins=origins)) for run in range(2)]
    assert "different origins" in str(compared(apart[:1]))
    found = compared(apart)
    assert found.env.tolist() == [0, 0]
    assert "2 of 4 environments" in found.left_out
