"""A simulator of a third party that goes wrong as it is told."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.conftest import distribution

_PLUGIN = '''
"""A third party's simulator that goes wrong as it is told."""
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from gpusimbench.recorder.simulators.base import Ability, Description, Simulator
from gpusimbench.schemas.fields import body_field

HERE = Path(__file__).parent

def said(word):
    (HERE / f"{word}-{os.getpid()}").touch()

@dataclass(frozen=True)
class Options:
    mode: str = "good"
    at: int = 5

class Faulty(Simulator):
    Options = Options
    abilities = frozenset(Ability)
    made = 0

    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        if Faulty.made and self.options.mode == "second":
            raise RuntimeError("no second one")
        self.number = Faulty.made
        Faulty.made += 1

    def build(self):
        print("printed while building", flush=True)
        if self.number and self.options.mode == "second-build":
            raise RuntimeError("no second build")
        if self.options.mode == "build":
            raise RuntimeError("no device\\nof that name")
        self.k = self.queued = 0
        field = body_field("cubes", "position", "float32", ("a", "b"))
        return Description("1.0", "cpu", {}, {}, (), (field,), timing_covers="nothing")

    def step(self, n_step):
        for _ in range(n_step):
            self.k += 1
            if self.k >= self.options.at:
                if self.options.mode == "raise":
                    raise ValueError("the solver gave up")
                if self.options.mode == "memory":
                    raise MemoryError
                if self.options.mode == "segfault":
                    os.kill(os.getpid(), signal.SIGSEGV)
                if self.options.mode == "exit":
                    os._exit(7)
                if self.options.mode == "interrupt":
                    os.kill(os.getpid(), signal.SIGINT)
                if self.options.mode == "deaf":
                    try:
                        said("deaf")
                        time.sleep(600)
                    except KeyboardInterrupt:  # an engine that returns ends with the block
                        said("heeded")
                        time.sleep(600)
                while self.options.mode == "held" and not (HERE / "let-go").exists():
                    time.sleep(0.01)
                if self.options.mode == "slow":
                    time.sleep(0.01)
        self.queued += n_step

    def state(self):
        if self.options.mode == "queue":  # the device works only when it is waited for
            time.sleep(0.3 * self.queued)
        self.queued = 0
        state = np.full((self.n_env, 2, 3), float(self.k), dtype=np.float32)
        if self.options.mode == "nan" and self.k >= self.options.at:
            state[0, 1, 2] = np.nan
        return (state,)

    def gates(self):
        return ["contacts were dropped"] if self.options.mode == "gate" else []

    def close(self):
        print(f"closed{self.number}")
'''


def folder_of(plugin: dict[str, str]) -> Path:
    """Where the simulator writes deaf-PID as soon as mode=deaf heeds nothing, and heeded-PID as it is interrupted then;
    and where a file let-go lets mode=held step on."""
    return Path(plugin["PYTHONPATH"].partition(os.pathsep)[0])


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "faulty"."""
    folder = tmp_path_factory.mktemp("plugin")
    return distribution(folder, "faulty-simulator", "[gsb.simulators]\nfaulty = faulty_simulator:Faulty\n", _PLUGIN)
