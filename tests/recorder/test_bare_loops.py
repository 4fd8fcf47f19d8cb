"""The timed phase of a recording ends where a loop of the engine's own calls ends, bit for bit (benchmarks/bare)."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.engine_best import BARE, WARMUP, bare, recorded
from gpusimbench.recorder.environments.store import find
from gpusimbench.recorder.simulators.registry import find_simulator

N_ENV = 2

SCENES = dict.fromkeys(BARE, "ball-drop") | dict.fromkeys(("warp", "genesis", "physx"), "franka")
"""Robots, and so actions, where they are quick to compile."""


@pytest.mark.slow
@pytest.mark.parametrize("simulator", BARE)
def test_the_bare_loop_does_the_work_of_the_recording(simulator: str, tmp_path: Path) -> None:
    """Reach the states of the recording's timed phase with its actions, in a process without the recorder's loop."""
    if find_simulator(simulator).missing() and find(simulator) is None:
        pytest.skip(f"{simulator} is not installed, and no environment is set up")
    # as many steps as the warm-up has: loops on JAX compile a program for each number of steps
    recording = recorded(simulator, SCENES[simulator], tmp_path, n_env=N_ENV, steps=WARMUP, options=[])
    done = bare(recording, tmp_path)
    assert done.same_states == N_ENV
    assert done.env_steps_per_s > 0
