"""gsb-share card: the files that describe a folder, written into it; and what a publisher may not want to publish."""

from __future__ import annotations

import getpass
import re
import socket
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.parquet import METRICS, RUNS, parquet_tables, polars
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.share.dataset.card import CARD, KEYWORDS, card
from gpusimbench.evaluator.share.dataset.citation import CITATION, OWN, Publication, citation
from gpusimbench.evaluator.share.dataset.contents import (
    DAMAGED,
    Found,
    LookedAt,
    Sum,
    collisions,
    evaluate_set,
    find,
    identity,
    is_recording,
    labels_of,
    look_at,
    sum_of,
    sum_of_bytes,
    why_not,
)
from gpusimbench.evaluator.share.dataset.manifest import (
    CHECKSUMS,
    MANIFEST,
    FileEntry,
    Manifest,
    RecordingEntry,
    dump_manifest,
    is_manifest,
    load_manifest,
    versions,
    write_sums,
)
from gpusimbench.schemas.commands.progress import each, sizes
from gpusimbench.schemas.errors import GsbError, NothingComparable, UsageError
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.model_files import plain
from gpusimbench.schemas.text import few, plural
from gpusimbench.schemas.writing import write_files

_HOMES = re.compile(
    r"(?:/(?:home|Users|root|data/home|mnt/home)/[^\s\"':;,<>\\]{1,80}|[A-Z]:\\+Users\\+[^\\\s\"]{1,40})"
)
_MAIL = re.compile(r"[A-Za-z0-9._%+-]{1,64}@[A-Za-z0-9-]{1,63}(?:\.[A-Za-z0-9-]{1,63}){1,4}")
_COMMON = {"localhost", "root", "user", "ubuntu", "admin", "test", "home"}
_SHORTEST = 4
_MOST = 20  # of one recording

DESCRIBING = (CARD, CITATION, METRICS, RUNS)
"""Files that a card is made of, beside the manifest and the checksums."""

OURS = (*DESCRIBING, MANIFEST, CHECKSUMS)

_MOST_NAMED = 5
_MOST_PERSONAL = 10


@dataclass(frozen=True)
class Personal:
    """Something personal that a recording holds.

    what   "path of a home folder", "address of mail", "name of this host", "name of this user"
    text   itself
    where  the attachment
    """

    what: str
    text: str
    where: str


def personal(path: Place) -> list[Personal]:
    """What is found in the attachments of a recording and in what it says of its end; nothing where it is damaged."""
    found: dict[Personal, None] = {}
    with suppress(GsbError):
        recording = Recording(path)
        texts = [(name, recording.attachment(name) or b"") for name in recording.attachment_names()]
        if recording.configuration.model:
            texts = [(name, plain(name, data)) for name, data in texts]
        texts.append(("the reason of its end", recording.reason.encode(errors="replace")))
        for where, data in texts:
            for what, text in _in(data.decode(errors="replace")):
                found[Personal(what, text, where)] = None
                if len(found) >= _MOST:
                    break
    return list(found)


def _in(text: str) -> Iterator[tuple[str, str]]:
    for match in _HOMES.finditer(text):
        yield "path of a home folder", match[0]
    for match in _MAIL.finditer(text):
        yield "address of mail", match[0]
    for what, name in _of_this_machine():
        if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text):
            yield what, name


def _of_this_machine() -> Iterator[tuple[str, str]]:
    for what, name in (("name of this host", socket.gethostname()), ("name of this user", _user())):
        if len(name) >= _SHORTEST and name.lower() not in _COMMON:
            yield what, name


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # of a user that nobody knows, as in many a container
        return ""


@dataclass(frozen=True)
class Published:
    """What was written.

    manifest    of the set
    looked_at   its recordings
    evaluation  of them
    personal    by recording, what a publisher may not want to publish
    written     files of OURS whose bytes are new; the others were there as they are
    """

    manifest: Manifest
    looked_at: tuple[LookedAt, ...]
    evaluation: Evaluation
    personal: dict[str, list[Personal]]
    written: tuple[str, ...]


