"""Processes that end at moments of which another thread or process does not know yet."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

import pytest

from gpusimbench.recorder.process import launch
from gpusimbench.recorder.process.launch import Interruptions
from gpusimbench.schemas.writing import create
from tests.conftest import run_python

_ASKS_LATE = """
import os, signal, time
from gpusimbench.schemas.commands.parent import signalled_at_its_end

ask = signalled_at_its_end(signal.SIGKILL, os.getpid())
parent = os.getpid()
if not os.fork():
    while os.getppid() == parent:
        time.sleep(0.001)
    ask()
    print("it lives on", flush=True)
os._exit(0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel of Linux alone tells")
def test_a_parent_that_ended_before_its_child_asked() -> None:
    """Tell a process of the end of its parent also where that came between its start and its question."""
    assert run_python(_ASKS_LATE).stdout == ""


def test_a_run_that_ends_while_an_interruption_is_passed_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Signal the process that there was, where another thread stops following it at that moment."""
    interruptions = Interruptions()

    def made_late(path: Path) -> BinaryIO:
        interruptions.follow(None)
        return create(path)

    monkeypatch.setattr(launch, "create", made_late)
    with subprocess.Popen(["sleep", "300"]) as child:
        try:
            interruptions.follow(child, tmp_path / "mark")
            interruptions.add()
            assert child.wait(100) == -signal.SIGINT
        finally:
            child.kill()
    assert (tmp_path / "mark").exists()
