"""Which code of this project a Python imports: two machines agree where these are equal."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench import recorder, schemas
from gpusimbench.recorder.probes.software import describe_software

_READ = (".py", ".binpb")


@dataclass(frozen=True)
class Code:
    """This project's code.

    version  of the package
    commit   of the checkout that it is imported from; empty where it is installed
    sha256   of the names and contents of all its modules that record
    """

    version: str
    commit: str
    sha256: str

    def __str__(self) -> str:
        commit = f", commit {self.commit[:12]}" if self.commit else ""
        return f"gpusimbench {self.version}{commit}, modules {self.sha256[:12]}"


def code() -> Code:
    """What this process imports."""
    total = hashlib.sha256()
    for package in (recorder, schemas):
        root = Path(package.__path__[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in _READ):
            total.update(f"{package.__name__}/{path.relative_to(root).as_posix()}\n".encode())
            total.update(hashlib.sha256(path.read_bytes()).digest())
    told: dict[str, Any] = describe_software()["recorder"]
    return Code(schemas.__version__, told.get("commit") or "", total.hexdigest())
