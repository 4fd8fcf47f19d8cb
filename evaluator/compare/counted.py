"""A question about how many runs of either side something is true of."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gpusimbench.evaluator.compare.finding import Change, Finding
from gpusimbench.evaluator.statistics.families import fisher, least_fisher


@dataclass(frozen=True)
class Counted:
    """Whether the shares of the two sides differ, by Fisher's exact test.

    finding     with what it says if they do
    base, head  in how many runs, of how many
    of          which runs are counted, in words
    """

    finding: Finding
    base: tuple[int, int]
    head: tuple[int, int]
    of: str

    @property
    def least_p(self) -> float:
        """See Question."""
        return least_fisher(self.base[0] + self.head[0], self.base[1], self.head[1])

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """See Question; the more uneven the runs fell, the smaller p, so that only the way they fell is left open."""
        found = replace(
            self.finding,
            p_value=fisher(self.base, self.head),
            least_p=self.least_p,
            test=f"Fisher's exact test of runs {self.of}",
        )
        even = self.base[0] * self.head[1] == self.head[0] * self.base[1]
        left = () if able or even else (found.change,)
        return found, replace(found, change=Change.UNCLEAR, left_open=left)
