"""Timed phase of the recorder against a bare loop of the same engine and against the engine's own speed tool, in turn.

usage: python -m benchmarks.engine_best --sim warp|mjx [--scene free-fall] [--n-env 1024] [--steps 500] [--rounds 3]

The bare loop does the recording's own work: its model, buffer sizes, initial state, warm-up, steps and actions. How
equal the work was is printed: environments that end in the same state, bit for bit, and contacts of the last step.

The speed tools (mjwarp-testspeed, mjx-testspeed) do other work: the recording's model (scene.xml) with the same number
of environments and steps, but from states of their own, without a warm-up and without the scene's actions. Their ratio
is no claim. mjwarp-testspeed needs a GPU; where a tool cannot run, the line says so.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.arguments import parser
from benchmarks.machine import machine, spread
from benchmarks.work import Done
from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.throughput import frames_per_second
from gpusimbench.evaluator.read.recording import Recording

WARMUP = 100


def recorded(sim: str, scene: str, folder: Path, n_env: int, steps: int) -> Recording:
    """A recording of the timed phase alone."""
    done = subprocess.run(
        [sys.executable, "-m", "gpusimbench.recorder.cli",
         "--sim", sim, "--scene", scene, "--n-env", str(n_env), "--runs", "1",
         "--warmup", str(WARMUP), "--timed-steps", str(steps), "--phases", "timed", "--out", str(folder)],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return open_recording(Path(done.stdout.strip()))


def model_of(recording: Recording, folder: Path) -> Path:
    """The recording's MJCF, without the one flag that engines on accelerators do not know."""
    xml = recording.attachment("scene.xml")
    assert xml is not None
    path = folder / "scene.xml"
    path.write_text(re.sub(r"<flag autoreset=\"disable\" */>", "", xml.decode()))
    return path


def buffers_of(recording: Recording) -> dict[str, int]:
    """Buffer sizes by name."""
    assert recording.simulation is not None
    return {buffer.name: buffer.asked for buffer in recording.simulation.buffers}


def bare(sim: str, recording: Recording) -> Done:
    """A loop that does nothing but step, in a process of its own."""
    command = [sys.executable, "-m", f"benchmarks.bare_{sim}", str(recording.path)]
    return Done.read(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def tool(sim: str, model: Path, recording: Recording, steps: int) -> float | None:
    """Env-steps/s that the engine's own speed tool prints; None where it does not run here."""
    n_env, sizes = str(recording.configuration.n_env), buffers_of(recording)
    assert recording.simulation is not None
    options = recording.simulation.options
    if sim == "warp":
        command = ["mjwarp-testspeed", str(model), f"--nworld={n_env}", f"--nstep={steps}",
                   f"--nconmax={sizes['nconmax']}", f"--njmax={sizes['njmax']}"]  # fmt: skip
        module = "mujoco_warp.testspeed"
    else:
        command = ["mjx-testspeed", f"--mjcf={model.name}", f"--base_path={model.parent}", f"--batch_size={n_env}",
                   f"--nstep={steps}", "--solver=newton", f"--iterations={options['iterations']}",
                   f"--ls_iterations={options['ls_iterations']}"]  # fmt: skip
        module = "mujoco.mjx.testspeed"
    start = [command[0]] if shutil.which(command[0]) else [sys.executable, "-c", f"import {module} as t; t.main()"]
    done = subprocess.run([*start, *command[1:]], capture_output=True, text=True)
    found = re.search(r"Total steps per second:\s*([\d,.]+)", done.stdout)
    return float(found[1].replace(",", "")) if found else None


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, n_env=1024, steps=500, rounds=3)
    p.add_argument("--sim", choices=("warp", "mjx"), required=True)
    p.add_argument("--scene", default="free-fall")
    a = p.parse_args()
    ours: list[float] = []
    loops: list[Done] = []
    contacts: list[float] = []
    tools: list[float] = []
    device = ""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for _ in range(a.rounds):
            recording = recorded(a.sim, a.scene, folder, a.n_env, a.steps)
            assert recording.simulation is not None
            device = recording.simulation.device
            ours.append(frames_per_second(a.n_env, a.steps, recording.timing["timed"].window_s))
            model = model_of(recording, folder)
            loops.append(bare(a.sim, recording))
            contacts.append(float(recording.counts["timed"]["contacts"].mean[-1]))
            found = tool(a.sim, model, recording, a.steps)
            tools += [] if found is None else [found]
    print(f"machine                        {machine()}, device {device}")
    print(f"rounds                         {a.rounds}, {a.sim}, {a.scene}, {a.n_env} envs, {a.steps} steps")
    print(f"recorder, timed [env-steps/s]  {spread(ours, 0)}")
    rates = [loop.env_steps_per_s for loop in loops]
    print(f"bare loop, same work           {spread(rates, 0)}")
    ratios = [x / y for x, y in zip(ours, rates, strict=True)]
    print(f"ratio recorder / bare          {spread(ratios)}   claim: at least 0.98")
    print(f"same final states, of {a.n_env:5}    {spread([float(loop.same_states) for loop in loops], 0)}")
    print(f"contacts an env, recorder      {spread(contacts, 2)}")
    print(f"contacts an env, bare loop     {spread([loop.contacts for loop in loops], 2)}")
    if len(tools) == len(ours):
        print(f"the engine's speed tool        {spread(tools, 0)}")
        ratios = [x / y for x, y in zip(ours, tools, strict=True)]
        print(f"ratio recorder / tool          {spread(ratios)}   other states, no actions: no claim")
    else:
        print("the engine's speed tool        does not run here (mjwarp-testspeed needs a GPU)")


if __name__ == "__main__":
    main()
