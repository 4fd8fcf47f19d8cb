"""Redraws the table of docs/determinism.md that says whether another device gives the same bits, from recordings.

usage: python docs/make_devices.py

Compared are the shipped runs of inclined-collision in 16 environments that begin alike and were not changed on the way,
wherever one simulator, of one version and with the same options, was recorded on two devices.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path

from page_blocks import redraw
from run_names import name_of_run

from gpusimbench import open_recording
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.result import Difference, DiffVerdict
from gpusimbench.evaluator.read.recording import Recording

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "determinism.md"
_SCENE, _N_ENV, _DT = "inclined-collision", 16, 0.01
Kind = tuple[str, str, str]
"""Simulator with the options that were given, its version, and its level of determinism."""


def comparable(recording: Recording) -> bool:
    """Whether a run is one of the scene as it is."""
    asked = recording.configuration
    changed = asked.intervention or asked.initial or asked.vary or asked.model or asked.seed
    same = (asked.scene, asked.n_env, asked.dt) == (_SCENE, _N_ENV, _DT)
    return same and not changed and recording.usable and "capture" in asked.phases


def kind(recording: Recording) -> Kind:
    """What has to be equal for two runs to be the same simulation."""
    simulation = recording.simulation
    assert simulation is not None
    name = name_of_run(recording.configuration.simulator, recording.configuration.options, simulation.options)
    return name, simulation.version, recording.configuration.determinism


def device(recording: Recording) -> str:
    """The model of what the simulator stepped on."""
    simulation = recording.simulation
    assert simulation is not None
    if simulation.device != "cpu":
        return simulation.device
    return str(recording.provenance.host["cpu"])


def gathered(files: Iterable[Path]) -> dict[Kind, dict[str, list[Recording]]]:
    """Runs by kind and device."""
    found: dict[Kind, dict[str, list[Recording]]] = defaultdict(lambda: defaultdict(list))
    for file in files:
        recording = open_recording(file)
        if recording.simulation is not None and comparable(recording):
            found[kind(recording)][device(recording)].append(recording)
    for runs in found.values():
        for of_device in runs.values():
            of_device.sort(key=lambda run: -run.configuration.steps)  # the longest stands for the others
    return {one: runs for one, runs in sorted(found.items()) if len(runs) > 1}


def said(found: Difference) -> str:
    """Over how many steps two runs have the same bits, or from which step on they differ."""
    if found.verdict is DiffVerdict.IDENTICAL:
        steps = found.compared.hash_steps or found.compared.state_steps
        return f"same bits, {steps.count if steps else 0} steps"
    assert found.first is not None
    return f"differ from step {found.first.step_a}"


def alike(runs: list[Recording]) -> str:
    """Whether the runs on one device repeat each other."""
    if len(runs) == 1:
        return "1 run"
    different = [one for one in (compare(runs[0], run) for run in runs[1:]) if one.verdict is not DiffVerdict.IDENTICAL]
    if not different:
        return f"{len(runs)} runs, same bits"
    step = min(one.first.step_a for one in different if one.first is not None)
    return f"{len(runs)} runs, differ from step {step}"


def table() -> str:
    """A row for each pair of devices of a kind."""
    lines = ["| simulator | determinism | first device | second device | first against second |", "| " + "--- | " * 5]
    for (name, version, level), runs in gathered(sorted((ROOT / "recordings").rglob("*.mcap"))).items():
        for first, other in combinations(runs.items(), 2):
            cells = [f"{one}: {alike(of)}" for one, of in (first, other)]
            against = said(compare(first[1][0], other[1][0]))
            lines.append(f"| {name} {version} | {level} | {' | '.join(cells)} | {against} |")
    return "\n".join(line.rstrip() for line in lines)


def main() -> None:
    """Write the table into the page."""
    redraw(PAGE, {"devices": table()})


if __name__ == "__main__":
    main()
