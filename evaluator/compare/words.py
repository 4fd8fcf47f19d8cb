"""Findings as people read them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

from gpusimbench.evaluator.compare.compare import ComparedConfiguration, Result, counts
from gpusimbench.evaluator.compare.finding import DIFFERENT, Change, Finding
from gpusimbench.evaluator.episodes.document import difference, number
from gpusimbench.evaluator.render.numbers import NONE, bounds, figure, scaled
from gpusimbench.evaluator.results.metric import Axis, Direction
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

TITLES = ("", "base", "head", "head / base", "95 % interval", "p", "verdict")


def cells(finding: Finding, result: Result) -> tuple[str, ...]:
    """A finding as the texts of a table's row, in the order of TITLES."""
    base, head = (
        _amount(value, said, finding) for value, said in zip((finding.base, finding.head), finding.said, strict=True)
    )
    interval = bounds(finding.ci95, _times) if finding.ci95 else NONE
    if finding.difference_ci95:
        interval = f"by {bounds(finding.difference_ci95, partial(difference, name=finding.name, sign=True))}"
    p = NONE if finding.p_adjusted is None else f"{finding.p_adjusted:.2g}"
    ratio = NONE if finding.ratio is None else _times(finding.ratio)
    return title(finding), base, head, ratio, interval, p, verdict(finding, result)


def title(finding: Finding) -> str:
    """What is compared, in which unit."""
    return f"{finding.title} [{finding.unit}]" if finding.unit not in ("", "B") else finding.title


def verdict(finding: Finding, result: Result) -> str:
    """The verdict; capitals where it fails a gate, and a word where its axis does not decide."""
    too_few = "" if finding.p_adjusted is not None or finding.bounded else f" (too few {finding.tested_on})"
    if finding.undecided(result.settings):
        return f"undecided{too_few}"
    threshold = _threshold(finding, result)
    word = {
        Change.UNCLEAR: f"~{too_few}",
        Change.WITHIN: f"~ within {threshold}",
        Change.SMALL: f"differs, below {threshold}",
        Change.NEAR: f"differs, perhaps below {threshold}",
    }.get(finding.change, finding.change.value)
    if finding.drift and finding.change in DIFFERENT:
        word += ", or drift"
    if finding.fails(result.settings):
        return word.upper()
    different = finding.change in (Change.REGRESSION, Change.CHANGED)
    return f"{word} (not gated)" if different and not counts(finding.axis, result.settings) else word


def sentence(result: Result) -> str:
    """The verdict of the whole in one plain sentence."""
    return _verdicts(result)[0]


def headline(result: Result) -> str:
    """The verdict of the whole in one line, for programs."""
    return _verdicts(result)[1]


def _verdicts(result: Result) -> tuple[str, str]:
    """The verdict of the whole for people, and for programs."""
    same = result.settings.expect_same
    where = plural(len(result.compared), "configuration")
    undecided = ", ".join(axis.value for axis in result.undecided)
    if failing := result.failing:
        changed = all(f.change is Change.CHANGED for f in failing)
        differs = "differs from" if same or changed else "is worse than"
        kind = "NOT THE SAME" if same else "CHANGED" if changed else "REGRESSION"
        found = f"{_axes(failing)} ({plural(len(failing), 'finding')} in {where})"
        found += f"; not decided: {undecided}" if undecided else ""
        return f"FAILED: head {differs} base in {found}", f"{kind}: {found}"
    if not result.comparable:
        why = "in some configuration, base and head share no quantity that the verdict depends on"
        why = why if result.compared else "base and head have no configuration in common"
        return f"NOTHING COMPARED: {why}", "NOTHING COMPARED"
    differs, difference = ("differs from", "DIFFERENCE") if same else ("is worse than", "REGRESSION")
    if result.open:
        found = f"{undecided} ({plural(len(result.open), 'finding')} in {where})"
        return f"NOT DECIDED: whether head {differs} base in {found}", f"NOT DECIDED: {found}"
    gained = _axes(f for f in result.findings if f.change is Change.IMPROVEMENT)
    alone = f"{plural(len(result.alone), 'configuration')} without a partner" if result.alone else ""
    people = (
        f"PASSED: no sign that head {differs} base in {where}",
        f"head is better in {gained}" if gained else "",
        alone,
    )
    programs = (f"NO {difference} found in {where}", f"improved: {gained}" if gained else "", alone)
    return "; ".join(filter(None, people)), "; ".join(filter(None, programs))


def _axes(findings: Iterable[Finding]) -> str:
    return ", ".join(dict.fromkeys(finding.axis.value for finding in findings))


def heading(compared: ComparedConfiguration) -> str:
    """Which configuration."""
    key = compared.pair.base.key
    envs = plural(key.n_env, "env")
    return f"{compared.pair.label}, {key.scene}, {envs}, dt {key.dt:g} s"


def runs(compared: ComparedConfiguration) -> str:
    """How many runs, and in which order they were made."""
    one, other = compared.order.n
    order = f", in the order {compared.order.text} (A base, B head)" if one and other and compared.order.known else ""
    return f"{plural(one, 'complete run')} of base, {other} of head{order}"


