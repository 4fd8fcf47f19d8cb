"""Which model files run on which engine, and how far from MuJoCo C they are after some steps.

usage: python -m benchmarks.model_engines [--models NAME,NAME] [--engines NAME,NAME] [--steps 20] [--integrator Euler]
           [FILE.xml ...]

Without files, the models of the installed Gymnasium; files are named by their folder, too.

Each engine runs in a process of its own, of the Python that gsb-record would take for it, on the CPU, with two
environments and random controls, the same for all engines. A cell is the largest difference of a position, orientation
or joint coordinate from MuJoCo C after the steps [m, rad], what of the model the engine has otherwise, or why it was
refused. Where an engine does not know the file's
constraint solver (PGS), it is asked for Newton instead, which is marked with *. --integrator replaces the file's on
MuJoCo C alone, for engines that have no other. Prints a Markdown table, which docs/model-files.md has.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import parser
from gpusimbench.recorder.environments.choice import interpreter_for
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.model import ModelScene, model_scene
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.model_files import pack

ENGINES: dict[str, tuple[str, dict[str, str], dict[str, str]]] = {
    "warp": ("warp", {}, {"solver": "Newton"}),
    "mjx": ("mjx", {}, {"solver": "Newton"}),
    "newton": ("newton", {}, {"solver": "Newton"}),
    "newton-xpbd": ("newton", {"solver": "xpbd"}, {}),
    "newton-featherstone": ("newton", {"solver": "featherstone"}, {}),
    "physx": ("physx", {"device": "cpu"}, {}),
    "physx-pgs": ("physx", {"device": "cpu", "solver": "PGS"}, {}),
    "isaaclab": ("isaaclab", {"device": "cpu"}, {}),
    "isaaclab-newton": ("isaaclab", {"device": "cpu", "backend": "newton"}, {}),
    "genesis": ("genesis", {"device": "cpu"}, {}),
    "genesis-64": ("genesis", {"device": "cpu", "precision": "64"}, {}),
}
"""By name of a column, the simulator, its options, and those that replace a constraint solver that it does not know."""

N_ENV = 2
_COMPARED = ("position", "orientation", "qpos")
_EXPECTED = (
    "option", "geoms.solref", "contact.friction_combination", "contact.friction", "option.disableflags",
    "option.tolerance",
)  # fmt: skip
"""Deviations that every model has on an engine, or none that moves."""


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, steps=20)
    p.add_argument("--models", default="")
    p.add_argument("--engines", default=",".join(ENGINES))
    p.add_argument("--integrator", default="")
    p.add_argument("--one", help=argparse.SUPPRESS)
    p.add_argument("files", nargs="*", type=Path, metavar="FILE.xml")
    asked = p.parse_args()
    if asked.one:
        for path in asked.files:
            print(json.dumps([str(path), _cell(path, asked.one, asked.steps, asked.integrator)]), flush=True)
        return
    given = [path.resolve() for path in asked.files] or _models()
    models = [path for path in given if not asked.models or path.stem in asked.models.split(",")]
    columns = {}
    for engine in asked.engines.split(","):
        words = ["--one", engine, "--steps", str(asked.steps), "--integrator", asked.integrator, *map(str, models)]
        chosen = interpreter_for(find_simulator(ENGINES[engine][0]))
        with tempfile.TemporaryDirectory() as folder:
            environment = chosen.environment(Path(folder))
            environment["PYTHONPATH"] = os.pathsep.join([environment["PYTHONPATH"], str(Path(__file__).parents[1])])
            again = chosen.command("-m", "benchmarks.model_engines", *words)
            said = subprocess.run(again, capture_output=True, text=True, check=False, env=environment).stdout
        columns[engine] = dict(json.loads(line) for line in said.splitlines() if line.startswith('["'))
    print("| model | " + " | ".join(columns) + " |")
    print("| --- |" + " --- |" * len(columns))
    for path in models:
        cells = [column.get(str(path), "the engine's process ended") for column in columns.values()]
        name = f"{path.parent.name}/{path.stem}" if asked.files else path.stem
        print(f"| {name} | " + " | ".join(cells) + " |")


def _models() -> list[Path]:
    found = find_spec("gymnasium")
    if found is None:
        raise SystemExit("gymnasium is not installed: pip install gymnasium")
    return sorted((Path(str(found.origin)).parent / "envs" / "mujoco" / "assets").glob("*.xml"))


def _cell(path: Path, engine: str, steps: int, integrator: str) -> str:
    simulator, options, instead = ENGINES[engine]
    scene = model_scene(path.stem, pack(path))
    wanted, _ = _run("mujoco", scene, {"integrator": integrator} if integrator else {}, steps)
    marks = ("", "*") if instead and scene.solver["solver"] == "PGS" else ("",)
    for mark in marks:
        try:
            found, lost = _run(simulator, scene, {**options, **(instead if mark else {})}, steps)
        except (Refused, UsageError) as error:
            reason = f"refused: {str(error).partition('; --option')[0]}"
            continue
        off = max(float(np.abs(a - b).max()) for a, b in zip(found, wanted, strict=True))
        return (
            f"{off:.0e}{mark}" + (f"; {', '.join(lost)}" if lost else "") if np.isfinite(off) else f"not finite{mark}"
        )
    return reason.replace("|", "/")


def _run(
    simulator: str, scene: ModelScene, options: Mapping[str, str], steps: int
) -> tuple[list[np.ndarray[Any, Any]], list[str]]:
    """Positions after the steps, and what of the model is otherwise."""
    adapter = find_simulator(simulator).load()
    parsed = adapter.parsed(simulator, scene, options)
    if refusal := adapter.refusal(simulator, scene, parsed):
        raise UsageError(refusal)
    made = adapter(scene, n_env=N_ENV, dt=scene.dt, seed=0, options=parsed)
    try:
        description = made.build()
        if scene.actions is not None and not made.draws_actions:
            made.prepare(scene.actions.draw(0, n_env=N_ENV, first_step=0, n_step=steps))
        made.step(steps)
        states = made.state()
    finally:
        made.close()
    origins = np.array(description.env_origins or np.zeros((N_ENV, 3)))[:, np.newaxis]
    chosen = [
        a - origins if f.field == "position" else a
        for f, a in zip(description.fields, states, strict=True) if f.field in _COMPARED
    ]  # fmt: skip
    return chosen, [d.parameter for d in description.deviations if d.parameter not in _EXPECTED]


if __name__ == "__main__":
    main()
