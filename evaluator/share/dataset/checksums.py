"""SHA256SUMS: digests of files in the format that ``sha256sum -c`` reads."""

from __future__ import annotations

import re
from collections.abc import Mapping

from gpusimbench.schemas.errors import DamagedRecording

CHECKSUMS = "SHA256SUMS"

_LINE = re.compile(r"([0-9a-f]{64})  ([^\n]+)\n")


def write_sums(digests: Mapping[str, str]) -> str:
    """The file: a digest [hex], two spaces, and the path, sorted by path. Paths hold no backslash and no line feed."""
    return "".join(f"{digest}  {path}\n" for path, digest in sorted(digests.items()))


def read_sums(text: str) -> dict[str, str]:
    """Digests by path; DamagedRecording names the first line that is none, or names a path for the second time."""
    found: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(keepends=True), start=1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise DamagedRecording(f"{CHECKSUMS}: line {number} is not a digest, two spaces and a path")
        if match[2] in found:
            raise DamagedRecording(f"{CHECKSUMS}: line {number} names a path for the second time")
        found[match[2]] = match[1]
    return found
