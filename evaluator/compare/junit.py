"""A comparison of two sets as a JUnit report: one test case for each configuration and axis."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from gpusimbench.evaluator.compare import words
from gpusimbench.evaluator.compare.compare import ComparedConfiguration, Result, counts
from gpusimbench.evaluator.compare.finding import Change, Finding
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.schemas.text import line


def junit(result: Result) -> str:
    """The document.

    A gate that failed is a failure. A gate that is neither failed nor passed is an error: readers of JUnit let a suite
    pass that has skipped test cases. Two sets of which nothing could be compared are an error. An axis that applies to
    neither side, or has no gate, is skipped.
    """
    suites = ET.Element("testsuites", name="gsb-compare")
    totals = [_suite(suites, compared, result) for compared in result.compared]
    if not result.compared:
        totals.append(_nothing(suites, result))
    if result.unreadable:
        totals.append(_unreadable(suites, result))
    for name, numbers in zip(("tests", "failures", "errors", "skipped"), zip(*totals, strict=True), strict=False):
        suites.set(name, str(sum(numbers)))
    ET.indent(suites)
    return ET.tostring(suites, encoding="unicode", xml_declaration=False).join(
        ['<?xml version="1.0" encoding="UTF-8"?>\n', "\n"]
    )


def _suite(suites: ET.Element, compared: ComparedConfiguration, result: Result) -> tuple[int, int, int, int]:
    heading = _text(words.heading(compared))
    suite = ET.SubElement(suites, "testsuite", name=heading)
    cases = failures = errors = skipped = 0
    for axis in Axis:
        found = [finding for finding in compared.findings if finding.axis is axis]
        if not found:
            continue
        cases += 1
        case = ET.SubElement(suite, "testcase", name=axis.value, classname=heading)
        failing = [finding for finding in found if finding.fails(result.settings)]
        told = [finding for finding in found if finding.change is not Change.NOT_COMPARED]
        if failing:
            failures += 1
            message = "; ".join(f"{finding.title}: {words.verdict(finding, result)}" for finding in failing)
            _say(case, "failure", message, _lines(failing, result))
        elif undecided := [finding for finding in found if finding.undecided(result.settings)]:
            errors += 1
            reasons = [f"{finding.title}: {finding.undecided(result.settings)}" for finding in undecided]
            _say(case, "error", f"undecided: {'; '.join(reasons)}", _lines(undecided, result))
        elif not told or not counts(axis, result.settings):
            skipped += 1
            why = "; ".join(dict.fromkeys(f.missing for f in found if f.missing)) if not told else "not a gate"
            _say(case, "skipped", why, [])
        ET.SubElement(case, "system-out").text = _lined([*_lines(told, result), *compared.warnings])
    counted = (cases, failures, errors, skipped)
    for name, number in zip(("tests", "failures", "errors", "skipped"), counted, strict=True):
        suite.set(name, str(number))
    return counted


def _nothing(suites: ET.Element, result: Result) -> tuple[int, int, int, int]:
    suite = ET.SubElement(suites, "testsuite", name="sets", tests="1", failures="0", errors="1", skipped="0")
    case = ET.SubElement(suite, "testcase", name="compared", classname="sets")
    _say(case, "error", words.headline(result), [f"{label} of {side}: {why}" for side, label, why in result.alone])
    return 1, 0, 1, 0


def _unreadable(suites: ET.Element, result: Result) -> tuple[int, int, int, int]:
    count = len(result.unreadable)
    suite = ET.SubElement(
        suites, "testsuite", name="files", tests=str(count), failures="0", errors=str(count), skipped="0"
    )
    for side, unreadable in result.unreadable:
        case = ET.SubElement(suite, "testcase", name=_text(str(unreadable.path)), classname=side)
        _say(case, "error", str(unreadable.error), [])
    return count, 0, count, 0


def _say(case: ET.Element, kind: str, message: str, lines: Sequence[str]) -> None:
    said = ET.SubElement(case, kind, message=_text(message))
    if lines:
        said.text = _lined(lines)


def _lines(findings: Sequence[Finding], result: Result) -> list[str]:
    named = [zip(words.TITLES, words.cells(finding, result), strict=True) for finding in findings]
    return ["; ".join(f"{name} {cell}".strip() for name, cell in row) for row in named]


def _text(text: str) -> str:
    """Text without what XML 1.0 cannot hold: it is shown as \\x..; all else is escaped where it is written."""
    return line(text)


def _lined(lines: Sequence[str]) -> str:
    return "\n".join(map(line, lines))
