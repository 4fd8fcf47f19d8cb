"""The verdict of a whole comparison, from its findings: exit code, sentence, headline; findings as people read them."""

from __future__ import annotations

from typing import Any

import pytest

from gpusimbench.evaluator.compare import words
from gpusimbench.evaluator.compare.compare import ComparedConfiguration, Result
from gpusimbench.evaluator.compare.finding import Change, Finding, Settings
from gpusimbench.evaluator.compare.words import TITLES, cells, verdict
from gpusimbench.evaluator.results.metric import Axis, Direction
from gpusimbench.schemas.errors import ExitCode

GATED = Settings(gates=frozenset({Axis.THROUGHPUT, Axis.MEMORY, Axis.VALIDITY}))
ONE = Settings(gates=GATED.gates, expect_same=True)
UNREAD: Any = object()
RESULT = Result((), (), (), Settings(gates=frozenset({Axis.THROUGHPUT, Axis.MEMORY})), 0, 0, ())
SAME = Result((), (), (), Settings(gates=frozenset({Axis.THROUGHPUT}), expect_same=True), 0, 0, ())


def finding(change: Change, axis: Axis = Axis.THROUGHPUT, name: str = "fps", **more: Any) -> Finding:
    """A finding that has a title of its own."""
    return Finding(axis, name, f"title of {name}", change, Direction.HIGHER, **more)


def runs_ended(change: Change = Change.SAME) -> Finding:
    """How runs ended."""
    return finding(change, Axis.VALIDITY, "complete_runs")


def result(*configurations: list[Finding], settings: Settings = GATED, **more: Any) -> Result:
    """A result of configurations with these findings."""
    unused: Any = None
    compared = tuple(ComparedConfiguration(unused, unused, tuple(findings), (), ()) for findings in configurations)
    return Result(
        compared, **{"alone": (), "unreadable": (), "settings": settings, "tests": 0, "lost": 0, "notes": (), **more}
    )


NOTHING = "NOTHING COMPARED: in some configuration, base and head share no quantity that the verdict depends on"

FINE, WORSE, OPEN = (
    finding(Change.SAME),
    finding(Change.REGRESSION),
    finding(Change.UNCLEAR, left_open=(Change.REGRESSION,)),
)

CASES = [
    (
        "fine",
        result([FINE]),
        ExitCode.OK,
        "PASSED: no sign that head is worse than base in 1 configuration",
        "NO REGRESSION found in 1 configuration",
    ),
    (
        "gained",
        result([FINE], [finding(Change.IMPROVEMENT, Axis.BITS), FINE], alone=(("base", "a", "b"),)),
        ExitCode.OK,
        "PASSED: no sign that head is worse than base in 2 configurations; "
        "head is better in bits; 1 configuration without a partner",
        "NO REGRESSION found in 2 configurations; improved: bits; 1 configuration without a partner",
    ),
    (
        "worse",
        result([WORSE, FINE, finding(Change.CHANGED, Axis.MEMORY)]),
        ExitCode.GATE_FAILED,
        "FAILED: head is worse than base in throughput, memory (2 findings in 1 configuration)",
        "REGRESSION: throughput, memory (2 findings in 1 configuration)",
    ),
    (
        "changed",
        result([finding(Change.CHANGED)]),
        ExitCode.GATE_FAILED,
        "FAILED: head differs from base in throughput (1 finding in 1 configuration)",
        "CHANGED: throughput (1 finding in 1 configuration)",
    ),
    (
        "worse and open",
        result([WORSE], [finding(Change.UNCLEAR, Axis.MEMORY, left_open=(Change.REGRESSION,))], lost=1),
        ExitCode.GATE_FAILED,
        "FAILED: head is worse than base in throughput (1 finding in 2 configurations); not decided: memory",
        "REGRESSION: throughput (1 finding in 2 configurations); not decided: memory",
    ),
    (
        "lost",
        result([FINE], lost=1),
        ExitCode.DATA_LOST,
        "PASSED: no sign that head is worse than base in 1 configuration",
        "NO REGRESSION found in 1 configuration",
    ),
    (
        "unreadable",
        result([FINE], unreadable=(("base", UNREAD),)),
        ExitCode.DATA_LOST,
        "PASSED: no sign that head is worse than base in 1 configuration",
        "NO REGRESSION found in 1 configuration",
    ),
    (
        "open",
        result([OPEN], [FINE]),
        ExitCode.NOTHING_COMPARABLE,
        "NOT DECIDED: whether head is worse than base in throughput (1 finding in 2 configurations)",
        "NOT DECIDED: throughput (1 finding in 2 configurations)",
    ),
    (
        "nothing",
        result(),
        ExitCode.NOTHING_COMPARABLE,
        "NOTHING COMPARED: base and head have no configuration in common",
        "NOTHING COMPARED",
    ),
    ("how runs ended alone", result([FINE], [runs_ended()]), ExitCode.NOTHING_COMPARABLE, NOTHING, "NOTHING COMPARED"),
    (
        "no gate",
        result([finding(Change.SAME, Axis.BITS, "bits"), runs_ended()]),
        ExitCode.NOTHING_COMPARABLE,
        NOTHING,
        "NOTHING COMPARED",
    ),
    (
        "runs that ended worse",
        result([runs_ended(Change.REGRESSION)]),
        ExitCode.GATE_FAILED,
        "FAILED: head is worse than base in validity (1 finding in 1 configuration)",
        "REGRESSION: validity (1 finding in 1 configuration)",
    ),
    (
        "the same",
        result([finding(Change.SAME, Axis.BITS)], settings=ONE),
        ExitCode.OK,
        "PASSED: no sign that head differs from base in 1 configuration",
        "NO DIFFERENCE found in 1 configuration",
    ),
    (
        "not the same",
        result([finding(Change.IMPROVEMENT, Axis.BITS)], settings=ONE),
        ExitCode.GATE_FAILED,
        "FAILED: head differs from base in bits (1 finding in 1 configuration)",
        "NOT THE SAME: bits (1 finding in 1 configuration)",
    ),
]


