"""What gsb-import says: for each engine, what was compared, and every difference by its name."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from gpusimbench.evaluator.imports.audit import Audit, Landing
from gpusimbench.evaluator.imports.motion import MAX_DISTANCE, Poses, Response, Responses
from gpusimbench.evaluator.imports.parameters import ComparedKind, ParameterDifference, ParameterFault
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Document,
    Section,
    Text,
    Tone,
    items,
    key_of,
    table,
)
from gpusimbench.schemas.text import plural

_MOST_ROWS = 40  # differences that are shown without --all

_COMPARED = ("what", "compared", "result")
_DIFFERENCES = ("what", "item", "MuJoCo C", "engine", "difference")
_DROP = ("engine", "first contact", "centre of mass then", "weight carried at the end")
_FALSE = {
    ParameterFault.MISSING: "missing",
    ParameterFault.ADDED: "not in the model",
    ParameterFault.ORDER: "order",
    ParameterFault.LOST: "lost",
}


def import_document(audits: Sequence[Audit], *, every: bool = False) -> Document:
    """A section for each engine.

    every  all differences, and what was not compared
    """
    return Document("", tuple(_section(number, audit, every) for number, audit in enumerate(audits)))


def dump_import(audits: Sequence[Audit]) -> str:
    """The document that ``gsb-import --json`` writes."""
    engines = [{**values_of(audit), "agrees": audit.agrees} for audit in audits]
    return dump(document_of({"engines": engines}))


def verdict_of(audit: Audit) -> str:
    """The result in a few words."""
    if audit.missing:
        return "refuses the model"
    if audit.agrees:
        return "agrees with MuJoCo C"
    wrong = [plural(len(audit.findings), "parameter")] if audit.findings else []
    if not isinstance(audit.poses, Missing) and audit.poses.wrong:
        wrong.append(plural(len(audit.poses.wrong), "link"))
    if not isinstance(audit.responses, Missing) and audit.responses.wrong:
        wrong.append(plural(len(audit.responses.wrong), "response"))
    return f"differs from MuJoCo C in {', '.join(wrong)}"


def _section(number: int, audit: Audit, every: bool) -> Section:
    words = " ".join(filter(None, (audit.simulator, audit.version, *audit.options)))
    title = f"{words}: {audit.model}" if audit.model else words
    return Section(key_of("import", number, words), title, tuple(_blocks(number, audit, every)), verdict_of(audit))


def _blocks(number: int, audit: Audit, every: bool) -> Iterator[Block]:
    if audit.missing:
        yield Text(audit.missing, Tone.BAD)
        return
    if not audit.same_file:
        yield Text("The reference was made of other files: differences of the two are found, too.", Tone.WARNING)
    rows = [_kind_row(kind) for kind in audit.kinds]
    yield table(f"import-{number}", "", _COMPARED, [*rows, _poses_row(audit.poses), _responses_row(audit.responses)])
    if not isinstance(audit.landings, Missing):
        landed = [("MuJoCo C", audit.landings.reference), (audit.simulator, audit.landings.engine)]
        title = f"A drop of {audit.landings.duration:.3g} s, which is not judged"
        yield table(f"import-{number}-drop", title, _DROP, [_landing_row(*row) for row in landed])
    elif every:
        yield Text(f"no drop was compared: {audit.landings.reason}", Tone.QUIET)
    differences = list(_differences(audit))
    if differences:
        shown = differences if every else differences[:_MOST_ROWS]
        yield table(f"import-{number}-differences", "Differences", _DIFFERENCES, shown)
        if len(shown) < len(differences):
            yield Text(f"{len(differences) - len(shown)} more differences: --all", Tone.QUIET)
    left = [(kind.kind, name, why) for kind in audit.kinds for name, why in kind.not_compared]
    if left and every:
        yield items(*(f"{kind}, {name}: not compared: {why}" for kind, name, why in left))
    elif left:
        yield Text(f"{plural(len(left), 'parameter')} could not be compared: --all", Tone.QUIET)


def _kind_row(kind: ComparedKind) -> list[Cell | str]:
    things = f"{kind.things} x {plural(kind.values // kind.things, 'parameter')}" if kind.values else f"{kind.things}"
    if kind.kind == "model":
        things = plural(kind.values, "parameter")
    if not kind.things and not kind.findings:
        return [kind.kind, "-", Cell("not compared", tone=Tone.QUIET)]
    wrong = len(kind.findings)
    result = Cell(plural(wrong, "difference"), tone=Tone.BAD) if wrong else Cell("agrees", tone=Tone.GOOD)
    return [kind.kind, things, result]


def _poses_row(found: Poses | Missing) -> list[Cell | str]:
    if isinstance(found, Missing):
        return ["kinematics", "-", Cell("not compared", notes=(found.reason,), tone=Tone.QUIET)]
    said = f"{_bodies(len(found.links))} in {plural(found.n_pose, 'drawn pose')}"
    if found.wrong:
        first = found.wrong[0]
        return ["kinematics", said, Cell(f"{_bodies(len(found.wrong))} elsewhere, from {first.link} on", tone=Tone.BAD)]
    worst = max((link.distance for link in found.links), default=0.0)
    return ["kinematics", said, Cell("agrees", notes=(f"at most {worst:.1e} m apart",), tone=Tone.GOOD)]


def _bodies(count: int) -> str:
    return plural(count, "body", "bodies")


def _responses_row(found: Responses | Missing) -> list[Cell | str]:
    if isinstance(found, Missing):
        return ["responses", "-", Cell("not compared", notes=(found.reason,), tone=Tone.QUIET)]
    compared = [one for one in found.each if one.agrees is not None]
    counts = [(kind, sum(one.kind == kind for one in compared)) for kind in ("joint", "actuator")]
    said = f"{', '.join(plural(count, kind) for kind, count in counts)}, {found.n_step} steps"
    left = len(found.each) - len(compared)
    notes = [f"{left} more not compared"] if left else []
    if found.wrong:
        worst = found.wrong[0]
        notes.insert(0, f"the most: {worst.target}")
        return ["responses", said, Cell(f"{len(found.wrong)} differ", notes=tuple(notes), tone=Tone.BAD)]
    if not compared:
        return ["responses", said, Cell("not compared", notes=tuple(notes), tone=Tone.QUIET)]
    worst_steps = max(one.steps for one in compared if not isinstance(one.steps, Missing))
    notes.insert(0, f"at most {worst_steps:.1g} time steps apart")
    return ["responses", said, Cell("agrees", notes=tuple(notes), tone=Tone.GOOD)]


def _landing_row(name: str, one: Landing) -> list[Cell | str]:
    time = "none" if isinstance(one.time, Missing) else Cell(f"{one.time:.3g} s", one.time)
    height = "-" if isinstance(one.height, Missing) else Cell(f"{one.height:.3g} m", one.height)
    carried = "not finite" if isinstance(one.carried, Missing) else Cell(f"{one.carried:.0%}", one.carried)
    return [name, time, height, carried]


def _differences(audit: Audit) -> Iterator[list[Cell | str]]:
    for finding in audit.findings:
        yield _finding_row(finding)
    if not isinstance(audit.poses, Missing):
        for link in audit.poses.wrong:
            if link.distance > MAX_DISTANCE:
                apart = _apart(link.distance, ".3g", "m")
            else:
                apart = _apart(link.angle, ".3g", "rad")
            yield ["kinematics", link.link, "", "", apart]
    if not isinstance(audit.responses, Missing):
        for response in audit.responses.wrong:
            yield _response_row(response)


def _finding_row(finding: ParameterDifference) -> list[Cell | str]:
    what = f"{finding.kind}, {finding.parameter}" if finding.parameter else finding.kind
    apart: Cell | str = _FALSE.get(finding.verdict, "")
    if finding.difference is not None:
        apart = _apart(finding.difference, ".3g", finding.unit)
    elif finding.verdict is ParameterFault.DIFFERS:
        apart = "differs"
    if finding.verdict is ParameterFault.LOST:
        return [what, finding.item, finding.wanted, Cell("lost", notes=(finding.found,)), "lost"]
    return [what, finding.item, finding.wanted, finding.found, apart]


def _response_row(response: Response) -> list[Cell | str]:
    assert not isinstance(response.steps, Missing)
    return [
        f"response, {response.kind}",
        response.target,
        "",
        "",
        _apart(response.steps, ".2g", "time steps"),
    ]


def _apart(difference: float, spec: str, unit: str) -> Cell:
    """A difference with its unit; infinite is one from a value that is not finite, or of another number of values."""
    if not math.isfinite(difference):
        return Cell("not finite")
    return Cell(f"{difference:{spec}} {unit}".rstrip(), difference)
