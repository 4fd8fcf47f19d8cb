"""Good recordings, made once, to be spoiled."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import made_once
from tests.hostile.corpus import make_corpus


@pytest.fixture(scope="session")
def corpus() -> list[Path]:
    """Recordings of every kind, in the order in which they were made; must not be written to."""
    return sorted(made_once("corpus", make_corpus).iterdir(), key=lambda file: file.stat().st_mtime_ns)
