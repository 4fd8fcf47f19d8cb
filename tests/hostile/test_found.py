"""What fuzzing found once: files that made a reader fail, or two of them disagree."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap.reader import Container
from tests.hostile.corpus import make_synthetic
from tests.hostile.oracles import Parts, disagreement

_FOUND = sorted((Path(__file__).parent / "found").glob("*.mcap"))


@pytest.mark.parametrize("path", _FOUND, ids=lambda path: path.stem)
def test_what_was_found(path: Path) -> None:
    """Read it in four ways that agree, in little time and memory, and raise nothing of Python's own."""
    assert not disagreement(path)


def test_a_summary_that_contradicts_itself() -> None:
    """Refuse a file whose summary declares a channel ahead of its schema and again behind it, here and elsewhere."""
    path = Path(__file__).parent / "found" / "summary-channel-ahead-of-schema.mcap"
    said = "the topic /run/end is declared twice, not the same"
    with pytest.raises(DamagedRecording, match=said):
        Container(path)
    parts = Parts(path.read_bytes())
    with pytest.raises(DamagedRecording, match=said):
        Container(parts.place, parts)
    assert said in examine(path).of(Kind.summary)


def test_the_corpus_is_small() -> None:
    """Keep a megabyte of files at most."""
    assert 0 < sum(path.stat().st_size for path in _FOUND) < 1 << 20


def test_other_tests_hear_warnings() -> None:
    """Leave logging as it was."""
    disagreement(_FOUND[0])
    assert logging.getLogger().isEnabledFor(logging.WARNING)


def test_good_files_agree(tmp_path: Path) -> None:
    """Find nothing in recordings that are right."""
    assert not any(map(disagreement, make_synthetic(tmp_path)))


def test_a_disagreement_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Name what differs where one reader hands out other bytes than another, refuses more, or raises something else."""
    path = make_synthetic(tmp_path)[0]
    right = Container.attachment

    def other(container: Container, name: str) -> bytes | None:
        data = right(container, name)
        return data + b"x" if data and name == "pip-freeze.txt" or name == "scene.json" and data else data

    with monkeypatch.context() as patch:
        patch.setattr(Container, "attachment", lambda c, n: other(c, n) if c.source.near else right(c, n))
        assert disagreement(path)
    with monkeypatch.context() as patch:
        patch.setattr(Parts, "read", lambda parts, begin, end: memoryview(bytes(end - begin)))
        assert disagreement(path).startswith("sound: gsb-check finds nothing: here read; elsewhere")
    with monkeypatch.context() as patch:
        patch.setattr(Container, "attachment_names", lambda container: [][1])
        with pytest.raises(IndexError):
            disagreement(path)
