"""gsb-share verify: whether a set is what its manifest says, and whether its tables follow from its recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path

from gpusimbench.evaluator.json_values import document_of, dump, picked
from gpusimbench.evaluator.report.parquet import METRICS, RUNS, frames, polars
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.share.dataset.card import CARD
from gpusimbench.evaluator.share.dataset.citation import CITATION
from gpusimbench.evaluator.share.dataset.contents import (
    BROKEN,
    DAMAGED,
    LookedAt,
    evaluate_set,
    identity,
    is_recording,
    look_at,
    sum_of,
    sum_of_bytes,
)
from gpusimbench.evaluator.share.dataset.manifest import (
    CHECKSUMS,
    MANIFEST,
    MAX_BYTES,
    FileEntry,
    Manifest,
    RecordingEntry,
    load_manifest,
    read_sums,
)
from gpusimbench.evaluator.share.dataset.places import SetPlace, place_of
from gpusimbench.evaluator.share.dataset.publish import DESCRIBING, entries_of, table_sums
from gpusimbench.evaluator.share.dataset.tables import compare_table
from gpusimbench.schemas import __version__
from gpusimbench.schemas.commands.progress import each
from gpusimbench.schemas.errors import DamagedRecording, ExitCode, GsbError, Unreachable, UsageError
from gpusimbench.schemas.location import Location, Place
from gpusimbench.schemas.text import cut, plural

_SUMS_BYTES = 16 << 20
_LONGEST = 80
_MOST_FINDINGS = 200
_GB = 1e9


class Kind(Enum):
    """What can be wrong with a set, in a word, and the exit code that it means."""

    MISSING = ("missing", ExitCode.DATA_LOST)
    CHANGED = ("changed", ExitCode.DATA_LOST)
    DAMAGED = ("damaged", ExitCode.DATA_LOST)
    EXTRA = ("not named", ExitCode.GATE_FAILED)
    DISAGREES = ("disagrees", ExitCode.GATE_FAILED)
    BROKEN = ("breaks a rule", ExitCode.GATE_FAILED)

    @property
    def word(self) -> str:
        """The word for it in a line of the command."""
        return self.value[0]

    @property
    def code(self) -> ExitCode:
        """The exit code that a problem of this kind gives the command."""
        return self.value[1]


@dataclass(frozen=True)
class SetProblem:
    """Something that is wrong, of which file, in a sentence."""

    kind: Kind
    path: str
    said: str


@dataclass(frozen=True)
class Verification:
    """What became of verifying a set.

    manifest       its own
    findings       everything that is wrong
    unchecked      what could not be looked at, and why, a sentence each
    recordings     how many were read whole, evaluated and held against the rules
    bytes          of the files whose digest was computed
    fetched_bytes  that came from elsewhere
    tables         names of the tables whose every value is what the recordings give
    """

    manifest: Manifest
    findings: tuple[SetProblem, ...]
    unchecked: tuple[str, ...]
    recordings: int
    bytes: int
    fetched_bytes: int
    tables: tuple[str, ...]

    @property
    def exit_code(self) -> ExitCode:
        """3 where anything is missing, changed or damaged, 4 where anything disagrees, 5 without a recording."""
        codes = {finding.kind.code for finding in self.findings}
        if ExitCode.DATA_LOST in codes or ExitCode.GATE_FAILED in codes:
            return min(codes)
        return ExitCode.OK if self.recordings else ExitCode.NOTHING_COMPARABLE


def verify_set(given: Place, *, limit_bytes: float, tolerance: float, say: Callable[[str], None]) -> Verification:
    """Look at everything in a set, in a folder or at an address.

    limit_bytes  how much may be fetched from elsewhere
    tolerance    relative, of numbers in tables; 0 wants the same bits
    say          takes what happens on the way

    DamagedRecording where the manifest cannot be read, Unreachable where it cannot be had, UsageError where more would
    have to be fetched.
    """
    polars()
    place = place_of(given)
    try:
        data = place.read(MANIFEST, MAX_BYTES)
    except Unreachable as error:
        raise Unreachable(f"{given} is no set that can be verified: {error}; 'gsb-share card' makes one") from None
    manifest = load_manifest(data)
    total = sum(told.bytes for told in manifest.sums.values())
    if isinstance(given, Location):
        if total > limit_bytes:
            raise UsageError(
                f"{given} has {total / _GB:.1f} GB, and {limit_bytes / _GB:g} may be fetched: --limit sets how much"
            )
        say(f"fetching {plural(len(manifest.sums), 'file')} with {total / 1e6:.1f} MB, one after another; none is kept")
    return _Verifier(place, manifest, data, tolerance).verify()


class _Verifier:
    def __init__(self, place: SetPlace, manifest: Manifest, data: bytes, tolerance: float) -> None:
        self._place = place
        self._manifest = manifest
        self._data = data
        self._tolerance = tolerance
        self._findings: list[SetProblem] = []
        self._unchecked: list[str] = []
        self._bytes = 0
        self._tables: list[str] = []

    def verify(self) -> Verification:
        self._checksums()
        self._names()
        self._unchecked.append(
            f"whether what {CARD} and {CITATION} say follows from the recordings: look at the tables"
        )
        files = each(self._manifest.files, "verifying files", [float(file.sum.bytes) for file in self._manifest.files])
        looked_at = [one for file in files if (one := self._look_at(file)) is not None]
        asked = [file for file in self._manifest.files if is_recording(file.path)]
        if len(looked_at) == len(asked):
            self._follows(looked_at)
        else:
            self._unchecked.append(
                f"{METRICS} and {RUNS} against the recordings, {len(asked) - len(looked_at)} of which are not there as "
                "they were"
            )
            self._written(None)
        return Verification(
            self._manifest,
            tuple(self._findings),
            tuple(self._unchecked),
            recordings=len(looked_at),
            bytes=self._bytes,
            fetched_bytes=self._place.fetched_bytes,
            tables=tuple(self._tables),
        )

    def _add(self, kind: Kind, path: str, said: str) -> None:
        self._findings.append(SetProblem(kind, path, said))

    def _checksums(self) -> None:
        try:
            told = read_sums(self._place.read(CHECKSUMS, _SUMS_BYTES).decode())
        except Unreachable as error:
            self._add(Kind.MISSING, CHECKSUMS, str(error))
            return
        except (DamagedRecording, UnicodeDecodeError) as error:
            self._add(Kind.CHANGED, CHECKSUMS, str(error).removeprefix(f"{CHECKSUMS}: "))
            return
        wanted = {path: found.sha256 for path, found in self._manifest.sums.items()}
        wanted[MANIFEST] = sum_of_bytes(self._data).sha256
        for path in sorted(told.keys() | wanted.keys()):
            if path not in told or path not in wanted:
                here, there = (CHECKSUMS, MANIFEST) if path in told else (MANIFEST, CHECKSUMS)
                self._add(Kind.DISAGREES, path, f"{here} names it, and {there} does not")
            elif told[path] != wanted[path]:
                what = "of these bytes" if path == MANIFEST else f"that {MANIFEST} says"
                self._add(Kind.DISAGREES, path, f"{CHECKSUMS} has another digest than the one {what}")

    def _names(self) -> None:
        found = self._place.names()
        if isinstance(found, str):
            self._unchecked.append(f"whether there are files that {MANIFEST} does not name: {found}")
            return
        named = {*self._manifest.sums, MANIFEST, CHECKSUMS}
        for path in found.files:
            if path not in named:
                self._add(Kind.EXTRA, path, f"{MANIFEST} does not name it")
        for path in found.others:
            self._add(Kind.EXTRA, path, "it is a link, or neither file nor folder; it was not followed")
        if found.hidden:
            few = ", ".join(found.hidden[:5]) + (" and others" if len(found.hidden) > 5 else "")
            self._unchecked.append(f"names that begin with a dot: {few}")

    def _look_at(self, file: FileEntry) -> LookedAt | None:
        """A recording that is as the manifest says; None of any other file."""
        recording = is_recording(file.path)
        if recording is not (file.recording is not None):
            self._add(Kind.DISAGREES, file.path, f"its name and {MANIFEST} disagree on whether it is a recording")
        with self._as_named(file) as path:
            return look_at(path, file.path, self._manifest.sample_time) if path and recording else None

    @contextmanager
    def _as_named(self, file: FileEntry) -> Iterator[Path | None]:
        """A file on this machine's disk; None where it is not there as the manifest says, which is then a finding."""
        with ExitStack() as stack:
            path = None
            try:
                copy = stack.enter_context(self._place.local(file.path, file.sum.bytes))
                found = sum_of(copy)
            except GsbError as error:
                self._absent(file, error)
            else:
                self._bytes += found.bytes
                if found == file.sum:
                    path = copy
                else:
                    self._add(Kind.CHANGED, file.path, f"its SHA-256 is {found.sha256}, not {file.sum.sha256}")
            yield path

    def _absent(self, file: FileEntry, error: GsbError) -> None:
        try:
            size = self._place.size(file.path)
        except Unreachable as gone:
            self._add(Kind.MISSING, file.path, str(gone))
            return
        if size != file.sum.bytes:
            self._add(Kind.CHANGED, file.path, f"it has {size} bytes, not {file.sum.bytes}")
        else:
            self._add(Kind.MISSING, file.path, str(error))

    def _follows(self, looked_at: Sequence[LookedAt]) -> None:
        evaluation = evaluate_set(looked_at, self._manifest.sample_time)
        found = entries_of(looked_at, evaluation)
        for file in self._manifest.recordings:
            if file.recording is not None and file.path in found:
                self._recording(file.path, file.recording, found[file.path])
        if identity([one.checkup.content_hash for one in looked_at]) != self._manifest.identity:
            self._add(Kind.DISAGREES, MANIFEST, "content_sha256 is not that of the recordings")
        self._written(evaluation)

    def _recording(self, path: str, told: RecordingEntry, found: RecordingEntry) -> None:
        for field in fields(RecordingEntry):
            there, here = getattr(told, field.name), getattr(found, field.name)
            if there != here:
                said, true = (cut(repr(value), _LONGEST) for value in (there, here))
                what = f"{field.name} is {said} in {MANIFEST}, and {true} by the recording"
                self._add(Kind.DISAGREES, path, what)
        if found.check == DAMAGED:
            self._add(Kind.DAMAGED, path, "; ".join(found.findings))
        elif found.check == BROKEN:
            self._add(Kind.BROKEN, path, "; ".join(found.findings))

    def _written(self, evaluation: Evaluation | None) -> None:
        for name in sorted(set(DESCRIBING) - {file.path for file in self._manifest.written}):
            self._add(Kind.MISSING, name, f"{MANIFEST} does not name it")
        expected = frames(evaluation) if evaluation else {}
        anew = table_sums(evaluation) if evaluation else {}
        for file in self._manifest.written:
            with self._as_named(file) as path:
                if path is None or file.path not in expected:
                    continue
                same = file.sum == anew[file.path]
                different = [] if same else compare_table(file.path, path, expected[file.path], self._tolerance)
                for sentence in different:
                    self._add(Kind.DISAGREES, file.path, sentence)
                if not different:
                    self._tables.append(file.path)


