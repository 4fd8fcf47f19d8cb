"""Sets of recordings for tests: real ones, described by the command."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

from gpusimbench.evaluator.cli.share import main
from gpusimbench.evaluator.share.dataset.contents import find, sum_of
from gpusimbench.evaluator.share.dataset.manifest import CHECKSUMS, MANIFEST, write_sums

WORDS = ("--title", "Three short runs", "--licence", "CC-BY-4.0", "--author", "Doe, Jane; Some University")
WHEN = ("--sample-time", "1")


def described(folder: Path, recordings: Iterable[Path], *more: str) -> Path:
    """A folder with copies of recordings, described."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in recordings:
        shutil.copy(path, folder)
    assert main(["card", str(folder), *WORDS, *WHEN, *more]) == 0
    return folder


def rename_in(folder: Path, old: bytes, new: bytes) -> None:
    """Change a manifest by hand, and make SHA256SUMS agree with it again."""
    manifest = folder / MANIFEST
    data = manifest.read_bytes()
    assert old in data
    manifest.write_bytes(data.replace(old, new))
    sums = {path: sum_of(folder / path).sha256 for path in find(folder).files if path != CHECKSUMS}
    (folder / CHECKSUMS).write_text(write_sums(sums))
