"""Episodes of tasks: success, return and length of head beside base, with environments as the units of the test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compare.finding import Change, Finding, Question, Settings, either_way, judged, not_compared
from gpusimbench.evaluator.episodes.comparison import difference_of, evenly_repeated, pairs_of
from gpusimbench.evaluator.episodes.outcome import RETURN, SUCCESS
from gpusimbench.evaluator.episodes.side import Episodes, choose, read_side
from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.read.episodes import At
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.group_runs import Runs
from gpusimbench.evaluator.results.metric import Axis, Direction
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.cases import PERMUTATIONS
from gpusimbench.schemas.errors import NothingComparable
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.text import plural

Values = NDArray[np.float64]
LENGTH = "length"
_TITLES = {SUCCESS: "success of episodes", RETURN: "return of episodes", LENGTH: "length of episodes"}
_BETTER = {SUCCESS: Direction.HIGHER, RETURN: Direction.HIGHER, LENGTH: Direction.NEITHER}
_UNITS = {LENGTH: "step"}
_AXES = {SUCCESS: Axis.EPISODES, RETURN: Axis.EPISODES, LENGTH: Axis.LENGTHS}


def compare_episodes(base: Runs, head: Runs, settings: Settings) -> Sequence[tuple[Axis, Finding | Question]]:
    """Success (where an info of that name was recorded), return and length; empty where neither side has episodes.

    As many episodes of every environment of both sides count, so that no length of episodes is favoured.
    """
    if not any(run.episodes for run in (*base, *head)):
        return ()
    try:
        sides = [read_side([Recording(run.path) for run in runs]) for runs in (base, head) if runs]
        if len(sides) < 2:
            raise NothingComparable("one side has no complete run")
        flag = SUCCESS if all(map(_tells_success, (*base, *head))) else None
        per_env = min(side.at_most for side in sides)
        one, other = (choose(side, per_env, flag, At.LAST) for side in sides)
    except NothingComparable as error:
        return [(Axis.EPISODES, not_compared(Axis.EPISODES, RETURN, _TITLES[RETURN], str(error)))]
    n = (len(base), len(head))
    together, even = pairs_of(other, one).formed, evenly_repeated(one, other)
    return [
        (_AXES[name], _compared(name, one.by_cluster(before), other.by_cluster(after), n, settings, together, even))
        for name, before, after in _quantities(one, other)
    ]


def _tells_success(run: Run) -> bool:
    return any((one.group, one.field, one.width) == (ENV, f"info_{SUCCESS}", 1) for one in run.fields)


def _quantities(one: Episodes, other: Episodes) -> list[tuple[str, NDArray[Any], NDArray[Any]]]:
    found: list[tuple[str, NDArray[Any], NDArray[Any]]] = [
        (RETURN, one.returns, other.returns),
        (LENGTH, one.lengths, other.lengths),
    ]
    if one.success is not None and other.success is not None:
        found.insert(0, (SUCCESS, one.success, other.success))
    return found


def _compared(
    name: str, base: Values, head: Values, n: tuple[int, int], settings: Settings, together: bool, even: bool
) -> Finding | Question:
    """A verdict that needs no statistics, or a question."""
    how = "pairs of one environment and number, which began alike" if together else "not paired"
    envs = str(len(base)) if len(base) == len(head) else f"{len(base)} and {len(head)}"
    first = plural(base.shape[1], "episode")
    finding = Finding(
        _AXES[name], name, _TITLES[name], Change.SAME, _BETTER[name], _UNITS.get(name, ""),
        base=float(base.mean()), head=float(head.mean()), n=n, tested_on="environments",
        method=f"mean over the first {first} of each environment ({envs} environments; {how})",
    )  # fmt: skip
    if together and np.array_equal(base, head):
        return replace(finding, note="the same in every episode")
    if np.ptp(base) == 0.0 and np.ptp(head) == 0.0:
        before, after = base[0, 0], head[0, 0]
        if before == after:
            return replace(finding, note="the same in every episode")
        if min(len(base), len(head)) > 1:
            large = abs(after - before) > settings.threshold * abs(before)
            change = judged(finding.direction, rises=after > before) if large else Change.SMALL
            return replace(finding, change=change, note="all episodes of a side have this value")
    return _Asked(finding, base, head, settings, together, even)


@dataclass(frozen=True)
class _Asked:
    """The test of one quantity, values of shape [env, episode]."""

    finding: Finding
    base: Values
    head: Values
    settings: Settings
    together: bool
    even: bool

    @property
    def least_p(self) -> float:
        """See Question."""
        n, m = len(self.base), len(self.head)
        ways = 2**n if self.together else math.comb(n + m, n)
        return 2 / max(2, min(ways, PERMUTATIONS + 1))

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question; what is as large as matters is by the ends of the interval of the difference."""
        name, unit = self.finding.name, self.finding.unit
        found = difference_of(name, unit, self.head, self.base, together=self.together, even=self.even)
        ends = known(found.ci95)
        least = self.settings.threshold * abs(float(self.base.mean()))
        tested = replace(
            self.finding, p_value=found.p_value, least_p=self.least_p, difference_ci95=ends, bounded=ends is not None,
            test=f"permutation test, {found.test}; interval of head - base by resampling environments",
        )  # fmt: skip
        low, high = ends or (-math.inf, math.inf)
        return either_way(tested, falls=low < -least, rises=high > least, beyond=low > least or high < -least)
