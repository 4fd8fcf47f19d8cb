"""What a set's folder has: its files as safe relative paths, and its recordings, each checked, read and evaluated."""

from __future__ import annotations

import hashlib
import os
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.findings import Report, check
from gpusimbench.evaluator.check.rules.rule import PROTOCOL, Scope, Severity, load_rules
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import DamagedRecording, GsbError
from gpusimbench.schemas.location import Place

MAX_FILES = 20_000
"""Files and folders of a set; more are refused."""

MAX_PATH = 512
MAX_PARTS = 16
_SEPARATORS_ELSEWHERE = "\\:"

_AT_ONCE = 1 << 20
INTEGRITY = "integrity-1"
WHOLE, BROKEN, DAMAGED = "whole", "broken", "damaged"
"""Outcomes: every rule of INTEGRITY holds; one is broken; the file is damaged, or a rule could not be asked."""


@dataclass(frozen=True)
class Found:
    """What lies in a folder and in those below it, each in order.

    files   regular files, by their paths with /
    others  symbolic links, which are not followed, and whatever else is neither file nor folder
    hidden  names that begin with a dot; what is below them is not looked at
    """

    files: tuple[str, ...]
    others: tuple[str, ...]
    hidden: tuple[str, ...]


def find(folder: Path) -> Found:
    """Look through a folder; GsbError where it cannot be read, or has more than MAX_FILES entries."""
    files: list[str] = []
    others: list[str] = []
    hidden: list[str] = []
    waiting = [""]
    seen = 0
    try:
        while waiting:
            below = waiting.pop()
            with os.scandir(folder / below) as entries:
                for entry in entries:
                    seen += 1
                    if seen > MAX_FILES:
                        raise GsbError(f"{folder} has more than {MAX_FILES} entries; publish it in parts")
                    path = f"{below}/{entry.name}" if below else entry.name
                    if entry.name.startswith("."):
                        hidden.append(path)
                    elif entry.is_dir(follow_symlinks=False):
                        waiting.append(path)
                    else:
                        (files if entry.is_file(follow_symlinks=False) else others).append(path)
    except OSError as error:
        raise GsbError(f"cannot look through {folder}: {error.strerror}") from None
    return Found(tuple(sorted(files)), tuple(sorted(others)), tuple(sorted(hidden)))


def why_not(path: str) -> str:
    """Why a text cannot be the path of a file of a set; empty where it can.

    Parts are separated by /. Names that begin with a dot are left to version control and downloaders.
    """
    if not path or len(path) > MAX_PATH:
        return f"it has {len(path)} characters; a path has 1 to {MAX_PATH}"
    if not path.isprintable() or any(0xD800 <= ord(c) < 0xE000 for c in path):
        return "it has characters that cannot be shown"
    if found := [c for c in _SEPARATORS_ELSEWHERE if c in path]:
        return f"it has a {found[0]}, which other systems take for more than a character"
    parts = path.split("/")
    if len(parts) > MAX_PARTS:
        return f"it leads through {len(parts)} folders, more than {MAX_PARTS}"
    if "" in parts:
        return "it begins or ends with /, or has two of them in a row"
    if any(part.startswith(".") for part in parts):
        return "a part of it begins with a dot"
    return ""


