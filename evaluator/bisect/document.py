"""What gsb-bisect says: the release that changed the recordings, and what each release showed; and the same as JSON."""

from __future__ import annotations

from gpusimbench.evaluator.bisect.bisection import Bisection
from gpusimbench.evaluator.bisect.predicates import Verdict
from gpusimbench.evaluator.diff.words import names
from gpusimbench.evaluator.json_values import dump, values_of
from gpusimbench.evaluator.render.document import Block, Cell, Document, Text, Tone, facts, table

SCHEMA_VERSION = 1

_PACKAGES, _SETTINGS = 4, 4
_WORDS = {True: ("differs", Tone.BAD), False: ("the same", Tone.GOOD), None: ("not judged", Tone.WARNING)}


def bisect_document(found: Bisection) -> Document:
    """The verdict, a row for each release that was recorded, and what changed with the first that differs."""
    good = Verdict(False, "the good release")
    rows = [_row(version, verdict) for version, verdict in {found.versions[0]: good, **found.tested}.items()]
    blocks: list[Block] = [
        Text(verdict_of(found), Tone.PLAIN if found.exact else Tone.WARNING),
        table("releases", "", ("release", f"against {found.versions[0]}", "evidence"), rows),
    ]
    if pairs := _pairs(found):
        blocks.append(facts(*pairs))
    return Document("", tuple(blocks))


def verdict_of(found: Bisection) -> str:
    """One sentence: which release is the first that differs."""
    what = "states" if found.predicate == "states" else "recordings"
    good, bad = found.versions[0], found.versions[-1]
    where = f"in {found.scene}"
    if found.different is None:
        return f"{found.package} {bad} does not differ from {good} {where}, judged by {found.predicate}."
    if found.skipped:
        left = f"{', '.join(found.skipped)} could not be judged"
        return f"The {what} {where} changed after {found.package} {found.same} and up to {found.different}; {left}."
    return f"{found.package} {found.different} is the first release whose {what} {where} differ from those of {good}."


def dump_json(found: Bisection) -> str:
    """The document that ``gsb-bisect --json`` writes."""
    return dump(
        {"schema_version": SCHEMA_VERSION, "verdict": verdict_of(found), "exact": found.exact, **values_of(found)}
    )


def _row(version: str, verdict: Verdict) -> list[Cell | str]:
    word, tone = _WORDS[verdict.different]
    return [version, Cell(word, tone=tone), verdict.evidence]


def _pairs(found: Bisection) -> list[tuple[str, str]]:
    if found.different is None:
        return []
    pairs = [(f"{found.same} to {found.different}", found.step)]
    if found.first:
        pairs.append(("first number", found.first))
    # the engine's own packages first: a release may come in several
    ordered = sorted(found.packages, key=lambda one: (not one.name.startswith(found.package), one.name))
    changed = names([f"{one.name} {one.a} to {one.b}" for one in ordered], _PACKAGES) or "the same versions"
    several = "several packages changed at once: " if len(found.packages) > 1 else ""
    pairs.append(("packages", f"{several}{changed}"))
    if found.settings:
        pairs.append(("also differs", names([one.name for one in found.settings], _SETTINGS)))
    return pairs
