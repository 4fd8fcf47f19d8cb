"""What gsb-info says, for programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from gpusimbench.evaluator.check.inspection import Inspection
from gpusimbench.evaluator.json_values import dump, plain
from gpusimbench.schemas import __version__
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.location import Place

SCHEMA_VERSION = 1


def dump_info(found: Sequence[Inspection], unreadable: Sequence[tuple[Place, GsbError]]) -> str:
    """A JSON document with an object for each file, those that are no recordings with their error."""
    files: list[Any] = [_file(one) for one in found]
    files += [{"path": str(path), "status": "unreadable", "reason": str(error)} for path, error in unreadable]
    document = {"schema_version": SCHEMA_VERSION, "gpusimbench": __version__, "files": files}
    return dump(document)


def _file(value: Any) -> Any:
    # not dataclasses.asdict, which follows a stranger's JSON to any depth
    if is_dataclass(value):
        return {f.name: _file(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple):
        return [_file(item) for item in value]
    if isinstance(value, dict) and any(map(is_dataclass, value.values())):
        return {name: _file(item) for name, item in value.items()}
    return plain(value)
