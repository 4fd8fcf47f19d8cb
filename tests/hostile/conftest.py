"""Good recordings, made once, to be spoiled."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.hostile.corpus import make_corpus


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Recordings of every kind; must not be written to."""
    return make_corpus(tmp_path_factory.mktemp("corpus"))
