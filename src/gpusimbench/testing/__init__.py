"""Determinism in a simulator's own tests: assertions that name the first number that differs.

    from gpusimbench.testing import assert_batch_invariant, assert_deterministic

    def test_it_repeats_itself():
        assert_deterministic(lambda: gymnasium.make_vec("HalfCheetah-v5", num_envs=4), steps=100)

What is compared is compared bit by bit: -0.0 is not 0.0, NaNs are equal only with the same payload, and another dtype,
another shape or a missing array is a difference. An assertion that fails says where: step, environment, array,
component, both numbers and their distance in units in the last place.

With pytest, the fixture `gsb` has the same three assertions, and ``--gsb-keep DIR`` keeps both sides of a failure as
recordings. The names in `__all__` are the public interface.
"""

from __future__ import annotations

from gpusimbench.testing.assertions import assert_batch_invariant, assert_deterministic, assert_identical

__all__ = ["assert_batch_invariant", "assert_deterministic", "assert_identical"]
