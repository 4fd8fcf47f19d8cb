"""Change points of a series: after which points its level is another, and by how much."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.jackknife import CONFIDENCE, mean_of

MIN_POINTS = 3
"""Fewer points have no spread beside a change."""

_ROUNDING = 1e-12  # values that are apart by less, in proportion, are taken for equal: sums of them round

_NO_NOISE = Missing("the points of each level are equal, so that nothing shows how much points differ by chance")

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ChangePoint:
    """One change of level, in the unit of the values.

    index       of the first point that has the new level
    begin, end  the points from `begin` to before `index` have the old level, those from `index` to before `end` the new
    before      mean of those
    after       mean of these
    ci95        of after - before, with the position taken as known; None where neither level has two points, or the
                points of each are equal
    p_value     chance of so clear a change, anywhere in the stretch in which it was found, were nothing changed there;
                missing where the points of each level are equal: however few they are, t is infinite
    """

    index: int
    begin: int
    end: int
    before: float
    after: float
    ci95: tuple[float, float] | None
    p_value: float | Missing

    @property
    def difference(self) -> float:
        """After - before."""
        return self.after - self.before


def change_points(values: npt.ArrayLike, level: float) -> list[ChangePoint]:
    """Where the mean of a series changes: circular binary segmentation (Olshen et al. 2004), in order.

    In a stretch of T points, every split into two parts, and every inner part against the rest (a change that is undone
    later), is a candidate. Both have one statistic, that of the t-test with one variance for all n points of the
    series, which are k stretches so far:

        t^2 = f B / (S - B),   f = n - k - 1, B = sum of squares between the two parts,
                               S = of all n points about the means of their stretches

    A stretch of few points, as behind a change that was made lately, is thus held to the noise of all others. p is
    bounded by Bonferroni's inequality over the candidates of the stretch (for normal values that are independent), half
    of the level for either kind, so that the many inner parts do not hide a change at the newest point:

        p = 2 N P(|t_f| >= t),   N = T - 1 splits, or (T - 1)(T - 2)/2 inner parts           (splits: Worsley 1979)

    The candidate with the smallest p divides its stretch if p <= level, and all stretches are searched again. The
    chance of any change point in a series whose values are independent and of one normal law is at most `level`.

    Args:
        values: one finite value a point, in order of time, shape [T].
        level: chance of a false alarm.

    Raises:
        ValueError: values of another shape or not finite; a level that is no probability.
    """
    series = np.asarray(values, dtype=np.float64)
    if series.ndim != 1 or not np.isfinite(series).all():
        raise ValueError(f"values must be finite, of shape [point], got {list(series.shape)}")
    if not 0 < level < 1:
        raise ValueError(f"level is a probability between 0 and 1, not {level:g}")
    found = _divide(series, level)
    ends = [0, *sorted(found), len(series)]
    return [
        _change(series, ends[i - 1], index, ends[i + 1], found[index])
        for i, index in enumerate(ends[1:-1], start=1)
    ]  # fmt: skip


def least_visible(values: npt.ArrayLike, level: float, before: Sequence[npt.ArrayLike] = ()) -> float | None:
    """By how much one more point would have to differ from the mean of these to be a change point, about.

        d = t s sqrt(1 + 1/m),   t as p = level asks of the search, s = pooled SD of all levels

    Args:
        values: the points since the last change, shape [m].
        level: as in change_points.
        before: the points of each earlier level.

    Returns:
        the difference, in the unit of the values; None where there is no point, or no level has two.
    """
    levels = [np.asarray(one, dtype=np.float64) for one in (values, *before)]
    m = len(levels[0])
    freedom = sum(len(one) - 1 for one in levels if len(one))
    if not m or freedom < 1:
        return None
    from scipy.special import stdtrit

    # of m + 1 points there are m splits; two sides, two kinds of candidates
    t = -float(stdtrit(freedom, level / (4 * m)))
    spread = math.sqrt(sum(float(((one - one.mean()) ** 2).sum()) for one in levels if len(one)) / freedom)
    return t * spread * math.sqrt(1 + 1 / m)


@dataclass(frozen=True)
class _Candidate:
    """A way to cut a stretch: sum of squares between its parts, how many ways of this kind there are, and the cuts."""

    between: float
    ways: int
    cuts: tuple[int, ...]


@dataclass(frozen=True)
class _Stretch:
    """Points without a change so far: sum of squares about their mean, and the best cut of either kind."""

    total: float = 0.0
    candidates: tuple[_Candidate, ...] = ()


def _divide(series: Floats, level: float) -> dict[int, float | Missing]:
    """The change points with their p-values."""
    found: dict[int, float | Missing] = {}
    if len(series) < MIN_POINTS:
        return found
    # in units of the largest distance from the first value: squares neither overflow nor vanish
    scale = float(np.abs(series - series[0]).max())
    known: dict[tuple[int, int], _Stretch] = {}
    while True:
        ends = [0, *sorted(found), len(series)]
        for low, high in itertools.pairwise(ends):
            if (low, high) not in known:
                known[low, high] = _stretch(series[low:high], low, scale)
        stretches = [known[pair] for pair in itertools.pairwise(ends)]
        total, freedom = sum(one.total for one in stretches), len(series) - len(stretches) - 1
        if freedom < 1:
            return found
        ranked = [(_p_value(c, total, freedom), c.cuts) for one in stretches for c in one.candidates]
        if not ranked:
            return found
        p, cuts = min(ranked, key=lambda one: (one[0] or 0.0, one[1]))
        if p and p > level:
            return found
        found.update((cut, p) for cut in cuts if cut not in found)


def _stretch(series: Floats, begin: int, scale: float) -> _Stretch:
    """Of the points from index `begin` on: where they would be cut, at one place or at two."""
    count = len(series)
    apart = series - series[0]
    if count < 2 or float(np.abs(apart).max()) <= _ROUNDING * float(np.abs(series).max()):
        return _Stretch()
    centred = apart / scale - (apart / scale).mean()
    sums = np.concatenate([[0.0], centred.cumsum()])
    begins, ends = np.triu_indices(count, k=1)
    ends, begins = ends[begins > 0], begins[begins > 0]  # a part that begins at 0 is the split behind it
    splits = np.arange(1, count)
    by_split = _between(sums[splits], splits, count)
    best = int(by_split.argmax())
    candidates = [_Candidate(float(by_split[best]), len(splits), (begin + int(splits[best]),))]
    if len(begins):
        by_part = _between(sums[ends] - sums[begins], ends - begins, count)
        best = int(by_part.argmax())
        cuts = (begin + int(begins[best]), begin + int(ends[best]))
        candidates.append(_Candidate(float(by_part[best]), len(begins), cuts))
    return _Stretch(float((centred**2).sum()), tuple(candidates))


def _between(sums: Floats, sizes: npt.NDArray[np.int64], count: int) -> Floats:
    """Sum of squares between a part and the rest, from the part's sum of centred values."""
    return np.asarray(sums**2 * (count / (sizes * (count - sizes))))