def methods(compared: Sequence[ComparedConfiguration]) -> list[str]:
    """What each finding is of, and which way is better; each once."""
    lines = []
    for f in (f for one in compared for f in one.findings if f.change is not Change.NOT_COMPARED):
        better = "" if f.direction is Direction.NEITHER or not f.unit else f" ({f.direction.value} is better)"
        lines.append(f"{f.title}{better}: {f.method}")
    return list(dict.fromkeys(lines))


def tests(compared: ComparedConfiguration) -> list[str]:
    """How findings were tested, and of how many runs where these are not all; what shares a test shares a line."""
    found: dict[str, list[str]] = {}
    for f in compared.findings:
        n = f"n = {f.n[0]} and {f.n[1]}"
        if f.test:
            found.setdefault(f"{f.test}, {n}", []).append(f.title)
        elif f.change is not Change.NOT_COMPARED and f.n != compared.order.n and f.name != "complete_runs":
            found.setdefault(n, []).append(f.title)
    return [f"{', '.join(titles)}: {test}" for test, titles in found.items()]


def remarks(compared: ComparedConfiguration) -> list[str]:
    """What a reader must see beside the numbers: notes of findings, and what was not compared."""
    lines = [f"{f.title}: {f.note}" for f in compared.findings if f.note]
    reasons = gathered((f.missing, f.title) for f in compared.findings if f.change is Change.NOT_COMPARED)
    return [*lines, *(f"not compared: {', '.join(titles)}: {why}" for why, titles in reasons.items()), *compared.notes]


def undecided(compared: ComparedConfiguration, result: Result) -> list[str]:
    """What neither fails nor passes its gate, and why; what shares a reason shares a line."""
    reasons = gathered(
        (why, finding.title) for finding in compared.findings if (why := finding.undecided(result.settings))
    )
    return [f"{', '.join(titles)}: {why}" for why, titles in reasons.items()]


def legend(result: Result) -> list[str]:
    """What the columns mean."""
    findings, lines = result.findings, []
    if result.tests:
        alpha = _percent(result.settings.alpha)
        tests = plural(result.tests, "statistical comparison")
        lines.append(
            f"p: adjusted (Holm) for {tests} on axes that count, with enough runs to be significant; the chance of any "
            f"false alarm among them is at most {alpha}; intervals are not adjusted"
        )
    if any(f.axis is Axis.VARIABILITY and f.p_adjusted is not None for f in findings):
        lines.append(
            "p of W1 between envs and between runs: adjusted for these two only; the chance of a false alarm among "
            f"them is at most {_percent(result.settings.alpha)}"
        )
    passed = [f for f in findings if not f.undecided(result.settings)]
    if any(f.change in (Change.UNCLEAR, Change.WITHIN) for f in passed):
        lines.append("~: no difference shown with this number of runs; every value in the interval is possible")
    if result.open:
        lines.append(
            "undecided: the gate neither failed nor passed (exit code 5 if nothing fails); to decide, use more runs, "
            "longer runs, a larger --threshold, or --gate without the axis"
        )
    if any(f.p_value is None and f.change not in (Change.NOT_COMPARED, Change.SAME) for f in findings):
        lines.append("verdicts without a p are facts about these runs, not statistics")
    return lines


def settings_line(result: Result) -> str:
    """The settings that decide the verdict."""
    settings = result.settings
    gates = ", ".join(axis.value for axis in Axis if axis in settings.gates)
    if settings.expect_same:
        return f"base and head should be the same (--expect-same): every difference fails; must be decided: {gates}"
    least = f"{_percent(settings.threshold)} of an amount, or {settings.outcome_cm:g} cm"
    return f"gates: {gates}; changes below {least}, do not count"


def _threshold(finding: Finding, result: Result) -> str:
    if finding.unit in ("cm", "rad"):
        return f"{result.settings.least_outcome(finding.unit):g} {finding.unit}"
    amounts = [finding.base, finding.head]
    if finding.ci95 and finding.base is not None:
        amounts += [finding.base * end for end in finding.ci95]
    known = [amount for amount in amounts if amount is not None]
    least = {"B": "1 MB", "s": "1 ms"}.get(finding.unit)
    tiny = least and known and result.settings.matters(min(known), max(known))
    return least if least and tiny else _percent(result.settings.threshold)


def _times(ratio: float) -> str:
    return f"{ratio:.3f}" if 0.001 <= ratio < 1000 else f"{ratio:.3g}"


def _percent(share: float) -> str:
    return f"{share * 100:.3g} %"


def _amount(value: float | None, said: str, finding: Finding) -> str:
    if said:
        return said
    if value is None:
        return NONE
    if finding.unit == "B":
        return scaled(value, "B", "#.4g")
    if finding.axis in (Axis.EPISODES, Axis.LENGTHS):
        return number(value, finding.name)  # returns and lengths of any size, beside an interval with as many digits
    return f"{value:.3g}" if finding.unit == "s" else figure(value, finding.unit)
