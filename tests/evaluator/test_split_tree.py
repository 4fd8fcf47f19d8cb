"""Split trees: who left whom, and when."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.metrics.identity import SplitTree, distinct_over_time, split_tree


def tree_of(hashes: np.ndarray) -> SplitTree:
    """The tree of some hashes, at steps 10, 11, ..."""
    return split_tree(np.arange(10, 10 + len(hashes)), distinct_over_time(hashes.astype(np.uint64)))


def test_a_known_tree() -> None:
    """Follow five envs of which three leave together and one of those leaves later."""
    rows = [[1, 1, 1, 1, 1], [1, 2, 1, 2, 2], [1, 1, 1, 1, 1], [5, 5, 5, 6, 5]]
    found = tree_of(np.array(rows))
    assert [(b.sample, b.parent, b.step, b.left, b.stayed, b.members) for b in found.branches] == [
        (0, None, 10, 5, 2, (0, 2)),
        (1, 0, 11, 3, 2, (1, 4)),
        (3, 1, 13, 1, 1, (3,)),
    ]
    assert (found.not_kept, found.first_step, found.last_step) == (0, 10, 13)


def test_one_history_is_one_branch() -> None:
    """Give samples that never differ one branch, and no steps one as well."""
    assert len(tree_of(np.ones((4, 3))).branches) == 1
    none = tree_of(np.ones((0, 3)))
    assert (len(none.branches), none.first_step, none.last_step) == (1, 0, 0)


@given(seed=st.integers(0, 2**32), n_row=st.integers(1, 8), n_sample=st.integers(1, 9), of_runs=st.booleans())
def test_tree_against_histories(seed: int, n_row: int, n_sample: int, of_runs: bool) -> None:
    """Find every branch where two histories part for the first time, by comparing them pair by pair."""
    shape = (n_row, n_sample, 2) if of_runs else (n_row, n_sample)
    hashes = np.random.default_rng(seed).integers(0, 2, shape).astype(np.uint64)
    found = tree_of(hashes)
    flat = hashes.reshape(n_row, n_sample, -1)
    part = np.array(
        [
            [next((r for r in range(n_row) if (flat[r, a] != flat[r, b]).any()), n_row) for b in range(n_sample)]
            for a in range(n_sample)
        ]
    )
    branches = {b.sample: b for b in found.branches}
    # a class is named by its lowest sample
    assert sorted(branches) == [s for s in range(n_sample) if all(part[s, e] < n_row for e in range(s))]
    for branch in found.branches[1:]:
        s = branch.sample
        latest = max(part[s, :s])  # when the last lower sample is left
        assert branch.step == 10 + latest
        assert branch.parent is not None
        assert found.branches[branch.parent].sample == min(e for e in range(s) if part[s, e] == latest)
        assert branch.left == sum(part[s, e] > latest for e in range(n_sample))
        assert branch.members == tuple(e for e in range(n_sample) if part[s, e] == n_row)
        assert branch.stayed == len(branch.members)
    assert sum(b.stayed for b in found.branches) == n_sample


def test_many_branches_are_counted() -> None:
    """Keep the branches that left first, and count the rest; name no more members than fit."""
    n_sample = 5 * 64
    hashes = np.zeros((n_sample, n_sample))
    for row in range(1, n_sample):
        hashes[row:, row] = row
    found = tree_of(hashes)
    assert len(found.branches) == 64
    assert found.not_kept == n_sample - 64
    assert [b.sample for b in found.branches] == list(range(64))
    assert len(tree_of(np.ones((1, 99))).branches[0].members) == 16


@pytest.mark.parametrize("n_sample", [1, 7])
def test_parents_left_before(n_sample: int) -> None:
    """Put every parent before its branches."""
    hashes = np.random.default_rng(3).integers(0, 3, (6, n_sample))
    branches = tree_of(hashes).branches
    assert all(b.parent is None or b.parent < at for at, b in enumerate(branches))
