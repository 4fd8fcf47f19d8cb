"""Words of gsb-share card and verify, and what programs get."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from gpusimbench.evaluator.json_values import document_of, dump, picked
from gpusimbench.evaluator.share.dataset.contents import DAMAGED
from gpusimbench.evaluator.share.dataset.publish import Published
from gpusimbench.evaluator.share.dataset.verify import Verification
from gpusimbench.schemas import __version__
from gpusimbench.schemas.text import plural

_MOST_PERSONAL = 10
_MOST_FINDINGS = 200


def published_lines(published: Published) -> Iterator[str]:
    """What was written."""
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
    """What a publisher has to know before anybody else does."""
    for one in published.looked_at:
        if one.checkup.outcome == DAMAGED:
            yield f"{one.name} is damaged, and named as such: {'; '.join(one.checkup.findings)}"
    found: dict[tuple[str, str, str], int] = {}
    for some in published.personal.values():
        for one_found in some:
            key = (one_found.what, one_found.text, one_found.where)
            found[key] = found.get(key, 0) + 1
    for (what, text, where), count in list(found.items())[:_MOST_PERSONAL]:
        yield f"look before you publish: {plural(count, 'recording')} with a {what}, {text}, in {where}"
    if len(found) > _MOST_PERSONAL:
        yield f"and {len(found) - _MOST_PERSONAL} more of this kind"


def verification_lines(verification: Verification) -> Iterator[str]:
    """Everything that was found, and what it comes to."""
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
    """A JSON document."""
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
