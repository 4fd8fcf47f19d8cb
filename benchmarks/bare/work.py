"""What the timed phase of a recording did, for a peer that is to do the same work."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.recorder.run.engine import apply_environment
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.fingerprint import fingerprint


@dataclass(frozen=True)
class Done:
    """What a peer did.

    env_steps_per_s  of its timed steps
    same_states      environments whose final state is that of the recording, bit for bit
    contacts         of the last step, mean over environments; None where the engine does not tell
    """

    env_steps_per_s: float
    same_states: int
    contacts: float | None

    def show(self) -> None:
        """Print for ``read``."""
        print(json.dumps(asdict(self)))

    @classmethod
    def read(cls, printed: str) -> Done:
        """What ``show`` printed last."""
        return cls(**json.loads(printed.splitlines()[-1]))


class Work:
    """The work of one recording of a registered scene.

    asked    its configuration
    scene    recorder.scenes.base.Scene
    adapter  the recorder's class for the engine
    options  of the engine, as the adapter parses them
    buffers  sizes of the engine's buffers by name
    """

    def __init__(self, path: Path) -> None:
        """Read; variables that the engine needs before it is imported are set."""
        recording = open_recording(path)
        assert recording.simulation is not None
        self.asked = recording.configuration
        self.scene = make_scene(self.asked.scene)
        self.adapter = find_simulator(self.asked.simulator).adapter()
        self.options = self.adapter.parsed(self.asked.simulator, self.scene, self.asked.options)
        apply_environment(self.adapter.environment(self.options, self.asked.determinism))
        self.buffers = {buffer.name: buffer.asked for buffer in recording.simulation.buffers}
        hashes = recording.fingerprints("timed")
        assert hashes is not None
        self._final = hashes.hashes[-1]

    def actions(self, first_step: int, n_step: int) -> NDArray[np.float32] | None:
        """Actions of the steps that follow state `first_step`, [step, env, action]; None where the scene has none."""
        if self.scene.actions is None:
            return None
        return self.scene.actions.draw(
            self.asked.seed, n_env=self.asked.n_env, first_step=first_step, n_step=n_step
        )  # fmt: skip

    def same_states(self, state: States) -> int:
        """Environments that are, bit for bit, where the timed phase of the recording ended."""
        return int((fingerprint(state) == self._final).sum())
