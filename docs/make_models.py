"""Redraws the tables of recordings/ant, humanoid and manipulator: how far engines are from MuJoCo C on one model file.

usage: python docs/make_models.py

Each folder holds runs of one model file under the same controls, one run an engine, device, friction cone and precision
of matrix products. A cell is the largest distance of a body with a free joint from where MuJoCo C has it with the same
cone, over environments; of a model without such bodies, the largest difference of a joint coordinate [rad, and m for
slides].
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from page_blocks import redraw

from gpusimbench import open_recording
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.numbers import length

ROOT = Path(__file__).resolve().parent.parent
TIMES: dict[str, tuple[float, ...]] = {
    "ant": (0.1, 0.2, 0.3, 0.6, 2.0),
    "humanoid": (0.03, 0.12, 0.21, 0.3, 0.6),
    "manipulator": (0.025, 0.1, 0.2, 0.3, 0.5),
}
"""By folder, the times of the columns [s]; each is a recorded one."""

NAMES = {
    "mujoco": "MuJoCo C",
    "warp": "MuJoCo Warp",
    "newton": "Newton (MuJoCo)",
    "mjx": "MJX",
    "genesis": "Genesis",
    "physx": "PhysX",
}
"""Simulators in the order of rows."""


def page(folder: str) -> Path:
    """The document that has the table of a folder."""
    return ROOT / "recordings" / folder / "README.md"


def runs(folder: str) -> list[Recording]:
    """The recordings of a folder in the order of rows, MuJoCo C first, those with a cone of their own last."""
    opened = [open_recording(path) for path in sorted(page(folder).parent.glob("*.mcap"))]
    order = list(NAMES)
    return sorted(
        opened, key=lambda run: (cone(run), order.index(run.configuration.simulator), device(run), precision(run))
    )


def cone(run: Recording) -> str:
    """The friction cone that was asked for instead of the model's own; empty where none was."""
    return str(run.configuration.options.get("cone", ""))


def precision(run: Recording) -> str:
    """The precision of JAX's matrix products that was asked for instead of the default; empty where none was."""
    switch = run.simulation.switches.get("matmul_precision", "default") if run.simulation else "default"
    return "" if switch == "default" else f"matmul_precision={switch}"


def device(run: Recording) -> str:
    """What the engine stepped on: CPU, or a GPU's model; empty where it refused the model."""
    if run.simulation is None:
        return ""
    return "CPU" if run.simulation.device == "cpu" else run.simulation.device.split()[1]


def off(run: Recording, reference: Recording) -> tuple[NDArray[np.float64], bool]:
    """The largest difference at each recorded step, and whether it is a distance of bodies [m].

    AssertionError where the runs have other items, steps or controls.
    """
    assert run.simulation is not None and reference.simulation is not None
    asked, other = run.configuration, reference.configuration
    assert (asked.model, asked.actions, asked.stride, asked.n_env) == (
        other.model, other.actions, other.stride, other.n_env,
    )  # fmt: skip
    items = {field.name: field.items for field in reference.simulation.fields}
    assert items == {field.name: field.items for field in run.simulation.fields}
    bodies = "bodies/position" in items
    arrays = []
    for one in (run, reference):
        assert one.simulation is not None
        array = np.asarray(one.state(*(("bodies", "position") if bodies else ("joints", "qpos")))[:], dtype=np.float64)
        if bodies and one.simulation.env_origins:
            array = array - np.array(one.simulation.env_origins)[:, np.newaxis]
        arrays.append(array)
    apart = np.linalg.norm(arrays[0] - arrays[1], axis=-1) if bodies else np.abs(arrays[0] - arrays[1])[..., 0]
    largest: NDArray[np.float64] = apart.max(axis=(1, 2))
    return largest, bodies


def table(folder: str) -> str:
    """A row for each engine and device of a folder but MuJoCo C."""
    found = runs(folder)
    references = {cone(run): run for run in found if run.configuration.simulator == "mujoco"}
    others = [run for run in found if run.configuration.simulator != "mujoco"]
    times = TIMES[folder]
    lines = [_row(["engine", "device", *(f"{time:g} s" for time in times)]), "| " + "--- | " * (2 + len(times))]
    for run in others:
        if run.cause == "refused":
            lines.append(
                _row([NAMES[run.configuration.simulator], "", f"refused: {run.reason}", *[""] * (len(times) - 1)])
            )
            continue
        largest, bodies = off(run, references[cone(run)])
        asked = run.configuration
        rows = [round(time / asked.dt / asked.stride) for time in times]
        assert np.allclose(np.array(rows) * asked.dt * asked.stride, times)
        cells = [length(largest[row]) if bodies else f"{largest[row]:.2g}" for row in rows]
        name = ", ".join(filter(None, (NAMES[asked.simulator], cone(run) and f"{cone(run)} cones", precision(run))))
        lines.append(_row([name, device(run), *cells]))
    return "\n".join(line.rstrip() for line in lines)


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Write the tables into the documents."""
    for folder in TIMES:
        redraw(page(folder), {"engines": table(folder)})


if __name__ == "__main__":
    main()
