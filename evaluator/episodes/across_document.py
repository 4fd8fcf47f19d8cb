"""What gsb-episodes --across says: a row for each value of the setting, and whether it matters; and that as JSON."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.episodes.dependence import Across, Dependence, Setting
from gpusimbench.evaluator.episodes.document import (
    AT,
    POINTS,
    SCHEMA_VERSION,
    difference,
    interval,
    number,
    record,
    warnings,
)
from gpusimbench.evaluator.json_values import dump, values_of
from gpusimbench.evaluator.render.document import Block, Cell, Document, Text, Tone, facts, items, table
from gpusimbench.schemas.text import plural

_WORDS = {"n_env": "number of environments", "device": "device", "version": "version of the simulator"}
_FEW_ENVS = 8


def across_document(found: Across) -> Document:
    """The verdict, the means under each value, and the tests."""
    one = found.settings[0].outcome
    depends = any(quantity.depends for quantity in found.quantities)
    blocks: list[Block] = [
        Text(
            "; ".join(_verdict(quantity, found) for quantity in found.quantities),
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
            [_row(setting) for setting in found.settings],
        ),
        Text(
            f"p: {_tests(found)}, by exchanging {_units(found)} of {found.key}. 95 %: of each value alone."
            f"{f' {POINTS}' if depends and one.success else ''}"
        ),
    ]
    if told := list(_told(found)):
        blocks.append(items(*told, tone=Tone.WARNING))
    return Document("", tuple(blocks))


def dump_across(found: Across) -> str:
    """The document that ``gsb-episodes --across KEY --json`` writes."""
    settings = [{"value": one.value, "policy": record(one.outcome)} for one in found.settings]
    return dump(
        {
            "schema_version": SCHEMA_VERSION,
            "across": {
                "key": found.key,
                "settings": settings,
                "quantities": [{**values_of(one), "depends": one.depends} for one in found.quantities],
                "warnings": list(_told(found)),
            },
        }
    )


def _verdict(of: Dependence, found: Across) -> str:
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


def _row(setting: Setting) -> list[Cell | str]:
    of = setting.outcome
    return [
        setting.value,
        Cell(str(len(of.files)), len(of.files)),
        Cell(str(of.n_env), of.n_env),
        *(said for one in of.quantities for said in (number(one.mean, one.name), interval(one.ci95, one))),
    ]


def _told(found: Across) -> Iterator[str]:
    if few := [one.value for one in found.settings if one.outcome.n_env < _FEW_ENVS]:
        yield (
            f"{found.key} {', '.join(few)}: fewer than {_FEW_ENVS} environments in all, so that the test shows little; "
            "add recordings with other seeds"
        )
    for one in found.settings:
        for sentence in warnings(one.outcome):
            yield f"{found.key} {one.value}: {sentence}"
