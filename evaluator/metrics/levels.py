"""How equal samples are, in levels: to the bit, in another order, to rounding, to a tolerance, or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.divergence import as_words
from gpusimbench.evaluator.metrics.identity import count_distinct

MAX_ULP = 8.0
"""A position that a step recomputes in another order of its sums is off by an ULP or a few: each addition rounds by
half of one, and a body has some ten contacts. Eight float32 ULPs at 0.5 m are 0.5 um. What has grown beyond has been
amplified by the dynamics, and in a pile it goes on to grow."""

TOLERANCE_M = 1e-4
"""0.1 mm, to which published distances are rounded (0.01 cm)."""


class EqualityLevel(IntEnum):
    """How equal the samples are; a smaller number is a stronger statement."""

    BIT_IDENTICAL = 0
    EQUAL_UP_TO_ORDER = 1
    WITHIN_ULP = 2
    WITHIN_TOLERANCE = 3
    DIFFERENT = 4


@dataclass(frozen=True)
class Worst:
    """The number in which two samples lie furthest apart.

    samples     indices of the two
    env         index within a sample
    item        index of the body
    component   0, 1, 2: x, y, z
    difference  of the two numbers, without origins [m]
    ulp         the same in units in the last place of the body's position
    """

    samples: tuple[int, int]
    env: int
    item: int
    component: int
    difference: float
    ulp: float


@dataclass(frozen=True)
class AxisVerdict:
    """How equal the samples of an axis are.

    level       the strongest that holds
    max_ulp     limit of WITHIN_ULP
    tolerance   limit of WITHIN_TOLERANCE [m]; the resolution where that is coarser
    worst       None where nothing differs, and where a number is not finite
    worst_ulp   largest difference in ULP, which may be another body's than the worst; None where a number is not finite
    resolution  what storing one place twice can make of it [m]; None where bits were compared
    note        what a reader must see beside the level; may be empty
    order       what is in another order where the level is EQUAL_UP_TO_ORDER: "bodies", "environments" or
                "environments and bodies"; empty elsewhere
    """

    level: EqualityLevel
    max_ulp: float
    tolerance: float
    worst: Worst | None
    worst_ulp: float | None
    resolution: float | None
    note: str
    order: str = ""

    @property
    def text(self) -> str:
        """The level in words, with its limit."""
        return {
            EqualityLevel.BIT_IDENTICAL: "bit-identical",
            EqualityLevel.EQUAL_UP_TO_ORDER: f"equal up to the order of {self.order}",
            EqualityLevel.WITHIN_ULP: f"within {self.max_ulp:g} ULP",
            EqualityLevel.WITHIN_TOLERANCE: f"within {self.tolerance * 1000:.3g} mm",
            EqualityLevel.DIFFERENT: "different",
        }[self.level]


def verdict(
    samples: npt.NDArray[np.floating],
    *,
    hashes_agree: bool | None,
    origins: npt.NDArray[np.float64] | None = None,
    max_ulp: float = MAX_ULP,
    tolerance: float = TOLERANCE_M,
) -> AxisVerdict:
    """The level of one axis: of the envs of a run, or of runs.

    Every pair is covered without looking at pairs: of one number over all samples, the largest difference is that of
    its largest and its smallest value. An ULP is the spacing of the dtype at the largest coordinate of the body, since
    a coordinate near zero has ULPs of no meaning: it comes of terms that are as large as the others.

    Bit-identity is claimed for what the hashes cover, every step and field. Where they differ, equal positions at the
    sample step are a coincidence, and the samples different. EQUAL_UP_TO_ORDER: in each env the positions of the same
    bodies, bit by bit, in another order; or the same envs in other places, with their bodies in order or not. Envs at
    different origins are compared without them, in float64: their bits mean nothing, and the spacing of the recorded
    numbers is the finest tolerance there is.

    Args:
        samples: positions as recorded [m], float32 or float64, shape [sample, env, item, width]; envs of one run are
            samples of one env each, [env, 1, item, width].
        hashes_agree: the state hashes of all samples are equal at all recorded steps; None where there are none.
        origins: of the samples [m], shape [sample, width], where positions include them; None where they do not.
        max_ulp: limit of WITHIN_ULP, not negative.
        tolerance: limit of WITHIN_TOLERANCE [m], not negative.

    Raises:
        ValueError: shapes that do not agree, fewer than two samples, a limit that is negative or not finite, or hashes
            that are equal for samples which are not.
    """
    _check(samples, origins, max_ulp, tolerance)
    if origins is not None and (origins != origins[0]).any():
        return _beside_origins(samples, origins, max_ulp, tolerance)
    n_distinct = count_distinct(samples)
    if hashes_agree and n_distinct > 1:
        raise ValueError("the state hashes are equal, but the positions at the sample step are not")
    note = "" if hashes_agree is not None else "at the sample step alone: there are no state hashes"
    worst, worst_ulp = _worst(samples.astype(np.float64), samples)
    order = _other_order(samples) if n_distinct > 1 else ""
    if n_distinct == 1:
        level = EqualityLevel.BIT_IDENTICAL
        if hashes_agree is False:
            level = EqualityLevel.DIFFERENT
            note = "the positions are equal at the sample step, and states differ at other steps or in other fields"
    elif order:
        level = EqualityLevel.EQUAL_UP_TO_ORDER
        note = _joined(note, "at the sample step")
    elif worst_ulp is None:
        level, note = EqualityLevel.DIFFERENT, _joined(note, "some positions are not finite")
    else:
        level = _by_size(_difference(worst), worst_ulp, max_ulp, tolerance)
    return AxisVerdict(level, max_ulp, tolerance, worst, worst_ulp, None, note, order)


def _beside_origins(
    samples: npt.NDArray[np.floating], origins: npt.NDArray[np.float64], max_ulp: float, tolerance: float
) -> AxisVerdict:
    worst, worst_ulp = _worst(samples.astype(np.float64) - origins[:, np.newaxis, np.newaxis, :], samples)
    if worst_ulp is None:
        note = "some positions are not finite"
        return AxisVerdict(EqualityLevel.DIFFERENT, max_ulp, tolerance, None, None, None, note)
    resolution = float(np.spacing(np.abs(samples).max()))
    # each of two numbers is off by half a spacing, and the origins' own sums in float64 by next to nothing
    limit = max(tolerance, resolution)
    note = (
        f"at different origins bits cannot be compared: {samples.dtype} resolves {resolution * 1000:.2g} mm there, and "
        "nothing finer is claimed"
    )
    if _difference(worst) <= resolution:
        note += "; all differences are below that"
    level = EqualityLevel.WITHIN_TOLERANCE if _difference(worst) <= limit else EqualityLevel.DIFFERENT
    return AxisVerdict(level, max_ulp, limit, worst, worst_ulp, resolution, note)


def _by_size(difference: float, worst_ulp: float, max_ulp: float, tolerance: float) -> EqualityLevel:
    # far from the origin an ULP is coarser than the tolerance, and no stronger statement than that
    if difference > tolerance:
        return EqualityLevel.DIFFERENT
    return EqualityLevel.WITHIN_ULP if worst_ulp <= max_ulp else EqualityLevel.WITHIN_TOLERANCE


def _difference(worst: Worst | None) -> float:
    return 0.0 if worst is None else worst.difference


def _worst(local: npt.NDArray[np.float64], recorded: npt.NDArray[np.floating]) -> tuple[Worst | None, float | None]:
    """The worst number, None where none differs, and the largest difference in ULP; neither where one is not finite.

    Both arrays are [sample, env, item, component]; local is without origins.
    """
    if not np.isfinite(recorded).all():
        return None, None
    low, high = local.argmin(axis=0), local.argmax(axis=0)
    with np.errstate(over="ignore"):  # of numbers that far apart, the difference is infinite
        apart = np.ptp(local, axis=0)
    # of the recorded dtype, at the largest coordinate that the body has in any sample
    spacing = np.spacing(np.abs(recorded).max(axis=(0, 3))).astype(np.float64)
    ulps = apart / spacing[..., np.newaxis]
    env, item, component = (int(i) for i in np.unravel_index(int(apart.argmax()), apart.shape))
    at = (env, item, component)
    if apart[at] == 0:
        return None, 0.0
    pair = sorted((int(low[at]), int(high[at])))
    worst = Worst((pair[0], pair[1]), env, item, component, float(apart[at]), float(ulps[at]))
    return worst, float(ulps.max())


def _other_order(samples: npt.NDArray[np.floating]) -> str:
    """What is in another order in samples that differ; empty where they are not equal up to any."""
    words = as_words(samples)
    if _one_set_of_envs(words):
        return "environments"
    bodies = np.take_along_axis(words, np.lexsort(np.moveaxis(words, -1, 0), axis=-1)[..., np.newaxis], axis=-2)
    if count_distinct(bodies) == 1:
        return "bodies"
    return "environments and bodies" if _one_set_of_envs(bodies) else ""


def _one_set_of_envs(samples: npt.NDArray[np.unsignedinteger]) -> bool:
    """Whether all samples have the same envs, bit by bit, each as often; what differs is found at the second."""
    first = sorted(env.tobytes() for env in samples[0])
    return all(sorted(env.tobytes() for env in sample) == first for sample in samples[1:])


def _joined(first: str, second: str) -> str:
    return f"{first}; {second}" if first else second


def _check(
    samples: npt.NDArray[np.floating], origins: npt.NDArray[np.float64] | None, max_ulp: float, tolerance: float
) -> None:
    if samples.ndim != 4 or samples.size == 0 or samples.dtype not in (np.float32, np.float64):
        raise ValueError(
            f"samples must be float32 or float64, [sample, env, item, width], got {samples.dtype} {list(samples.shape)}"
        )
    if len(samples) < 2:
        raise ValueError("a verdict needs at least two samples, got 1")
    if origins is not None and origins.shape != (len(samples), samples.shape[-1]):
        raise ValueError(f"origins must have shape [sample, width], got {list(origins.shape)}")
    if not (np.isfinite(max_ulp) and max_ulp >= 0 and np.isfinite(tolerance) and tolerance >= 0):
        raise ValueError(f"limits must be finite and not negative, got {max_ulp} ULP and {tolerance} m")
