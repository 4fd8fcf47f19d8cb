"""From what was found to a verdict: the strongest statement that holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from gpusimbench.evaluator.audit.distribution import ALPHA, LawTest, Unit, runs_needed
from gpusimbench.evaluator.missing import every
from gpusimbench.schemas.commands.progress import duration


class AuditLevel(Enum):
    """What a replay came to, strongest first. What holds implies all that stand below it, but for `different`."""

    BIT_IDENTICAL = "bit-identical"
    SAME_UP_TO_ENV_ORDER = "same-up-to-env-order"
    WITHIN_ULPS = "within-ulps"
    SAME_DISTRIBUTION = "same-distribution"
    DIFFERENT = "different"

    def reaches(self, required: AuditLevel) -> bool:
        """Whether this is what is required, or more."""
        order = list(AuditLevel)
        return order.index(self) <= order.index(required)


@dataclass(frozen=True)
class Match:
    """A replay beside the original that it is closest to.

    bit_identical         every number of it is the same, bit for bit
    same_up_to_env_order  its environments are the same in another order; None where that cannot be told
    max_ulp               largest known distance of two numbers in units in the last place; None where none is known
    steps                 recorded steps that this is over
    left_out              what of the original was not compared; empty where everything was
    no_ulps               why other numbers may be further apart; empty where all are known
    signs_differ          whether numbers of opposite signs are among them, so that `max_ulp` says nothing
    """

    bit_identical: bool
    same_up_to_env_order: bool | None
    max_ulp: int | None
    steps: int = 0
    left_out: str = ""
    no_ulps: str = ""
    signs_differ: bool = False


@dataclass(frozen=True)
class Rung:
    """A level, whether it holds (None: it could not be decided), and why, in a sentence."""

    level: AuditLevel
    holds: bool | None
    said: str


@dataclass(frozen=True)
class AuditVerdict:
    """The ladder.

    rungs  strongest level first
    level  the strongest that holds; None where none does and the last is not refuted
    law    the test of one law, or why there is none; None where a stronger level holds
    """

    rungs: tuple[Rung, ...]
    level: AuditLevel | None
    law: LawTest | str | None

    def meets(self, required: AuditLevel) -> bool | None:
        """Whether the required level holds, or a stronger one; None where that could not be decided."""
        held = [rung.holds for rung in self.rungs if rung.level.reaches(required)]
        if True in held:
            return True
        return None if None in held else False


def ladder(
    matches: Sequence[Match],
    test: Callable[[], LawTest | str],
    *,
    max_ulps: int,
    originals: int,
    compared: str = "every bit",
    each_s: float = 0.0,
) -> AuditVerdict:
    """The verdict over all replays: a level holds where it holds for each of them.

    test       makes the test of one law, or says why there is none; asked where no stronger level holds
    max_ulps   largest distance in units in the last place that counts as "within"
    originals  how many there are
    compared   what is the same where a replay is bit-identical
    each_s     how long a replay takes on this machine [s], from those that were made; 0 where that is not known
    """
    rungs = [_bits(matches, compared), _order(matches), _ulps(matches, max_ulps)]
    reached = next((rung.level for rung in rungs if rung.holds), None)
    if reached is not None:
        follows = f"follows from {reached.value}"
        below = [level for level in list(AuditLevel)[:-1] if reached.reaches(level) and level is not reached]
        kept = [rung for rung in rungs if rung.level not in below]
        return AuditVerdict((*kept, *(Rung(level, True, follows) for level in below)), reached, None)
    law = test()
    rungs.append(_law(law, originals, each_s))
    by_law = {True: AuditLevel.SAME_DISTRIBUTION, False: AuditLevel.DIFFERENT, None: None}
    return AuditVerdict(tuple(rungs), by_law[rungs[-1].holds], law)


def _bits(matches: Sequence[Match], compared: str) -> Rung:
    same = sum(m.bit_identical for m in matches)
    said = f"{same} of {len(matches)} replays agree with an original in {compared}"
    return _if_complete(Rung(AuditLevel.BIT_IDENTICAL, every(m.bit_identical for m in matches).holds, said), matches)


def _order(matches: Sequence[Match]) -> Rung:
    held = [m.bit_identical or m.same_up_to_env_order for m in matches]
    if (holds := every(held).holds) is None:
        return Rung(AuditLevel.SAME_UP_TO_ENV_ORDER, None, "environments cannot be compared with others")
    said = f"{sum(h is True for h in held)} of {len(matches)} replays have the environments of an original in any order"
    return _if_complete(Rung(AuditLevel.SAME_UP_TO_ENV_ORDER, holds, said), matches)


def _ulps(matches: Sequence[Match], most: int) -> Rung:
    same = [m.bit_identical or m.same_up_to_env_order is True for m in matches]
    found = [0 if equal else m.max_ulp for m, equal in zip(matches, same, strict=True)]
    known = [k for k in found if k is not None]
    over = f" over {min(m.steps for m in matches)} recorded steps" if any(m.steps for m in matches) else ""
    far = max(known, default=0)
    signs = far > most and any(m.signs_differ for m, equal in zip(matches, same, strict=True) if not equal)
    said = f"largest distance {far:,} ULP{over}; {most} are allowed"
    if signs:
        said = f"numbers have opposite signs{over}; {most} ULP are allowed"
    if known and max(known) > most:
        return Rung(AuditLevel.WITHIN_ULPS, False, said)
    unknown = dict.fromkeys(m.no_ulps for m, equal in zip(matches, same, strict=True) if m.no_ulps and not equal)
    if unknown:
        return Rung(AuditLevel.WITHIN_ULPS, None, f"{said}, but others are not known: {'; '.join(unknown)}")
    if not found or len(known) < len(found):
        return Rung(AuditLevel.WITHIN_ULPS, None, "numbers cannot be compared in units in the last place")
    return _if_complete(Rung(AuditLevel.WITHIN_ULPS, True, said), matches)


def _if_complete(rung: Rung, matches: Sequence[Match]) -> Rung:
    """The same, undecided where it holds for less than the original."""
    left_out = dict.fromkeys(m.left_out for m in matches if m.left_out)
    if not rung.holds or not left_out:
        return rung
    said = f"{rung.said}; not everything of the original was compared"
    if rung.level is AuditLevel.BIT_IDENTICAL or not all(m.bit_identical for m in matches):
        said += f": {'; '.join(left_out)}"  # once: other rungs stand below that one
    return Rung(rung.level, None, said)


def _law(law: LawTest | str, originals: int, each_s: float) -> Rung:
    if isinstance(law, str):
        return Rung(AuditLevel.SAME_DISTRIBUTION, None, law)
    floor = f"up to {law.floor_q95_cm:.3g} cm in 95 % if they have one distribution"
    far = f"W1 at {law.time:g} s: {law.observed_cm:.3g} cm ({floor}), p = {law.p_value:.2g}"
    said = f"{far}: {law.originals} original and {law.replays} replayed {law.unit.value} exchanged"
    if law.envs_per_run < law.envs:
        said += f", {law.envs_per_run} of {law.envs} envs each"
    if law.unit is Unit.ENVIRONMENTS:
        said += "; without power if results depend on the number of an environment: "
        said += f"{_more_runs(originals, each_s)} would exchange runs"
    if law.rejects:
        return Rung(AuditLevel.SAME_DISTRIBUTION, False, said)
    if not law.can_reject:
        few = f"too few to show a difference (p is at least {law.least_p:.2g}): give {_more_runs(originals, each_s)}"
        return Rung(AuditLevel.SAME_DISTRIBUTION, None, f"{said}; {few}")
    return Rung(AuditLevel.SAME_DISTRIBUTION, True, f"{said}; not rejected at {ALPHA:g}")


def _more_runs(originals: int, each_s: float) -> str:
    """The option with which the test can reject, and how long its replays would take on this machine."""
    count = runs_needed(originals)
    return f"--runs {count}" + (f" (about {duration(count * each_s)} on this machine)" if each_s else "")
