"""What gsb-fit says: whether fitting helps, errors before and after, and how to record with the options; also as JSON
and, every evaluation in a row, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from gpusimbench.evaluator.fit.judged import Compared, Fit
from gpusimbench.evaluator.fit.search import METHOD, Evaluation
from gpusimbench.evaluator.json_values import dump, values_of
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Block, Code, Document, Text, facts, table
from gpusimbench.schemas.text import plural

SCHEMA_VERSION = 1

_TITLES = ("error of", "tosses", "before", "after", "change", "p")


def fit_document(found: Fit) -> Document:
    """The verdict, the errors, and the command."""
    failed = sum(isinstance(one.error, Missing) for one in found.evaluations)
    cost = f"{plural(len(found.evaluations), 'evaluation')} of at most {found.budget}"
    blocks: list[Block] = [
        Text(found.verdict),
        facts(
            ("simulator", found.simulator),
            ("tosses", f"{found.source}, SHA-256 {found.sha256[:12]}..."),
            ("start", _words(found.start)),
            ("fitted", _words(found.fitted)),
            ("search", f"{cost}{f', {failed} of them failed' if failed else ''}; {METHOD}"),
        ),
        table("errors", "", _TITLES, [_row(one) for one in found.compared]),
        Text("Options were fitted to the error of position on even tosses. Only odd tosses judge them."),
    ]
    if found.command:
        blocks += [Text("To record with these options:"), Code((found.command,))]
    return Document("", tuple(blocks))


def dump_json(found: Fit) -> str:
    """The document that ``gsb-fit --json`` writes."""
    return dump({"schema_version": SCHEMA_VERSION, "verdict": found.verdict, "method": METHOD, **values_of(found)})


def dump_csv(evaluations: Sequence[Evaluation]) -> str:
    """A row for each evaluation: its number, the options, the error on even tosses, and why there is none."""
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    names = list(evaluations[0].options) if evaluations else []
    rows.writerow(["evaluation", *names, "error_even_cm", "why_not"])
    for number, one in enumerate(evaluations, 1):
        error = ("", one.error.reason) if isinstance(one.error, Missing) else (repr(one.error), "")
        rows.writerow([number, *one.options.values(), *error])
    return stream.getvalue()


def _words(options: dict[str, str]) -> str:
    return ", ".join(f"{name}={value}" for name, value in options.items())


def _row(one: Compared) -> list[str]:
    return [
        f"{one.of} [{one.unit}]",
        f"{one.change.cases} {one.tosses.split()[0]}",
        _span(one.before, one.before_ci95),
        _span(one.after, one.after_ci95),
        _span(one.change.mean, one.change.ci95),
        f"{one.change.p_value:.2g}" if one.tosses.startswith("odd") else "-",  # fitted tosses prove nothing
    ]


def _span(value: float, ci95: tuple[float, float] | None) -> str:
    return f"{value:.4g}" + (f" [{ci95[0]:.4g}, {ci95[1]:.4g}]" if ci95 else "")