def verification_lines(verification: Verification) -> Iterator[str]:
    """What gsb-share prints of a verification: the set, the findings and the verdict."""
    manifest = verification.manifest
    yield (
        f"{manifest.title}: {plural(len(manifest.sums) + 2, 'file')}, {plural(len(manifest.recordings), 'recording')}, "
        f"licence {manifest.licence}, written by gpusimbench {manifest.written_by.get('gpusimbench', '?')}"
    )
    for finding in verification.findings[:_MOST_FINDINGS]:
        yield f"  {finding.kind.word}: {finding.path}: {finding.said}"
    if (more := len(verification.findings) - _MOST_FINDINGS) > 0:
        yield f"  and {more} more findings"
    for what in verification.unchecked:
        yield f"  not looked at: {what}"
    if verification.findings:
        kinds = Counter(finding.kind.word for finding in verification.findings)
        yield "NOT as its manifest says: " + ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        theirs = manifest.written_by.get("gpusimbench", "")
        if theirs and theirs != __version__:
            yield f"it was written by gpusimbench {theirs}; {__version__}, which is used here, may compute otherwise"
        return
    yield (
        f"{verification.bytes / 1e6:.1f} MB have the digests of manifest.json and SHA256SUMS; "
        f"{plural(verification.recordings, 'recording')} have their content hashes and keep the rules of integrity-1; "
        f"every value of {' and '.join(verification.tables)} follows from them"
        if verification.recordings
        else "there is no recording in it: nothing to verify"
    )


def dump_verification(verification: Verification) -> str:
    """A verification as a JSON document."""
    manifest = verification.manifest
    return dump(document_of({
        "gpusimbench": __version__,
        "exit_code": int(verification.exit_code),
        **picked(manifest, "title licence written_by"),
        "content_sha256": manifest.identity,
        "n_file": len(manifest.sums) + 2,
        "n_recording": verification.recordings,
        **picked(verification, "bytes fetched_bytes"),
        "tables": list(verification.tables),
        "findings": [{"kind": f.kind.word, "file": f.path, "said": f.said} for f in verification.findings],
        "not_looked_at": list(verification.unchecked),
    }))  # fmt: skip
