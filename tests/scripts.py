"""Scripts that lie beside the documents, and programs of the examples, as modules."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = ROOT / "docs"


@cache
def script(name: str) -> ModuleType:
    """docs/NAME.py, which is in no package; it finds what lies beside it, as when it is run."""
    if str(DOCUMENTS) not in sys.path:
        sys.path.append(str(DOCUMENTS))
    return _module(name, DOCUMENTS / f"{name}.py")


def drawn(page: Path, name: str) -> str:
    """What a script has drawn into a page, by the name of its markers."""
    return script("page_blocks").block(page.read_text(encoding="utf-8"), name)


@cache
def example(name: str) -> ModuleType:
    """examples/NAME/NAME.py."""
    return _module(name, ROOT / "examples" / name / f"{name}.py")


def _module(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look up the names of their fields' types
    spec.loader.exec_module(module)
    return module
