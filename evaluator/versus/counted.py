"""A question about how many runs of either side something is true of."""

from __future__ import annotations

from dataclasses import dataclass, replace

from evaluator.statistics.families import fisher, least_fisher
from evaluator.versus.finding import Finding


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

    def __call__(self, level: float) -> Finding:
        """See Question."""
        return replace(
            self.finding,
            p_value=fisher(self.base, self.head),
            least_p=self.least_p,
            test=f"Fisher's exact test of runs {self.of}",
        )
