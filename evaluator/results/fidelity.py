"""Whether the runs of a group keep to mechanics: the facts of several runs as one verdict for each check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Check, Facts, Measured, PhysicsFacts, Revision


class CheckVerdict(Enum):
    """What a check says of a group.

    HELD            every value of every run that was measured is within what mechanics allows and the step accounts for
    BROKEN          some value is not
    AT_REST         of a check that mechanics does not demand: every value is within its tolerance
    MOVING          some value is not
    NOT_APPLICABLE  no run could be measured
    """

    HELD = "held"
    BROKEN = "broken"
    AT_REST = "at rest"
    MOVING = "still moving"
    NOT_APPLICABLE = "not applicable"


DEMANDED = sum(check.demanded for check in Check)
"""How many checks of mechanics exist."""


@dataclass(frozen=True)
class FidelityRow:
    """One check of one group.

    n_run    that could be measured
    of_runs  runs that were looked at: of the others nothing is known
    found    values of all runs that could be measured, without a note; None where none could
    reason   why no run, or not every run, could be measured
    notes    what else was found, each sentence once
    """

    check: Check
    verdict: CheckVerdict
    n_run: int
    of_runs: int
    found: Measured | None
    reason: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fidelity:
    """All checks of one group.

    label      of the group
    scene      its name
    n_run      that were looked at
    n_env      environments of each; `looked_at` of them were measured
    exactness  "exact" where that is all, else "sampled"
    rows       in the order of the checks; empty where `checks_missing` says why nothing can be said
    revision   whose tolerances judged
    """

    label: str
    scene: str
    n_run: int
    n_env: int
    looked_at: int
    exactness: str
    rows: tuple[FidelityRow, ...]
    checks_missing: str = ""
    revision: Revision = NEWEST

    @property
    def held(self) -> int:
        """Checks of mechanics that hold."""
        return len(self.of(CheckVerdict.HELD))

    @property
    def checkable(self) -> int:
        """Checks of mechanics that could be made."""
        return self.held + len(self.of(CheckVerdict.BROKEN))

    @property
    def not_checkable(self) -> int:
        """Checks of mechanics, of all that exist, that could not be made."""
        return DEMANDED - self.checkable

    def of(self, verdict: CheckVerdict) -> tuple[FidelityRow, ...]:
        """The rows of that verdict."""
        return tuple(row for row in self.rows if row.verdict is verdict)


def fidelity(label: str, facts: Sequence[PhysicsFacts]) -> Fidelity:
    """The verdicts of a group, from the facts of its usable runs."""
    if not facts:
        return Fidelity(label, "", 0, 0, 0, "exact", (), "no run can be used")
    told = [one.facts for one in facts if not isinstance(one.facts, Missing)]
    first = next((one for one in facts if not isinstance(one.facts, Missing)), facts[0])
    rows = tuple(row for check in Check if (row := _row(check, told, len(facts))) is not None)
    reasons = dict.fromkeys(one.facts.reason for one in facts if isinstance(one.facts, Missing))
    why_not = "" if told else "; ".join(reasons)
    return Fidelity(
        label, first.scene, len(facts), first.n_env, first.looked_at, first.exactness, rows, why_not, first.revision
    )  # fmt: skip


def _row(check: Check, facts: Sequence[Facts], of_runs: int) -> FidelityRow | None:
    found = [one[check] for one in facts if check in one]
    if not found:
        return None
    told = [fact for fact in found if isinstance(fact, Measured)]
    reason = "; ".join(dict.fromkeys(fact.reason for fact in found if isinstance(fact, Missing)))
    if not told:
        return FidelityRow(check, CheckVerdict.NOT_APPLICABLE, 0, of_runs, None, reason)
    means = [(fact.mean, fact.count) for fact in told if fact.mean is not None]
    weight = sum(share for _, share in means)
    # runs of a group share scene and step; where rounding makes the tolerances differ, the largest is shown
    together = replace(
        max(told, key=lambda fact: fact.tolerance),
        mean=sum(mean * share for mean, share in means) / weight if means else None,
        least=min((fact.least for fact in told if fact.least is not None), default=None),
        most=max((fact.most for fact in told if fact.most is not None), default=None),
        count=sum(fact.count for fact in told),
        broken=sum(fact.broken for fact in told),
        note="",
    )
    notes = tuple(dict.fromkeys(fact.note for fact in told if fact.note))
    return FidelityRow(check, _verdict(check, together.broken), len(told), of_runs, together, reason, notes)


def _verdict(check: Check, broken: int) -> CheckVerdict:
    if check.demanded:
        return CheckVerdict.BROKEN if broken else CheckVerdict.HELD
    return CheckVerdict.MOVING if broken else CheckVerdict.AT_REST