def _p_value(candidate: _Candidate, total: float, freedom: int) -> float | Missing:
    from scipy.special import stdtr  # what scipy.stats.t.cdf calls, without a second of imports

    if candidate.between <= 0.0:
        return 1.0
    within = total - candidate.between
    if within <= freedom * sys.float_info.epsilon * total:  # what sums of squares round by
        return _NO_NOISE
    t = math.sqrt(freedom * candidate.between / within)
    # twice for the two signs, twice for the two kinds of candidates
    return min(1.0, 4.0 * candidate.ways * float(stdtr(freedom, -t)))


def _change(series: Floats, begin: int, index: int, end: int, p_value: float | Missing) -> ChangePoint:
    sides = series[begin:index], series[index:end]
    before, after = (mean_of(side) for side in sides)
    freedom = end - begin - 2
    interval = None
    if freedom and any(np.ptp(side) > _ROUNDING * np.abs(side).max() for side in sides):
        from scipy.special import stdtrit

        spread = sum(float(((side - mean) ** 2).sum()) for side, mean in zip(sides, (before, after), strict=True))
        error = math.sqrt(spread / freedom * (1 / len(sides[0]) + 1 / len(sides[1])))
        reach = float(stdtrit(freedom, 0.5 + CONFIDENCE / 2.0)) * error
        interval = (after - before - reach, after - before + reach)
    return ChangePoint(index, begin, end, before, after, interval, p_value)


def steps_of(values: Sequence[float]) -> list[int]:
    """Where a series that has no noise takes another value: every index whose value is not that before it."""
    return [index for index in range(1, len(values)) if values[index] != values[index - 1]]