@pytest.mark.parametrize(
    ("found", "code", "sentence", "headline"), [case[1:] for case in CASES], ids=[c[0] for c in CASES]
)
def test_the_verdict_of_the_whole(found: Result, code: ExitCode, sentence: str, headline: str) -> None:
    """Fail before data is lost, and lose before nothing is decided; say how often, and on which axes."""
    assert found.exit_code is code
    assert words.sentence(found) == sentence
    assert words.headline(found) == headline


def test_what_is_open_is_listed_by_its_reason() -> None:
    """Name what neither fails nor passes, what shares a reason together, in the order of the axes."""
    memory = finding(Change.NOT_COMPARED, Axis.MEMORY, "memory", missing="no GPU")
    host = finding(Change.NOT_COMPARED, Axis.MEMORY, "host", missing="no GPU")
    absent = finding(Change.NOT_COMPARED, Axis.MEMORY, "absent", missing="no GPU", applies=False)
    found = result([memory, OPEN, host, absent])
    assert found.open == [memory, OPEN, host]
    assert found.undecided == [axis for axis in Axis if axis in (Axis.THROUGHPUT, Axis.MEMORY)]
    assert words.undecided(found.compared[0], found) == [
        "title of memory, title of host: no GPU",
        "title of fps: too few runs",
    ]
    assert words.remarks(found.compared[0]) == ["not compared: title of memory, title of host, title of absent: no GPU"]


@pytest.mark.parametrize(
    ("found", "begins"),
    [
        (result([FINE]), []),
        (result([FINE, finding(Change.NOT_COMPARED, Axis.BITS, missing="no states")]), []),
        (result([finding(Change.IMPROVEMENT)]), ["verdicts without a p"]),
        (result([finding(Change.IMPROVEMENT, p_value=0.01)]), []),
        (result([finding(Change.UNCLEAR, p_value=0.4)]), ["~: no difference"]),
        (result([finding(Change.WITHIN, p_value=0.4)]), ["~: no difference"]),
        (result([finding(Change.UNCLEAR, p_value=0.4, left_open=(Change.REGRESSION,))]), ["undecided: the gate"]),
        (result([FINE], tests=1), ["p: adjusted (Holm) for 1 statistical comparison on"]),
        (result([FINE], tests=2), ["p: adjusted (Holm) for 2 statistical comparisons on"]),
        (result([finding(Change.SAME, Axis.VARIABILITY, p_adjusted=0.4)]), ["p of W1 between envs"]),
        (result([finding(Change.SAME, Axis.VARIABILITY), finding(Change.SAME, p_adjusted=0.4)]), []),
    ],
)
def test_the_legend_explains_what_is_there(found: Result, begins: list[str]) -> None:
    """Explain the marks and columns that the findings have, and no others."""
    lines = words.legend(found)
    assert len(lines) == len(begins)
    assert all(line.startswith(begin) for line, begin in zip(lines, begins, strict=True))


