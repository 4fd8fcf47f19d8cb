"""In which way the recordings of a release may differ from those of the good one."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.diff.brief import apart, equal_before, gap_before, place_of
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.result import Difference
from gpusimbench.evaluator.diff.words import amount
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.numbers import length
from gpusimbench.schemas.errors import ExitCode, GsbError, NothingComparable
from gpusimbench.schemas.text import plural

STATES, GSB_COMPARE = "states", "gsb-compare"

_CANNOT_TELL = 125  # as of git bisect run
_LEAST_OF_SHELLS = 126  # 126, 127: cannot be run; 128 and more: ended by a signal
_LONGEST = 160


@dataclass(frozen=True)
class ReleaseVerdict:
    """Whether a release differs from the good one; None where that cannot be told, and what that stands on."""

    different: bool | None
    evidence: str


Predicate = Callable[[Sequence[Recording], Sequence[Recording]], ReleaseVerdict]
"""Holds a release's recordings against those of the good one, which come first."""


def predicate_of(text: str) -> Predicate:
    """The predicate of that name; gsb-compare with options of its own; else the command that it is."""
    if text == STATES:
        return by_states
    given = shlex.split(text)
    if compares(text):
        command = [sys.executable, "-P", "-m", "gpusimbench.evaluator.cli.compare", *given[1:]]
        return lambda good, other: _by_compare([*command, *_folders(good, other)])
    return lambda good, other: _by_command([*given, *_folders(good, other)])


def compares(text: str) -> bool:
    """Whether a predicate is gsb-compare, which needs several runs and a timed phase."""
    return shlex.split(text)[:1] == [GSB_COMPARE]


def by_states(good: Sequence[Recording], other: Sequence[Recording]) -> ReleaseVerdict:
    """Whether any bit of any state differs, run by run; not to be told where runs of the good release differ."""
    if any(by_states(good[:1], [other_run]).different for other_run in good[1:]):
        return ReleaseVerdict(None, "runs of the good release differ from each other: use --predicate gsb-compare")
    for one, another in zip(good, other, strict=False):
        try:
            found = compare(one, another)
        except NothingComparable as error:
            return ReleaseVerdict(None, str(error))
        if found.first is not None:
            gap = equal_before(found.first) if gap_before(found.first) else ""
            return ReleaseVerdict(True, f"from step {found.first.step_a} on{gap}{_apart(found)}")
        if not found.bit_identical:
            return ReleaseVerdict(None, "their bits cannot be compared")
    return ReleaseVerdict(False, "all states are bit-identical")


def first_number(a: Recording, b: Recording) -> str:
    """The first number in which two recordings differ, and by how much; empty where no recorded state does."""
    first = compare(a, b).first
    if first is None or first.state is None:
        return ""
    number = first.state.number
    return f"step {first.state.step}, {place_of(number)}: {number.a} and {number.b}, {apart(number, named=True)}"


def _apart(found: Difference) -> str:
    # how far bodies get, or joints where there are no bodies
    if isinstance(found.growth, Missing):
        joints = [field for field in found.compared.fields if "/qpos" in field.field and field.max_distance]
        return "".join(f"; joints up to {amount(field.max_distance, field.unit)} apart" for field in joints)
    rows = [(d, t) for d, t in zip(found.growth.largest, found.growth.times, strict=True) if d]
    if not rows:
        return ""
    most, at = max(rows)
    reached = "" if found.growth.to_1mm is None else f", 1 mm at {found.growth.to_1mm:g} s"
    fallen = found.growth.fallen if found.growth.max_not_fallen else 0  # those lie metres further apart
    fell = f", without {plural(fallen, 'body', 'bodies')} that fell off the board" if fallen else ""
    return f"; bodies up to {length(most)} apart at {at:g} s{fell}{reached}"


def _folders(good: Sequence[Recording], other: Sequence[Recording]) -> list[str]:
    return [str(Path(str(recordings[0].path)).parent) for recordings in (good, other)]


def _by_compare(command: Sequence[str]) -> ReleaseVerdict:
    done = _run(command)
    said = _first(done.stdout)
    if done.returncode == ExitCode.NOTHING_COMPARABLE:
        return ReleaseVerdict(None, said or _last(done.stderr))
    if done.returncode not in (ExitCode.OK, ExitCode.GATE_FAILED):
        raise GsbError(f"gsb-compare ended with exit code {done.returncode}: {_last(done.stderr)}")
    return ReleaseVerdict(done.returncode == ExitCode.GATE_FAILED, said)


def _by_command(command: Sequence[str]) -> ReleaseVerdict:
    done = _run(command)
    said = _last(done.stdout) or _last(done.stderr)
    code = done.returncode
    if code == _CANNOT_TELL:
        return ReleaseVerdict(None, said)
    if code < 0 or code >= _LEAST_OF_SHELLS:
        raise GsbError(f"the predicate '{command[0]}' ended with exit code {code}: {said}")
    return ReleaseVerdict(code != 0, said or f"exit code {code}")


def _run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace")
    except OSError as error:
        raise GsbError(f"cannot start the predicate '{command[0]}': {error.strerror}") from None


def _first(text: str) -> str:
    return next((one.strip() for one in text.splitlines() if one.strip()), "")[:_LONGEST]


def _last(text: str) -> str:
    return _first("\n".join(reversed(text.splitlines())))