def publish(folder: Path, publication: Publication, *, sample_time: float, update: bool) -> Published:
    """Describe a folder; the same files and the same words give the same bytes.

    sample_time  simulated time at which positions are compared [s]
    update       whether files that were written before may be written anew

    UsageError where the folder holds what cannot be published or would be overwritten, NothingComparable without a
    recording, GsbError where a file cannot be read or written.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder: name the one that is to be published")
    polars()
    found = find(folder)
    _check(folder, found)
    if OWN.fullmatch(publication.licence) and "LICENSE" not in found.files:
        raise UsageError(
            f"{publication.licence} has its terms in the file LICENSE of the folder, and {folder} has none"
        )
    before = _before(folder, found, update)
    theirs = [path for path in found.files if path not in OURS]
    names = [path for path in theirs if is_recording(path)]
    if not names:
        raise NothingComparable(f"{folder} has no recordings (*.mcap): nothing to describe")
    sums = {path: sum_of(folder / path) for path in theirs}
    weights = sizes(folder / name for name in names)
    looked_at = tuple(look_at(folder / name, name, sample_time) for name in each(names, "checking recordings", weights))
    evaluation = evaluate_set(looked_at, sample_time)
    told = {name: some for name in names if (some := personal(folder / name))}
    manifest, texts = _texts(publication, looked_at, evaluation, sums)
    _check_edits(folder, before, texts)
    written = [name for name, data in texts.items() if not _is_there(folder / name, data)]
    write_files({folder / name: texts[name] for name in written})
    return Published(manifest, looked_at, evaluation, told, tuple(written))


def _check(folder: Path, found: Found) -> None:
    if found.others:
        raise UsageError(
            f"{folder} has links, or what is neither file nor folder: {few(found.others, _MOST_NAMED)}; only files "
            "can be published: put those themselves there"
        )
    for path in found.files:
        if why := why_not(path):
            raise UsageError(f"{folder}: {path!r} cannot be published under this name: {why}; rename it")
    if pairs := collisions([*found.files, *OURS]):
        raise UsageError(f"{folder}: {pairs[0][0]} and {pairs[0][1]} are one file on some systems; rename one of them")


def _before(folder: Path, found: Found, update: bool) -> Manifest | None:
    """The manifest of the last time; None where none of OURS is there."""
    there = [name for name in OURS if name in found.files]
    if not there:
        return None
    data = b""
    if MANIFEST in there:
        try:
            data = (folder / MANIFEST).read_bytes()
        except OSError as error:
            raise GsbError(f"cannot read {folder / MANIFEST}: {error.strerror}") from None
    if not is_manifest(data):
        raise UsageError(
            f"{folder} has files of its own that would be overwritten: {few(there, _MOST_NAMED)}; move them, or give "
            "words of yours to the card with --about FILE"
        )
    if not update:
        raise UsageError(f"{folder} has been described before ({few(there, _MOST_NAMED)}): --update does it anew")
    return load_manifest(data, older=True)


def _check_edits(folder: Path, before: Manifest | None, texts: Mapping[str, bytes]) -> None:
    # a file that is neither what was written then nor what would be written now was changed by somebody
    known = {file.path: file.sum for file in before.written} if before else {}
    for name in DESCRIBING:
        path = folder / name
        if path.exists() and sum_of(path) not in (known.get(name), sum_of_bytes(texts[name])):
            raise UsageError(
                f"{path} was changed since it was written, which --update would undo: remove it, or give words of "
                "yours to the card with --about FILE"
            )


def _texts(
    publication: Publication, looked_at: Sequence[LookedAt], evaluation: Evaluation, sums: Mapping[str, Sum]
) -> tuple[Manifest, dict[str, bytes]]:
    hashes = identity([one.checkup.content_hash for one in looked_at])
    size = sum(sums[one.name].bytes for one in looked_at)
    abstract = (
        f"{plural(len(looked_at), 'recording')} of robot simulators in {plural(len(evaluation.results), 'group')}, "
        "as MCAP files with full provenance, and the metrics that follow from them."
    )
    texts = {
        CARD: card(publication, looked_at, evaluation, size, hashes).encode(),
        CITATION: citation(publication, abstract, hashes, KEYWORDS).encode(),
        **parquet_tables(evaluation),
    }
    manifest = Manifest(
        title=publication.title,
        licence=publication.licence,
        sample_time=evaluation.sample_time,
        identity=hashes,
        written_by=versions(),
        files=_entries(looked_at, evaluation, sums),
        written=tuple(FileEntry(name, sum_of_bytes(texts[name])) for name in sorted(DESCRIBING)),
    )
    texts[MANIFEST] = dump_manifest(manifest).encode()
    digests = {path: told.sha256 for path, told in manifest.sums.items()}
    texts[CHECKSUMS] = write_sums({**digests, MANIFEST: sum_of_bytes(texts[MANIFEST]).sha256}).encode()
    return manifest, texts


def table_sums(evaluation: Evaluation) -> dict[str, Sum]:
    """Sizes and digests of the tables as this version of everything writes them."""
    return {name: sum_of_bytes(data) for name, data in parquet_tables(evaluation).items()}


def _entries(looked_at: Sequence[LookedAt], evaluation: Evaluation, sums: Mapping[str, Sum]) -> tuple[FileEntry, ...]:
    entries = entries_of(looked_at, evaluation)
    return tuple(FileEntry(path, told, entries.get(path)) for path, told in sorted(sums.items()))


def entries_of(looked_at: Sequence[LookedAt], evaluation: Evaluation) -> dict[str, RecordingEntry]:
    """What recordings were found to be, by path."""
    groups = labels_of(evaluation)
    return {
        one.name: RecordingEntry(
            content_hash=one.checkup.content_hash,
            run_id=one.run.provenance.run_id if one.run else "",
            status=one.run.status if one.run else "unreadable",
            reason=one.run.reason if one.run else "; ".join(one.checkup.findings),
            group=groups.get(one.name, ""),
            check=one.checkup.outcome,
            findings=one.checkup.findings,
        )
        for one in looked_at
    }


def _is_there(path: Path, data: bytes) -> bool:
    """Whether a file has these bytes."""
    try:
        return path.exists() and path.read_bytes() == data
    except OSError as error:
        raise GsbError(f"cannot read {path}: {error.strerror}") from None


def published_lines(published: Published) -> Iterator[str]:
    """What gsb-share prints of a set that was written."""
    manifest = published.manifest
    outcomes = Counter(one.checkup.outcome for one in published.looked_at)
    groups = len(published.evaluation.results)
    yield (
        f"{plural(len(manifest.recordings), 'recording')} in {plural(groups, 'group')}, "
        f"{sum(file.sum.bytes for file in manifest.files) / 1e6:.1f} MB: "
        + ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items(), key=lambda item: -item[1]))
    )
    yield f"content of all recordings: sha256 {manifest.identity}"
    yield f"written: {', '.join(published.written)}" if published.written else "nothing to write: all is as it would be"


def warnings_of(published: Published) -> Iterator[str]:
    """Warnings to read before the set is published: damaged files, and text that may be personal."""
    for file in published.looked_at:
        if file.checkup.outcome == DAMAGED:
            yield f"{file.name} is damaged, and named as such: {'; '.join(file.checkup.findings)}"
    found = Counter(one for some in published.personal.values() for one in some)
    for one, count in list(found.items())[:_MOST_PERSONAL]:
        yield f"look before you publish: {plural(count, 'recording')} with a {one.what}, {one.text}, in {one.where}"
    if len(found) > _MOST_PERSONAL:
        yield f"and {len(found) - _MOST_PERSONAL} more of this kind"
