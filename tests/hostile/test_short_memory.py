"""What a command says where memory is short, which stands for every allocation: real ones are not made to fail here."""

from __future__ import annotations

from pathlib import Path

import pytest

from gpusimbench.evaluator.cli import eval as evaluate
from tests.synthetic import grid, write_recording


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")], ids=["memory", "thread"])
def test_short_memory_is_said(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """End with one message, and leave the earlier result as it is."""

    def fails(*_: object, **__: object) -> None:
        raise error

    write_recording(tmp_path, grid(1), name="a.mcap")
    result = tmp_path / "r.json"
    result.write_text("earlier")
    monkeypatch.setattr("gpusimbench.evaluator.results.evaluate.evaluate", fails)
    assert evaluate.main([str(tmp_path / "a.mcap"), "--no-cache", "--json", str(result)]) == 1
    assert "not enough memory" in capsys.readouterr().err
    assert result.read_text() == "earlier"
