"""Performance profiles: the share of episodes whose return exceeds a threshold, over thresholds that policies share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.episodes.side import Episodes
from gpusimbench.evaluator.statistics.cases import mean_interval

_THRESHOLDS = 51


@dataclass(frozen=True)
class Profile:
    """Of one policy (Agarwal et al. 2021, "score distributions"), a number for each threshold.

    share      of episodes with a larger return
    low, high  95 % interval at each threshold, by resampling environments; None for fewer than 8 environments
    """

    share: tuple[float, ...]
    low: tuple[float, ...] | None
    high: tuple[float, ...] | None


@dataclass(frozen=True)
class Profiles:
    """Of policies, at the same thresholds.

    thresholds  from the smallest return to the largest [unit of the reward]
    """

    thresholds: tuple[float, ...]
    policies: tuple[Profile, ...]


def profiles(sides: Sequence[Episodes]) -> Profiles:
    """The profiles of policies, in their order."""
    returns = np.concatenate([side.returns.ravel() for side in sides])
    thresholds = np.linspace(returns.min(), returns.max(), _THRESHOLDS)
    return Profiles(tuple(thresholds.tolist()), tuple(_profile(side, thresholds) for side in sides))


def _profile(side: Episodes, thresholds: NDArray[np.float64]) -> Profile:
    by_env = side.by_cluster((side.returns[:, :, None] > thresholds).mean(axis=1))  # [cluster, threshold]
    bands = [mean_interval(column) for column in by_env.T]
    known = [band for band in bands if band is not None]
    low, high = (tuple(band[end] for band in known) or None for end in (0, 1))
    return Profile(tuple(by_env.mean(axis=0).tolist()), low, high)
