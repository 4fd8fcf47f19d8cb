"""Reproducibility regimes as published: Types 1 to 4."""

from __future__ import annotations

import math
from enum import IntEnum

DECIMALS_CM = 2

PRESENT_FROM_CM = 0.005
"""The smallest float64 that does not round to 0.00 cm: `is_present(v)` is v >= this."""


class Regime(IntEnum):
    """Published type, by which of the two variabilities is present."""

    PARALLEL_ONLY = 1
    NEITHER = 2
    BOTH = 3
    RUN_TO_RUN_ONLY = 4


REGIME_MEANING: dict[int, str] = {
    1: "Parallel envs of one run differ, and repeated runs agree, rounded to 0.01 cm.",
    2: "Parallel envs of one run agree, and repeated runs agree, rounded to 0.01 cm.",
    3: "Parallel envs of one run differ, and repeated runs differ, rounded to 0.01 cm.",
    4: "Parallel envs of one run agree, and repeated runs differ, rounded to 0.01 cm.",
}


def is_present(variability_cm: float) -> bool:
    """Whether a variability [cm] is nonzero after rounding to 0.01 cm (GPUSimBench definition).

    Raises:
        ValueError: the value is negative or not finite.
    """
    if not (math.isfinite(variability_cm) and variability_cm >= 0.0):
        raise ValueError(f"variability must be finite and not negative, got {variability_cm} cm")
    return round(variability_cm, DECIMALS_CM) > 0.0


def published_regime(parallel_cm: float, run_to_run_cm: float) -> Regime:
    """Regime of a simulator (GPUSimBench definition), an int from 1 to 4.

    A rounded planar distance: "absent" does not mean bit-identical. It belongs to one simulator,
    version, set of switches, GPU and scene, and is to be shown with them.

    Args:
        parallel_cm: parallel variability [cm].
        run_to_run_cm: run-to-run variability [cm].

    Raises:
        ValueError: a value is negative or not finite.
    """
    return {
        (True, False): Regime.PARALLEL_ONLY,
        (False, False): Regime.NEITHER,
        (True, True): Regime.BOTH,
        (False, True): Regime.RUN_TO_RUN_ONLY,
    }[is_present(parallel_cm), is_present(run_to_run_cm)]