def collisions(paths: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of paths that some file systems take for one: they differ in case or in how an accent is written."""
    seen: dict[str, str] = {}
    pairs = []
    for path in paths:
        first = seen.setdefault(unicodedata.normalize("NFC", path).casefold(), path)
        if first != path:
            pairs.append((first, path))
    return pairs


@dataclass(frozen=True)
class Checkup:
    """One file, held against the rules. All of it was read: every CRC, every digest, the content hash.

    outcome       WHOLE, BROKEN or DAMAGED
    content_hash  of the recording, that of its content unless the outcome is DAMAGED; empty without an end record
    findings      "rule: what was found", of broken rules of INTEGRITY and of those that could not be asked
    warnings      of rules of INTEGRITY that are no requirement
    deviations    of broken rules of PROTOCOL that one file can break by itself
    """

    outcome: str
    content_hash: str
    findings: tuple[str, ...]
    warnings: tuple[str, ...]
    deviations: tuple[str, ...]


def check_up(path: Place, name: str = "") -> Checkup:
    """Check one file, which findings call by its name where it has one; nothing is raised for what it holds."""
    file = examine(path)
    integrity = check([file], [load_rules(INTEGRITY)])
    protocol = check([file], [load_rules(PROTOCOL)])
    findings = _findings(integrity, Severity.error)
    unasked = [u for u in integrity.unchecked if u.rule.level is Severity.error]
    if not findings:
        findings = [f"{u.rule.id}: not checked, {u.reason}" for u in unasked]
    if name:
        findings = [finding.replace(str(path), name) for finding in findings]
    damaged = unasked or any(f.rule.damage for f in integrity.findings if f.rule.level is Severity.error)
    alone = [f"{f.rule.id}: {f.found}" for f in protocol.findings if f.rule.of is Scope.file]
    return Checkup(
        outcome=DAMAGED if damaged else BROKEN if findings else WHOLE,
        content_hash="" if file.end is None else str(file.end.content_hash),
        findings=tuple(dict.fromkeys(findings)),
        warnings=tuple(_findings(integrity, Severity.warning)),
        deviations=tuple(alone),
    )


def _findings(report: Report, level: Severity) -> list[str]:
    return [f"{finding.rule.id}: {finding.found}" for finding in report.findings if finding.rule.level is level]


def is_recording(path: str) -> bool:
    """Whether a file of that name is looked at as a recording; of what a crash left, too."""
    return path.removesuffix(PARTIAL).endswith(".mcap")


@dataclass(frozen=True)
class Sum:
    """A file's identity: its size [byte] and the SHA-256 of its bytes, in hexadecimal."""

    bytes: int
    sha256: str


def sum_of(path: Path) -> Sum:
    """The size and the digest of a file; GsbError where it cannot be read."""
    digest, size = hashlib.sha256(), 0
    try:
        with path.open("rb") as stream:
            while piece := stream.read(_AT_ONCE):
                digest.update(piece)
                size += len(piece)
    except OSError as error:
        raise GsbError(f"cannot read {path}: {error.strerror}") from None
    return Sum(size, digest.hexdigest())


def sum_of_bytes(data: bytes) -> Sum:
    """The size and the digest of some bytes."""
    return Sum(len(data), hashlib.sha256(data).hexdigest())


@dataclass(frozen=True)
class LookedAt:
    """One recording of a set.

    name     its path in the set
    checkup  what the rules say
    read     what metrics need of it; Unreadable where it is damaged
    """

    name: str
    checkup: Checkup
    read: Run | Unreadable

    @property
    def run(self) -> Run | None:
        """The run that was read; None where the file is damaged."""
        return self.read if isinstance(self.read, Run) else None


def look_at(path: Path, name: str, sample_time: float) -> LookedAt:
    """Check and read a file that is called `name` in its set; nothing is raised for what it holds.

    sample_time  simulated time at which positions are compared [s]
    """
    checkup = check_up(path, name)
    if checkup.outcome == DAMAGED:
        why = "; ".join(checkup.findings)
        return LookedAt(name, checkup, Unreadable(Path(name), DamagedRecording(why)))
    # every digest was just compared
    read = Reader(sample_time, verify=False)(path)
    if isinstance(read, Unreadable):
        error = DamagedRecording(str(read.error).replace(str(path), name))
        damaged = replace(checkup, outcome=DAMAGED, findings=(*checkup.findings, str(error)))
        return LookedAt(name, damaged, Unreadable(Path(name), error))
    return LookedAt(name, checkup, replace(read, path=Path(name)))


def evaluate_set(looked_at: Iterable[LookedAt], sample_time: float) -> Evaluation:
    """Every metric of every group; damaged recordings are named in it and left out."""
    return evaluate([one.read for one in looked_at], sample_time=sample_time)


def labels_of(evaluation: Evaluation) -> dict[str, str]:
    """The group of each recording, by its path in the set; a copy of another one has none."""
    return {str(recording.path): result.label for result in evaluation.results for recording in result.group.recordings}


def identity(content_hashes: Sequence[str]) -> str:
    """SHA-256 [hex] of the distinct content hashes, sorted, a line each: the same set of runs has the same, however its
    files are called, packed or described."""
    return hashlib.sha256("".join(f"{one}\n" for one in sorted(set(content_hashes) - {""})).encode()).hexdigest()


def runs_of(looked_at: Iterable[LookedAt]) -> Iterator[Run]:
    """The recordings that could be read."""
    yield from (one.run for one in looked_at if one.run is not None)
