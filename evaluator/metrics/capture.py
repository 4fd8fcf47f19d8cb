"""What capturing states costs, and whether it changes them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def overhead(captured_s: float, captured_steps: int, timed_s: float, timed_steps: int) -> float:
    """Time of a captured step over that of a timed one.

        (T_capture / N_capture) / (T_timed / N_timed)

    Args:
        captured_s: from the first step of the capture to the last one's state on the host [s].
        captured_steps: steps in that time.
        timed_s: wall time of the timed phase [s].
        timed_steps: steps of the timed phase.

    Raises:
        ZeroDivisionError: a count or a time is zero.
    """
    return captured_s / captured_steps / (timed_s / timed_steps)


def changes_states(
    timed_steps: npt.NDArray[np.int64],
    timed_hashes: npt.NDArray[np.uint64],
    captured_steps: npt.NDArray[np.int64],
    captured_hashes: npt.NDArray[np.uint64],
) -> bool | None:
    """Whether any state hash differs at a step that both the timed and the capture phase passed.

    Args:
        timed_steps: simulator steps, increasing, shape [row].
        timed_hashes: of the environments there, shape [row, env].
        captured_steps, captured_hashes: the same of the capture phase.

    Returns:
        None where no step was passed by both.
    """
    common, at_timed, at_captured = np.intersect1d(timed_steps, captured_steps, return_indices=True)
    return bool((timed_hashes[at_timed] != captured_hashes[at_captured]).any()) if len(common) else None
