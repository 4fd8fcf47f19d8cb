"""What gsb-episodes says: the verdict, success and return with intervals, the comparison; and the same as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from gpusimbench.evaluator.episodes.comparison import Comparison, Difference
from gpusimbench.evaluator.episodes.dependence import Across, Dependence, Setting
from gpusimbench.evaluator.episodes.outcome import SUCCESS, Outcome, Profiles, Quantity
from gpusimbench.evaluator.episodes.side import Choice
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import NONE, Block, Cell, Document, Text, Tone, facts, items, table
from gpusimbench.evaluator.render.numbers import bounds
from gpusimbench.schemas.text import few, plural

_QUANTITIES = ("", "mean", "95 %", "IQM", "95 %", "first to finish", "detectable")
_DIFFERENCES = ("", "difference", "95 %", "p", "p, Holm", "detectable")
_NOTABLE = 0.01
_NUMBERS = 4
_DIGITS = 6
"""Decimals of a share of success at most."""

_MOST_DISTINCT = 0.95
_DETECTABLE = "detectable: the smallest difference that {} would show with a probability of 80 % at the 5 % level."

_WORDS = {"n_env": "number of environments", "device": "device", "version": "version of the simulator"}
_FEW_ENVS = 8


def episodes_document(policy: Outcome, against: Outcome | None, comparison: Comparison | None) -> Document:
    """The document of one policy, or of two and their comparison."""
    blocks: list[Block] = []
    if comparison is not None:
        blocks.append(Text(_verdict(comparison)))
    for one in (policy, against):
        if one is not None:
            blocks += _policy(one, "recordings" if against is None else "first" if one is policy else "against")
    if comparison is not None:
        blocks += _compared(comparison)
    return Document("", tuple(blocks))


def dump_json(policy: Outcome, against: Outcome | None, comparison: Comparison | None, profiles: Profiles) -> str:
    """The document that ``gsb-episodes --json`` writes."""
    return dump(
        document_of({
            "policy": record(policy),
            "against": record(against) if against else None,
            "comparison": comparison,
            "profiles": profiles,
        })
    )  # fmt: skip


def warnings(of: Outcome) -> Iterator[str]:
    """What a reader of the numbers must know, a sentence each."""
    if of.repeats:
        yield (
            f"{plural(len(of.repeats), 'recording')} left out, bit for bit the same as one that counts: "
            f"{few(of.repeats, _NUMBERS)}. Repeated runs of one seed are no further sample; record other seeds for more"
        )
    if repeats := of.n_env - of.clusters:
        yield (
            f"{repeats} of {of.n_env} environments began as another one of their seed did: these repeats are averaged, "
            f"so that {plural(of.clusters, 'environment')} count. For more, record seeds at least the number of "
            "environments apart"
        )
    for quantity in of.quantities:
        early = quantity.finish_order
        if early.biased:
            yield (
                f"the mean {quantity.name} of the {of.episodes} episodes that finished first is "
                f"{number(early.mean, quantity.name)}, off by {difference(early.difference, quantity.name, sign=True)} "
                f"{interval(early.ci95, quantity, shown=difference)}: short episodes are too frequent among them"
            )
        for what, p in (("environment", quantity.env_p), ("number of the episode in it", quantity.number_p)):
            if not isinstance(p, Missing) and p < _NOTABLE:
                yield f"{quantity.name} depends on the {what} (p = {p:.2g}): the mean is over those that were recorded"
    if of.chosen is Choice.LARGEST:
        yield (
            f"{plural(of.per_env, 'episode')} per environment is what this recording happens to have, so that short "
            "episodes may be slightly too frequent: choose --per-env before you record"
        )
    if len(of.n_envs) > 1:
        yield (
            f"recordings of {few(list(map(str, of.n_envs)), _NUMBERS)} environments are evaluated together; --across "
            "n_env tests whether results depend on that number"
        )
    if of.distinct_starts < _MOST_DISTINCT * of.clusters * of.per_env:
        yield (
            f"{of.distinct_starts} distinct first observations among {of.clusters * of.per_env} episodes: if task and "
            "policy are deterministic, episodes that began alike are copies, and the intervals are too narrow"
        )


def record(of: Outcome) -> dict[str, object]:
    """The outcome of one policy as JSON has it."""
    return {**values_of(of), "warnings": list(warnings(of))}


def _policy(of: Outcome, title: str) -> Iterator[Block]:
    lost = f"; {of.n_left_out} finished episodes are left out" if of.n_left_out else ""
    yield facts(
        (title, Cell(", ".join(of.files), code=True)),
        ("task", of.scene),
        (
            "episodes",
            f"{of.episodes}: the first {_several(of.per_env)}of each of {plural(of.n_env, 'environment')}{lost}",
        ),
        (
            "ended",
            f"{of.terminated} terminated, the other {of.episodes - of.terminated} truncated; "
            f"mean length {of.mean_length:.4g} steps",
        ),
        *([("success", f"{of.success} at {AT[of.success_at.value]}")] if of.success else []),
    )
    yield table("episodes", "", _QUANTITIES, [_row(one) for one in of.quantities])
    method = "; ".join(f"{one.name}: {one.method}" for one in of.quantities)
    missing = [(one.name, one.ci95.reason) for one in of.quantities if isinstance(one.ci95, Missing)]
    why = "".join(f"No interval of {name}: {reason}. " for name, reason in missing)
    yield Text(f"95 %: {method}. {why}{_legend('a comparison with as many episodes of another policy', of.quantities)}")
    if told := list(warnings(of)):
        yield items(*told, tone=Tone.WARNING)


def _several(number: int) -> str:
    return f"{number} " if number > 1 else ""


AT = {"last": "the last step", "any": "any step"}
"""Where a flag counts, in words."""

POINTS = "pp: percentage points."
"""The unit of a `difference` of success."""


def _legend(what: str, shown: Sequence[Quantity | Difference]) -> str:
    return " ".join([_DETECTABLE.format(what), *([POINTS] if any(one.name == SUCCESS for one in shown) else [])])


def _row(of: Quantity) -> list[Cell | str]:
    early = of.finish_order
    return [
        of.name,
        number(of.mean, of.name),
        interval(of.ci95, of),
        number(of.iqm, of.name),
        interval(of.iqm_ci95, of),
        Cell(number(early.mean, of.name), early.mean, tone=Tone.WARNING if early.biased else Tone.PLAIN),
        difference(of.least_shown, of.name),
    ]


def _compared(found: Comparison) -> Iterator[Block]:
    pairs = found.pairs
    if pairs.formed:
        how = f"paired: the {pairs.pairs} pairs of the same environment and episode number began alike, bit for bit"
    elif pairs.pairs:
        how = f"not paired: {pairs.alike} of {pairs.pairs} pairs of the same environment and episode number began alike"
        how += "; with --per-env 1 and one seed of reset they usually all do" if pairs.alike else ""
    else:
        how = "not paired: the policies have other numbers of environments, or other observations"
    yield facts(("comparison", how))
    yield table("differences", "", _DIFFERENCES, [_compared_row(one) for one in found.differences])
    tests = "; ".join(f"{one.name}: {one.test}" for one in found.differences)
    discordant = [
        f" The first policy alone succeeded in {plural(one.discordant.only_first, 'pair')}, the other alone in "
        f"{one.discordant.only_second}."
        for one in found.differences
        if not isinstance(one.discordant, Missing)
    ]
    yield Text(
        f"first minus against. Tests: {tests}.{''.join(discordant)} {_legend('this comparison', found.differences)}"
    )


def _compared_row(of: Difference) -> list[Cell | str]:
    return [
        of.name,
        difference(of.difference, of.name, sign=True),
        interval(of.ci95, of, shown=difference),
        f"{of.p_value:.2g}",
        Cell(f"{of.adjusted_p:.2g}", of.adjusted_p, tone=Tone.GOOD if of.differs else Tone.PLAIN),
        difference(of.least_shown, of.name),
    ]


def _verdict(found: Comparison) -> str:
    said = []
    for one in found.differences:
        more = "higher" if one.difference > 0 else "lower"
        if one.differs:
            said.append(f"{one.name} of the first policy is {more} by {difference(abs(one.difference), one.name)}")
        else:
            least = known(one.least_shown)
            seen = f" (differences from {difference(least, one.name)} on would mostly be seen)" if least else ""
            said.append(f"{one.name}: no difference can be told{seen}")
    return "; ".join(said)


def number(value: float | Missing, name: str, *, sign: bool = False) -> str:
    """A value of the quantity of that name; a dash where there is none."""
    if isinstance(value, Missing):
        return NONE
    if name == SUCCESS:
        size = abs(100 * value)
        # "100.0 %" is what all episodes come to, and "0.0 %" none
        whole = (digits for digits in range(1, _DIGITS) if round(size, digits) not in (0, 100) or size in (0, 100))
        return f"{100 * value:{'+' if sign else ''}.{next(whole, _DIGITS)}f} %"
    return f"{value:{'+' if sign else ''}.4g}"


def difference(value: float | Missing, name: str, *, sign: bool = False) -> str:
    """A difference between two values of the quantity of that name, of success in percentage points."""
    shown = number(value, name, sign=sign)
    return shown.replace("%", "pp") if name == SUCCESS else shown


def interval(
    ends: tuple[float, float] | Missing, of: Quantity | Difference, *, shown: Callable[[float, str], str] = number
) -> str:
    """An interval of a quantity, or of a `difference` of it; a dash where there is none."""
    if isinstance(ends, Missing):
        return NONE
    return bounds(ends, lambda end: shown(end, of.name))


def across_document(found: Across) -> Document:
    """The verdict, the means under each value, and the tests."""
    one = found.settings[0].outcome
    depends = any(quantity.depends for quantity in found.quantities)
    blocks: list[Block] = [
        Text(
            "; ".join(_across_verdict(quantity, found) for quantity in found.quantities),
            Tone.WARNING if depends else Tone.PLAIN,
        ),
        facts(
            ("task", one.scene),
            ("episodes", f"the first {plural(one.per_env, 'episode')} of each environment"),
            *([("success", f"{one.success} at {AT[one.success_at.value]}")] if one.success else []),
        ),
        table(
            "across",
            "",
            (found.key, "files", "envs", *(name for of in one.quantities for name in (of.name, "95 %"))),
            [_across_row(setting) for setting in found.settings],
        ),
        Text(
            f"p: {_tests(found)}, by exchanging {_units(found)} of {found.key}. 95 %: of each value alone."
            f"{f' {POINTS}' if depends and one.success else ''}"
        ),
    ]
    if told := list(_remarks(found)):
        blocks.append(items(*told, tone=Tone.WARNING))
    return Document("", tuple(blocks))


def dump_across(found: Across) -> str:
    """The document that ``gsb-episodes --across KEY --json`` writes."""
    settings = [{"value": one.value, "policy": record(one.outcome)} for one in found.settings]
    return dump(
        document_of({
            "across": {
                "key": found.key,
                "settings": settings,
                "quantities": [{**values_of(one), "depends": one.depends} for one in found.quantities],
                "warnings": list(_remarks(found)),
            },
        })
    )  # fmt: skip


def _across_verdict(of: Dependence, found: Across) -> str:
    what = _WORDS[found.key]
    if of.depends:
        far = difference(of.largest, of.name)
        return f"{of.name} depends on the {what} (p = {of.adjusted_p:.2g}): means differ by up to {far}"
    return f"{of.name}: no dependence on the {what} can be told (p = {of.adjusted_p:.2g})"


def _tests(found: Across) -> str:
    return ", ".join(f"{of.name} {of.p_value:.2g}, by Holm {of.adjusted_p:.2g}" for of in found.quantities)


def _units(found: Across) -> str:
    alike = all(of.paired for of in found.quantities)
    return "episodes of environments that began alike between values" if alike else "environments between values"


def _across_row(setting: Setting) -> list[Cell | str]:
    of = setting.outcome
    return [
        setting.value,
        Cell(str(len(of.files)), len(of.files)),
        Cell(str(of.n_env), of.n_env),
        *(said for one in of.quantities for said in (number(one.mean, one.name), interval(one.ci95, one))),
    ]


def _remarks(found: Across) -> Iterator[str]:
    if few := [one.value for one in found.settings if one.outcome.n_env < _FEW_ENVS]:
        yield (
            f"{found.key} {', '.join(few)}: fewer than {_FEW_ENVS} environments in all, so that the test shows little; "
            "add recordings with other seeds"
        )
    for one in found.settings:
        for sentence in warnings(one.outcome):
            yield f"{found.key} {one.value}: {sentence}"