def test_what_decides_is_said() -> None:
    """Name the gates in the order of the axes, and what a change has to be above."""
    gates = ", ".join(axis.value for axis in Axis if axis in GATED.gates)
    assert words.settings_line(result()) == f"gates: {gates}; changes below 5 % of an amount, or 0.01 cm, do not count"
    assert words.settings_line(result(settings=ONE)).endswith(f"every difference fails; must be decided: {gates}")


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (finding(Change.SAME), "same"),
        (finding(Change.REGRESSION, p_adjusted=0.01), "REGRESSION"),
        (finding(Change.REGRESSION, Axis.BITS), "regression (not gated)"),
        (finding(Change.CHANGED, Axis.BITS), "changed (not gated)"),
        (finding(Change.IMPROVEMENT, Axis.BITS), "improvement"),
        (finding(Change.UNCLEAR, p_adjusted=0.4), "~"),
        (finding(Change.UNCLEAR), "~ (too few runs)"),
        (finding(Change.UNCLEAR, bounded=True), "~"),
        (finding(Change.UNCLEAR, left_open=(Change.REGRESSION,)), "undecided (too few runs)"),
        (finding(Change.UNCLEAR, left_open=(Change.REGRESSION,), p_adjusted=0.4), "undecided"),
        (finding(Change.UNCLEAR, left_open=(Change.REGRESSION,), bounded=True), "undecided"),
        (finding(Change.UNCLEAR, left_open=(Change.IMPROVEMENT,)), "~ (too few runs)"),
        (finding(Change.NOT_COMPARED, missing="no states"), "undecided (too few runs)"),
        (finding(Change.NOT_COMPARED, missing="no states", applies=False), "not compared"),
        (finding(Change.WITHIN, p_adjusted=0.4), "~ within 5 %"),
        (finding(Change.SMALL, unit="cm"), "differs, below 0.01 cm"),
        (finding(Change.NEAR, bounded=True), "differs, perhaps below 5 %"),
        (finding(Change.SMALL, Axis.MEMORY, unit="B", base=1e5, head=2e5), "differs, below 1 MB"),
        (finding(Change.SMALL, Axis.MEMORY, unit="B", base=1e9, head=1.01e9), "differs, below 5 %"),
        (
            finding(Change.NEAR, Axis.MEMORY, unit="B", base=1e6, head=1.01e6, ci95=(0.9, 1.2)),
            "differs, perhaps below 1 MB",
        ),
        (finding(Change.SMALL, Axis.MEMORY, unit="B"), "differs, below 5 %"),
        (finding(Change.WITHIN, Axis.MEMORY, unit="B", base=1e5, head=1.02e5, ci95=(0.5, 1.03)), "~ within 1 MB"),
        (finding(Change.WITHIN, Axis.MEMORY, unit="B", base=1e5, head=1.04e5, ci95=(1.0, 1.045)), "~ within 5 %"),
        (finding(Change.SMALL, Axis.BUILD, unit="s", base=2e-6, head=3e-6), "differs, below 1 ms"),
        (finding(Change.SMALL, Axis.BUILD, unit="s", base=10.0, head=10.2), "differs, below 5 %"),
        (finding(Change.WITHIN, Axis.PHYSICS, unit="cm"), "~ within 0.01 cm"),
        (finding(Change.NEAR, Axis.PHYSICS, base=10.0, head=12.0), "differs, perhaps below 5 %"),
    ],
)  # fmt: skip
def test_verdicts(found: Finding, said: str) -> None:
    """Shout where a gate fails, say that a gate is open, that runs are few, or that an axis does not decide."""
    assert verdict(found, RESULT) == said


@pytest.mark.parametrize(
    ("change", "said"),
    [(Change.SMALL, "DIFFERS, BELOW 5 %"), (Change.IMPROVEMENT, "IMPROVEMENT"), (Change.SAME, "same")],
)
def test_verdicts_of_what_is_to_be_one(change: Change, said: str) -> None:
    """Shout at every difference where both sides are said to be of one thing, whatever its axis."""
    assert verdict(finding(change, Axis.BUILD), SAME) == said


@pytest.mark.parametrize(
    ("found", "row"),
    [
        (
            finding(
                Change.REGRESSION, unit="B", base=2e6, head=3e9, ratio=1500.0, ci95=(0.0005, 999.4), p_adjusted=0.0123
            ),
            ("title of fps", "2.000 MB", "3.000 GB", "1.5e+03", "[0.0005 to 999.400]", "0.012", "REGRESSION"),
        ),
        (
            finding(Change.SAME, unit="s", base=1.23456, head=1.5, ratio=1.2345),
            ("title of fps [s]", "1.23", "1.5", "1.234", "-", "-", "same"),
        ),
        (finding(Change.SAME, said=("3 of 3", "2 of 3")), ("title of fps", "3 of 3", "2 of 3", "-", "-", "-", "same")),
        (finding(Change.SAME, base=1.0), ("title of fps", "1", "-", "-", "-", "-", "same")),
    ],
)
def test_rows(found: Finding, row: tuple[str, ...]) -> None:
    """Show amounts in their unit, factors with three decimals, and a dash for what there is not."""
    assert len(row) == len(TITLES)
    assert cells(found, RESULT) == row
