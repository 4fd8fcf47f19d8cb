"""What was not compared is never told as a yes: every function that makes a claim of several parts."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.audit.distribution import LawTest
from gpusimbench.evaluator.audit.replays import distinct, unreproduced
from gpusimbench.evaluator.audit.verdict import AuditLevel, Match, ladder
from gpusimbench.evaluator.compare.counted import all_alike, compare_bits, compare_determinism
from gpusimbench.evaluator.compare.finding import Change
from gpusimbench.evaluator.metrics.levels import verdict
from gpusimbench.evaluator.missing import Missing, every
from gpusimbench.evaluator.read.streams import Fingerprints
from gpusimbench.evaluator.report import verdicts, words
from gpusimbench.evaluator.report.sections.mechanics import cells
from gpusimbench.evaluator.results import identity_metrics as identity
from gpusimbench.evaluator.results.details import DistinctEnvs, DistinctRuns
from gpusimbench.evaluator.results.fidelity import CheckVerdict, fidelity
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.results.identity_metrics import identical
from gpusimbench.evaluator.results.metric import Estimate, missing
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.validity import validity_of
from gpusimbench.evaluator.runs.physics.facts import Check, PhysicsFacts, measured
from gpusimbench.evaluator.runs.state_hashes import histories_of
from gpusimbench.evaluator.share.leaderboard import formats as board_words
from gpusimbench.evaluator.share.leaderboard.reproduction import Replay, Reproduction
from gpusimbench.schemas.text import plural

THREE = st.lists(st.sampled_from([True, False, None]), max_size=5)
"""What is known of some parts: any mixture of yes, no and not compared, and no part at all."""


def _estimate(name: str, value: float | None, n: int, without_hashes: int | None = None) -> Estimate:
    if value is None:
        return missing(METRICS[name], "nobody looked")
    details = (DistinctEnvs if name == "distinct_envs" else DistinctRuns)(without_hashes=without_hashes)
    return Estimate(METRICS[name], value, n=n, details=details)


@dataclass(frozen=True)
class _Run:
    """As much of a Run as bits need: None has no state hashes, others are equal where their numbers are."""

    state: int | None
    n_env: int = 2
    apart_by_design: str = ""
    simulation: None = None
    fields: tuple[str, ...] = ()
    first_step: int = 0
    timed_histories: None = None

    @property
    def configuration(self) -> Any:
        return SimpleNamespace(
            n_env=self.n_env, dt=0.1, seed=0, initial="", settings=(), phases=("capture",), run_index=0
        )

    @property
    def histories(self) -> Any:
        if self.state is None:
            return Missing("no states were captured")
        hashes = np.full((3, self.n_env), self.state, dtype=np.uint64)
        return histories_of(Fingerprints(self.first_step + np.arange(3), hashes))


def _runs(states: list[int | None], n_env: int = 2) -> list[Any]:
    return [_Run(state, n_env) for state in states]


STATES = st.lists(st.sampled_from([1, 2, None]), max_size=4)


@given(THREE)
def test_every(parts: list[bool | None]) -> None:
    """Yes only where there are parts, and all were compared and hold; no where any is known not to."""
    claim = every(parts)
    assert claim.yes == (bool(parts) and all(part is True for part in parts))
    assert (claim.holds is False) == (False in parts)
    assert bool(claim.why_not) == (claim.holds is None)
    nested = every([claim, True])
    assert nested.yes == claim.yes


@given(st.sampled_from([None, 1.0, 2.0]), st.integers(0, 3), st.integers(0, 2))
def test_identical(value: float | None, n: int, without: int) -> None:
    """Claim alike environments or runs only of two at least, of which each has hashes; in every text that says so."""
    metric = _estimate("distinct_runs", value, n, without_hashes=without)
    yes = value == 1 and n > 1 and not without
    claim = identical(metric)
    assert claim.yes == yes
    assert ("alike" in words.all_alike(metric)) == yes
    assert (claim.holds is None) == bool(claim.why_not)


def _result(value: float | None, n: int, level: str = "default", label: str = "engine") -> Any:
    metrics = {name: _estimate(name, None, 0) for name in METRICS}
    metrics |= {name: _estimate(name, value, n) for name in ("distinct_envs", "distinct_runs")}
    group = SimpleNamespace(key=SimpleNamespace(determinism=level), complete=(None,) * n)
    return SimpleNamespace(metrics=metrics, group=group, label=label)


@given(st.lists(st.tuples(st.sampled_from([None, 1.0, 2.0]), st.integers(1, 3)), min_size=1, max_size=4))
def test_the_verdicts_of_a_report(groups: list[tuple[float | None, int]]) -> None:
    """Say that a simulator repeats itself only of groups that were compared, and no where any of them differs."""
    results = [_result(value, n) for value, n in groups]
    compared = [value for value, n in groups if value is not None and n > 1]
    for answer in (verdicts.repeats(results), verdicts.alike(results)):
        assert answer.text == ("not compared" if not compared else "yes" if set(compared) == {1.0} else "no")
        if len(compared) > 1:
            of = compared.count(2.0)
            left = len(groups) - len(compared)
            without = f", {plural(left, 'group')} not compared" if left else ""
            said = f"{of} of {len(compared)} groups" if of else f"all {len(compared)} groups{without}"
            assert answer.notes == (said,)


@given(st.lists(st.tuples(st.sampled_from([1.0, 2.0]), *[st.sampled_from("ab")] * 2), min_size=2, max_size=5))
def test_an_option_with_which_runs_repeat_is_named(groups: list[tuple[float, str, str]]) -> None:
    """Name the first option that all groups with a yes share, and no group with a no has."""
    results = [_result(value, 2, label=f"engine [default, x={x}, y={y}]") for value, x, y in groups]
    held, differ = ([group[1:] for group in groups if group[0] == value] for value in (1.0, 2.0))
    expected = [
        f"yes with {name}={held[0][at]}"
        for at, name in enumerate("xy")
        if held and all(one[at] == held[0][at] for one in held) and all(one[at] != held[0][at] for one in differ)
    ][:1]
    notes = verdicts.repeats(results).notes
    assert [note for note in notes if note.startswith("yes with")] == (expected if differ else [])


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from([None, 1.0, 2.0])), max_size=6))
def test_levels_that_repeat_themselves_are_named(groups: list[tuple[str, float | None]]) -> None:
    """Name the level of determinism at which all groups were compared and are identical, or how many there are."""
    answer = verdicts.repeats([_result(2.0, 2), *(_result(value, 2, level) for level, value in groups)])
    held = [level for level in "abc" if {value for name, value in groups if name == level} == {1.0}]
    said = [f"yes at {held[0]}"] if len(held) == 1 else [f"yes at {len(held)} levels"] if held else []
    assert (answer.text, *answer.notes) == ("no", "2 distinct of 2", *said)


@given(STATES, STATES, st.integers(1, 2))
def test_comparing_two_sets(base: list[int | None], head: list[int | None], n_env: int) -> None:
    """Say "identical", or that nothing changed, only of runs that all have state hashes, and of more than one."""
    sides = _runs(base, n_env), _runs(head, n_env)
    for side, states in zip(sides, (base, head), strict=True):
        assert all_alike(GroupRuns(side)) == (len(states) > 1 and None not in states and len(set(states)) == 1)
    for finding in compare_determinism(*map(GroupRuns, sides)):
        told = finding.name == "distinct_envs"
        for said, states in zip(finding.said, (base, head), strict=True):
            if said.startswith("identical"):
                assert None not in states
                assert (n_env if told else len(states)) > 1
    bits = compare_bits(*sides)
    if bits is not None and bits.change is Change.SAME:
        assert base
        assert head
        assert len({*base, *head}) == 1
        assert None not in base
    count = identity.identical_steps(*sides)
    assert (count > 0) == (bool(base and head) and len({*base, *head}) == 1 and None not in base)


def test_states_of_different_steps() -> None:
    """Compare no bits of states that were captured at different steps, though they are the same."""
    early, late = [[_Run(1, first_step=first)] * 2 for first in (0, 5)]
    found = compare_bits(early, late)  # type: ignore[arg-type]
    assert (found.change, found.missing) == (Change.NOT_COMPARED, "different steps were captured")
    same = compare_bits(late, late)  # type: ignore[arg-type]
    assert (same.change, same.said) == (Change.SAME, ("", "bit-identical at 3 steps"))


def _no_test() -> LawTest | str:
    return "no test"


@given(THREE, st.lists(st.sampled_from(["", "the timed phase"]), min_size=5, max_size=5), st.sampled_from([None, 0, 9]))
def test_the_ladder_of_an_audit(parts: list[bool | None], left_out: list[str], ulps: int | None) -> None:
    """Reach a level only where each replay was compared, and all of each; without a replay none."""
    matches = [
        Match(part is True, part, 0 if part else ulps, left_out=left, no_ulps="" if ulps is not None or part else "?")
        for part, left in zip(parts, left_out, strict=False)
    ]
    found = ladder(matches, _no_test, max_ulps=4, originals=1)
    whole = bool(parts) and not any(left_out[: len(parts)])
    assert (found.level is AuditLevel.BIT_IDENTICAL) == (whole and all(part is True for part in parts))
    if found.level in (AuditLevel.SAME_UP_TO_ENV_ORDER, AuditLevel.WITHIN_ULPS):
        assert whole
        assert found.level is AuditLevel.WITHIN_ULPS or None not in parts
    if not parts:
        assert found.level is None
        assert found.meets(AuditLevel.WITHIN_ULPS) is None


@given(STATES, STATES)
def test_the_runs_of_an_audit(originals: list[int | None], replays: list[int | None]) -> None:
    """Count distinct runs, and call an original reproduced, only where all have state hashes."""

    class _Recording:
        path = SimpleNamespace(name="run")

        def __init__(self, state: int | None) -> None:
            self.state = state

        def fingerprints(self, phase: str) -> Fingerprints | None:
            there = self.state is not None and phase == "capture"
            return Fingerprints(np.arange(2), np.full((2, 1), self.state, dtype=np.uint64)) if there else None

    there, here = ([_Recording(state) for state in side] for side in (originals, replays))
    known = None not in [*originals, *replays]
    found = distinct(there, here)  # type: ignore[arg-type]
    if originals or replays:
        assert (found is not None) == known
    if not unreproduced(there, here):  # type: ignore[arg-type]
        assert not originals or (known and set(originals) <= set(replays))


@given(THREE)
def test_checks_of_mechanics(parts: list[bool | None]) -> None:
    """Say that a check holds only where it was measured, and in how many runs that is where it is not all."""

    def facts(part: bool | None) -> PhysicsFacts:
        check = Check.FINITE
        values = [0.0 if part else 1.0]
        fact = Missing("no") if part is None else measured(
            values, low=0.0, high=0.0, tolerance=0.0, of="none"
        )  # fmt: skip
        return PhysicsFacts("scene", 1, ((0, 0),), {check: fact})

    found = fidelity("group", [facts(part) for part in parts])
    told = [part for part in parts if part is not None]
    assert bool(found.of(CheckVerdict.HELD)) == (bool(told) and all(told))
    for row in found.of(CheckVerdict.HELD):
        assert ("measured in" in cells(row)[-1]) == (None in parts)


@given(THREE)
def test_overflow(parts: list[bool | None]) -> None:
    """Say that no buffer overflowed only where every run tells."""
    runs = [
        SimpleNamespace(
            counts={}, action_streams={}, simulation=None,
            overflows={} if part is None else {"capture": SimpleNamespace(bits=(), spread=False)},
        )
        for part in parts
    ]  # fmt: skip
    group: Any = SimpleNamespace(complete=runs, recordings=runs)
    assert (words.overflow(validity_of(group)) == "none") == (bool(parts) and None not in parts)


@given(THREE)
def test_replays_on_a_leaderboard(parts: list[bool | None]) -> None:
    """Count as reproduced only what agrees, and as another machine only what is known to be one."""
    replays = tuple(Replay(str(i), True, part, f"machine {i}") for i, part in enumerate(parts))
    said = board_words.reproduced(Reproduction(1, 1 if parts else 0, {"original": replays} if parts else {}))
    if parts:
        assert ("none other than its own" in said) == all(part is False for part in parts)
        others = parts.count(True)
        assert (f"{others} other than its own" in said) == (others > 0)
    unknown = tuple(Replay(str(i), part, False, "machine") for i, part in enumerate(parts))
    assert len(Reproduction(1, 0, {"original": unknown}).agreeing) == parts.count(True)


def test_environments_at_other_origins(tmp_path: Any) -> None:
    """Call no group "bit-identical" whose environments and runs nobody compared, on the page itself."""
    from gpusimbench.evaluator.report.document import report
    from gpusimbench.evaluator.report.source import Source
    from gpusimbench.evaluator.results.evaluate import evaluate_files
    from tests.synthetic import grid, write_recording

    final = grid(2)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    origins = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    for dt in (1.0, 0.5):  # two groups of one run each
        write_recording(tmp_path, final, simulator="physx", origins=origins, dt=dt, steps=round(5 / dt))
    source = Source(evaluate_files(sorted(tmp_path.glob("*.mcap"))), False, "")
    (table,) = [one for one in report(source).tables() if one.key == "simulators"]
    (row,) = table.rows
    assert [one.text for one in row.cells[1:3]] == ["not compared", "not compared"]


@pytest.mark.parametrize("value", [None, 1.0])
def test_a_reason_is_told(value: float | None) -> None:
    """Give the metric's own reason where it has one."""
    assert identical(_estimate("distinct_envs", value, 1)).why_not


@pytest.mark.parametrize("agree", [True, None])
def test_equality_at_one_step(agree: bool | None) -> None:
    """Call positions bit-identical without more only where state hashes of every step say so."""
    found = verdict(np.zeros((2, 1, 1, 2)), hashes_agree=agree)
    said = words.equality(identity._level(METRICS["equality_runs"], found, 2))
    assert said.startswith("bit-identical")
    assert ("sample step" in said) == (agree is None)


def test_how_many_groups_repeat_themselves() -> None:
    """Count those of which it is known, in words that agree with the number."""
    said = [words.repeating(claims) for claims in ([True, None], [True, False], [False, False], [True, True])]
    assert said == [
        "1 of 1 group with several runs repeats bit for bit",
        "1 of 2 groups with several runs repeats bit for bit",
        "0 of 2 groups with several runs repeat bit for bit",
        "2 of 2 groups with several runs repeat bit for bit",
    ]
