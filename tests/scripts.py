"""Scripts that lie beside the documents, as modules."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

DOCUMENTS = Path(__file__).resolve().parents[1] / "docs"


@cache
def script(name: str) -> ModuleType:
    """docs/NAME.py, which is in no package."""
    spec = importlib.util.spec_from_file_location(name, DOCUMENTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look up the names of their fields' types
    spec.loader.exec_module(module)
    return module
