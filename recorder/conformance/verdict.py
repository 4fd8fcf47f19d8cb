"""How a check says what it found."""

from __future__ import annotations

from typing import NoReturn
from unittest import SkipTest

import numpy as np
from numpy.typing import ArrayLike, NDArray


class NotApplicable(SkipTest):
    """The adapter has no such ability, or none that can be checked here; the message is the reason.

    pytest and unittest count a test that raises it as skipped.
    """


def expect(holds: bool | np.bool_, message: str) -> None:
    """AssertionError with this message where it does not hold; unlike `assert`, also under python -O."""
    if not holds:
        fail(message)


def fail(message: str) -> NoReturn:
    """AssertionError with this message."""
    raise AssertionError(message)


def expect_close(
    found: NDArray[np.floating],
    expected: ArrayLike,
    *,
    atol: ArrayLike,
    what: str,
    unit: str,
    rtol: float = 0.0,
    first_step: int = 0,
) -> None:
    """Compare arrays, expected broadcast to found; says where they differ most. Not-a-number is close to nothing.

    found       its first axes are [step, env]
    atol        broadcast to found, too
    first_step  of found
    """
    wanted = np.broadcast_to(np.asarray(expected, dtype=np.float64), found.shape)
    error = np.abs(found.astype(np.float64) - wanted)
    allowed = np.broadcast_to(np.asarray(atol, dtype=np.float64), found.shape) + rtol * np.abs(wanted)
    excess = np.where(np.isnan(error), np.inf, error - allowed)
    if not found.size or excess.max() <= 0:
        return
    step, env, *rest = (int(i) for i in np.unravel_index(int(excess.argmax()), excess.shape))
    place = tuple(rest[:-1])  # the last axis holds the components of one vector, which are shown together
    got, want = found[(step, env, *place)], wanted[(step, env, *place)]
    fail(
        f"{what}: expected {_numbers(want)} {unit} within {allowed[(step, env, *place)].max():.2g}, "
        f"found {_numbers(got)} (step {first_step + step}, env {env})"
    )


def _numbers(values: ArrayLike) -> str:
    flat = np.atleast_1d(np.asarray(values, dtype=np.float64))
    text = ", ".join(f"{value:.6g}" for value in flat)
    return text if flat.size == 1 else f"({text})"
