"""What the comparison of two sets found, before any presentation."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.evaluator.compare.finding import FAILING, Change, Finding, Settings, exit_code_of
from gpusimbench.evaluator.compare.matching import Pair
from gpusimbench.evaluator.compare.numbers import Schedule
from gpusimbench.evaluator.inputs.reader import Unreadable
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.results.timed_work import TimedWork
from gpusimbench.schemas.errors import ExitCode


@dataclass(frozen=True)
class ComparedConfiguration:
    """One configuration of both sets.

    pair      its groups
    order     of its complete runs in time
    findings  in the order of the axes
    warnings  what a reader must know of how far the findings can be relied on
    notes     of runs that are not complete, and of those with another process on their GPU
    timed     what the throughputs of base and head were measured over
    """

    pair: Pair
    order: Schedule
    findings: tuple[Finding, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    timed: tuple[TimedWork, TimedWork] = (TimedWork(), TimedWork())


@dataclass(frozen=True)
class Result:
    """What the comparison of two sets found.

    compared    one for each configuration
    alone       groups without a partner: side, label, reason
    unreadable  side and file
    settings    what counts
    tests       statistical comparisons that count and could show something, which p-values are adjusted for; those of
                variability are a family of their own, and are not among them
    lost        recordings that were cut short or lost data
    notes       about the sets as a whole
    """

    compared: tuple[ComparedConfiguration, ...]
    alone: tuple[tuple[str, str, str], ...]
    unreadable: tuple[tuple[str, Unreadable], ...]
    settings: Settings
    tests: int
    lost: int
    notes: tuple[str, ...]

    @property
    def findings(self) -> list[Finding]:
        """The findings of all configurations."""
        return [finding for one in self.compared for finding in one.findings]

    @property
    def failing(self) -> list[Finding]:
        """Those that fail a gate."""
        return [finding for finding in self.findings if finding.fails(self.settings)]

    @property
    def comparable(self) -> bool:
        """Whether every configuration, and at least one, was compared on an axis that counts, beyond how runs ended."""
        return bool(self.compared) and all(
            any(
                f.change is not Change.NOT_COMPARED and counts(f.axis, self.settings)
                for f in one.findings
                if f.name != "complete_runs" or f.change in FAILING
            )
            for one in self.compared
        )

    @property
    def open(self) -> list[Finding]:
        """Those on an axis with a gate that neither fail nor pass."""
        return [finding for finding in self.findings if finding.undecided(self.settings)]

    @property
    def undecided(self) -> list[Axis]:
        """Axes with a gate on which some configuration is neither failed nor passed."""
        found = {finding.axis for finding in self.open}
        return [axis for axis in Axis if axis in found]

    @property
    def exit_code(self) -> ExitCode:
        """The exit code of gsb-compare."""
        lost = bool(self.unreadable or self.lost)
        return exit_code_of(failing=bool(self.failing), lost=lost, decided=self.comparable and not self.open)


def counts(axis: Axis, settings: Settings) -> bool:
    """Whether an axis decides."""
    return settings.expect_same or axis in settings.gates
