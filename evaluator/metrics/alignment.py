"""Sim-to-real gap: how far simulated outcomes lie from real ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.transport.pair import wasserstein1
from gpusimbench.evaluator.transport.points import planar_array


@dataclass(frozen=True)
class Gap:
    """Distance between simulated and real outcomes.

    value_cm         W1 between all simulated and all real points [cm]; the upper bound where there
                     are bounds
    exactness        "exact": the optimum up to float64 rounding; "certified": between bounds
    method           the solver that produced it
    extension        what goes beyond the published definition; None where nothing does
    low_cm           lower bound [cm]; the value where it is exact
    """

    value_cm: float
    exactness: str
    method: str
    extension: str | None
    low_cm: float


def sim_to_real_gap(simulated: npt.ArrayLike, real: npt.ArrayLike) -> Gap:
    """Sim-to-real gap of one run (GPUSimBench definition).

        W1 between the n_env * n_item simulated points and the n_trial * n_item real points

    The published definition assigns one to one, hence n_env = n_trial; other counts are solved as
    weighted transport and the result says so.

    Args:
        simulated: planar item positions [m], relative to each env's own origin, shape
            [n_env, n_item, 2].
        real: planar item positions [m] in the same frame, shape [n_trial, n_item, 2].

    Raises:
        ValueError: different item counts, or positions that are empty, not planar or not finite.
    """
    simulated = planar_array(simulated, "simulated", ndim=3)
    real = planar_array(real, "real", ndim=3)
    if simulated.shape[1] != real.shape[1]:
        raise ValueError(
            f"different scenes: {simulated.shape[1]} simulated items per env, {real.shape[1]} real items per trial"
        )
    transport = wasserstein1(simulated.reshape(-1, 2), real.reshape(-1, 2))
    return Gap(
        value_cm=transport.value * CM_PER_M,
        exactness=transport.exactness,
        method=transport.method,
        extension=transport.extension,
        low_cm=transport.low * CM_PER_M,
    )


@dataclass(frozen=True)
class GapTo:
    """The gap between a run and these real positions [m], shape [n_trial, n_item, 2]."""

    real: npt.NDArray[np.float64]

    def __call__(self, simulated: npt.NDArray[np.float64]) -> Gap:
        """Of one run, as sim_to_real_gap."""
        return sim_to_real_gap(simulated, self.real)
