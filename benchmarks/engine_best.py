"""Timed phase of the recorder against a bare loop of the same engine and against the engine's own speed tool, in turn.

usage: python -m benchmarks.engine_best --sim warp|mjx|genesis|newton|physx|isaaclab|brax [--scene free-fall]
           [--n-env 1024] [--steps 500] [--rounds 3] [--option NAME=VALUE ...]

The bare loop (benchmarks.bare) does the recording's own work: its model, buffer sizes, initial state, warm-up, steps
and actions. How equal the work was is printed: environments that end in the same state, bit for bit, and contacts of
the last step.

The speed tools (mjwarp-testspeed, mjx-testspeed) do other work: the recording's model (scene.xml) with the same number
of environments and steps, but from states of their own, without a warm-up and without the scene's actions. Their ratio
is no claim. mjwarp-testspeed needs a GPU; where a tool cannot run, the line says so.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.arguments import parser
from benchmarks.bare.work import Done
from benchmarks.machine import machine, spread
from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.throughput import frames_per_second
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.environments.choice import interpreter_for
from gpusimbench.recorder.simulators.registry import find_simulator

ROOT = Path(__file__).resolve().parent.parent

WARMUP = 100

BARE = ("warp", "mjx", "genesis", "newton", "physx", "isaaclab", "brax")
"""Simulators that benchmarks.bare has a loop of."""


def recorded(sim: str, scene: str, folder: Path, n_env: int, steps: int, options: list[str]) -> Recording:
    """A recording of the timed phase alone."""
    done = subprocess.run(
        [sys.executable, "-m", "gpusimbench.recorder.cli",
         "--sim", sim, "--scene", scene, "--n-env", str(n_env), "--runs", "1",
         "--warmup", str(WARMUP), "--timed-steps", str(steps), "--phases", "timed", "--out", str(folder),
         *(word for option in options for word in ("--option", option))],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    if done.returncode:
        sys.exit("the run did not complete")
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


def bare(recording: Recording, folder: Path) -> Done:
    """A loop that does nothing but step, in a process of its own, by the Python that made the recording."""
    python = interpreter_for(find_simulator(recording.configuration.simulator))
    variables = python.environment(folder)
    variables["PYTHONPATH"] = os.pathsep.join([variables["PYTHONPATH"], str(ROOT)])
    command = python.command("-m", "benchmarks.bare", str(recording.path))
    done = subprocess.run(command, env=variables, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit("the bare loop did not complete")
    return Done.read(done.stdout)


def tool(sim: str, folder: Path, recording: Recording, steps: int) -> float | None:
    """Env-steps/s that the engine's own speed tool prints; None where there is none, or it does not run here."""
    if sim not in ("warp", "mjx"):
        return None
    model = model_of(recording, folder)
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
    p.add_argument("--sim", choices=BARE, required=True)
    p.add_argument("--scene", default="free-fall")
    p.add_argument("--option", action="append", default=[])
    a = p.parse_args()
    ours: list[float] = []
    loops: list[Done] = []
    contacts: list[float] = []
    tools: list[float] = []
    device = ""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for _ in range(a.rounds):
            recording = recorded(a.sim, a.scene, folder, a.n_env, a.steps, a.option)
            assert recording.simulation is not None
            device = recording.simulation.device
            ours.append(frames_per_second(a.n_env, a.steps, recording.timing["timed"].window_s))
            loops.append(bare(recording, folder))
            if counted := recording.counts.get("timed", {}).get("contacts"):
                contacts.append(float(counted.mean[-1]))
            found = tool(a.sim, folder, recording, a.steps)
            tools += [] if found is None else [found]
            print(
                f"round {len(ours)}: recorder {ours[-1]:.0f}, bare loop {loops[-1].env_steps_per_s:.0f}",
                file=sys.stderr,
            )
    print(f"machine                        {machine()}, device {device}")
    engine = " ".join([a.sim, *a.option])
    print(f"rounds                         {a.rounds}, {engine}, {a.scene}, {a.n_env} envs, {a.steps} steps")
    print(f"recorder, timed [env-steps/s]  {spread(ours, 0)}")
    bare_loops = [loop.env_steps_per_s for loop in loops]
    print(f"bare loop, same work           {spread(bare_loops, 0)}")
    ratios = [x / y for x, y in zip(ours, bare_loops, strict=True)]
    print(f"ratio recorder / bare          {spread(ratios)}   claim: at least 0.98")
    print(f"same final states, of {a.n_env:5}    {spread([float(loop.same_states) for loop in loops], 0)}")
    again = [loop.contacts for loop in loops if loop.contacts is not None]
    if contacts and again:
        print(f"contacts an env, recorder      {spread(contacts, 2)}")
        print(f"contacts an env, bare loop     {spread(again, 2)}")
    if len(tools) == len(ours):
        print(f"the engine's speed tool        {spread(tools, 0)}")
        ratios = [x / y for x, y in zip(ours, tools, strict=True)]
        print(f"ratio recorder / tool          {spread(ratios)}   other states, no actions: no claim")
    elif a.sim == "warp":
        print("the engine's speed tool        does not run here (mjwarp-testspeed needs a GPU)")


if __name__ == "__main__":
    main()
