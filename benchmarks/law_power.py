"""Whether laws in closed form notice a change of the size that they claim to notice, and none where nothing changed.

An engine is given a scene whose friction or damping differs from what the recording declares, by exactly the change
that a recording without it claims to show. Every recording draws its own initial states, and is written and read as
any other. For each law, two claims are counted:

    two recordings  the one before and the one after the change differ (rank-sum test of measured minus predicted, 5 %)
    verdict         the law of the recording after the change is BROKEN

Without a change, 5 % of the pairs differ by the test's construction, and no law should be broken. A law that the engine
breaks without any change claims no size for its verdict.

    python -m benchmarks.law_power [--sim NAME] [--scene NAME] [--dt S,S...] [--repetitions N] [--out FILE]
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy import stats

from gpusimbench import RecordingWriter, Scene, Simulator, open_recording
from gpusimbench.evaluator.report.sections.canonical import size
from gpusimbench.evaluator.results.canonical import Law, laws
from gpusimbench.evaluator.runs.physics.facts import LawValues, PhysicsFacts
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.recorder.run import initial
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.treatment import Initial

N_ENV, SPREAD = 32, 0.8
BLOCK = 100
SCENES = ("pendulum", "sliding-block")


@dataclass(frozen=True)
class Setting:
    """What is recorded again and again: a scene on a simulator at a step [s], in a folder."""

    simulator: str
    scene: str
    dt: float
    folder: Path


@dataclass
class Counts:
    """Of one law and parameter: whether each claim came true, a repetition after the other, with and without a change.

    least, breaks  sizes that were claimed, of two recordings and of the verdict, in units of the parameter
    """

    law: Law
    parameter: str
    least: list[float] = field(default_factory=list)
    pairs: list[bool] = field(default_factory=list)
    pairs_unchanged: list[bool] = field(default_factory=list)
    breaks: list[float] = field(default_factory=list)
    broken: list[bool] = field(default_factory=list)
    broken_unchanged: list[bool] = field(default_factory=list)


def changed(scene: Scene, shares: Mapping[str, float], damping: float) -> Scene:
    """The scene with other friction of some lanes, by the share that is added to it, and with a damped joint.

    damping  of every joint [N m s/rad]
    """

    def of(lane: str) -> float:
        return 1.0 + shares.get(lane.removeprefix("plank-"), 0.0)

    bodies = tuple(
        replace(
            body,
            material=replace(
                body.material,
                static_friction=body.material.static_friction * of(body.name),
                kinetic_friction=body.material.kinetic_friction * of(body.name),
            ),
        )
        for body in scene.bodies
    )
    robot = scene.robot
    if robot is not None:
        links = tuple(
            replace(link, joint=replace(link.joint, friction=link.joint.friction + damping)) if link.joint else link
            for link in robot.links
        )
        robot = replace(robot, links=links)
    return replace(scene, bodies=bodies, robot=robot)


def made_of(setting: Setting, engines: Scene, seed: int) -> Simulator:
    """The simulator, not built yet, of the scene that the engine is given."""
    adapter = find_simulator(setting.simulator).load()
    options = adapter.parsed(setting.simulator, engines, {})
    return adapter(engines, n_env=N_ENV, dt=setting.dt, seed=seed, options=options)


def record(setting: Setting, engines: Scene, seed: int) -> tuple[LawValues, ...]:
    """Records a scene of which the engine is given another version, and measures the laws of the recording."""
    declared = make_scene(setting.scene)
    simulator = made_of(setting, engines, seed)
    path = setting.folder / f"{seed}.mcap"
    steps = round(declared.sample_time / setting.dt)
    try:
        made = simulator.build()
        start = initial.states(Initial(SPREAD), declared, made.fields, simulator.state(), seed)
        simulator.set_state(start)
        simulator.compile("capture")
        writer = RecordingWriter(
            path, simulator=setting.simulator, version=made.version, scene=declared, n_env=N_ENV, dt=setting.dt,
            steps=steps, fields=made.fields, device=made.device, seed=seed, deviations=made.deviations, view=(),
        )  # fmt: skip
        with writer as log:
            log.append(*start)
            for first in range(0, steps, BLOCK):
                log.append(*simulator.states(min(BLOCK, steps - first)))
        return laws_of(open_recording(path))
    finally:
        simulator.close()
        path.unlink(missing_ok=True)


def judged(values: tuple[LawValues, ...], scene: str) -> dict[str, Law]:
    """The laws of one recording, by key."""
    return {law.key: law for law in laws("", [PhysicsFacts(scene, N_ENV, ((0, N_ENV - 1),), {}, laws=values)])}


def differ(one: LawValues, other: LawValues) -> bool:
    """Whether a test of 5 % tells two recordings apart, by measured minus predicted of their environments."""
    off = [np.subtract(law.measured, law.predicted) for law in (one, other)]
    before, after = (values[np.isfinite(values)] for values in off)
    return bool(stats.mannwhitneyu(before, after).pvalue < 0.05)


def trials(setting: Setting, repetitions: int) -> dict[tuple[str, str], Counts]:
    """Counts by law and parameter; each repetition draws initial states of its own for each of its recordings."""
    found: dict[tuple[str, str], Counts] = {}
    scene = make_scene(setting.scene)
    seeds = iter(range(1, 1_000_000))
    for repetition in range(repetitions):
        sign = 1.0 if repetition % 2 else -1.0
        before = record(setting, scene, next(seeds))
        again = record(setting, scene, next(seeds))
        claimed: dict[str, dict[tuple[str, str], float]] = {"least": {}, "breaks": {}}
        by_key, again_by_key = ({law.key: law for law in of} for of in (before, again))
        for law in judged(before, setting.scene).values():
            for one in law.sensitivities:
                if one.least is not None:
                    counts = found.setdefault((law.key, one.parameter), Counts(law, one.parameter))
                    claimed["least"][law.key, one.parameter] = one.least
                    counts.least.append(one.least)
                    counts.pairs_unchanged.append(differ(by_key[law.key], again_by_key[law.key]))
                    counts.broken_unchanged.append(not law.held)
                    if one.breaks is not None:
                        claimed["breaks"][law.key, one.parameter] = one.breaks
                        counts.breaks.append(one.breaks)
        for keys in _recorded_together(found):
            for claim, by_law in claimed.items():
                sizes = {key: by_law[key] for key in keys if key in by_law}
                if not sizes:
                    continue
                engines = _with(scene, sizes, sign)
                after = record(setting, engines, next(seeds))
                after_by_key = {law.key: law for law in after}
                verdicts = judged(after, setting.scene)
                for key in sizes:
                    if claim == "least":
                        found[key].pairs.append(differ(by_key[key[0]], after_by_key[key[0]]))
                    else:
                        found[key].broken.append(key[0] in verdicts and not verdicts[key[0]].held)
    return found


def _recorded_together(found: Mapping[tuple[str, str], Counts]) -> Iterator[list[tuple[str, str]]]:
    """Laws that one recording can change together: those of different lanes, since a lane has one friction."""
    for kind in dict.fromkeys(key.rpartition("_")[2] for key, _ in found):
        yield [one for one in found if one[0].rpartition("_")[2] == kind]


def _with(scene: Scene, sizes: Mapping[tuple[str, str], float], sign: float) -> Scene:
    shares = {key.rpartition("_")[0]: sign * of for (key, parameter), of in sizes.items() if parameter == "friction"}
    damping = sum(of for (_, parameter), of in sizes.items() if parameter == "damping")  # never negative
    return changed(scene, shares, damping)


def share(outcomes: list[bool]) -> str:
    """How many of how many."""
    return f"{sum(outcomes)} of {len(outcomes)}" if outcomes else "-"


def table(setting: Setting, repetitions: int) -> list[str]:
    """A row of a Markdown table for each law and parameter."""
    rows = []
    for counts in trials(setting, repetitions).values():
        least, breaks = (
            size(float(np.median(sizes)), counts.parameter) if sizes else "-" for sizes in (counts.least, counts.breaks)
        )
        cells = (
            f"{1000 * setting.dt:g} ms", counts.law.title, counts.parameter, least, share(counts.pairs),
            share(counts.pairs_unchanged), breaks, share(counts.broken), share(counts.broken_unchanged),
        )  # fmt: skip
        rows.append(f"| {' | '.join(cells)} |")
    return rows


HEAD = (
    "| step | law | change of | two recordings: claimed size | seen | without a change | verdict: claimed size "
    "| broken | without a change |\n| ---: | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |"
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sim", default="mujoco")
    parser.add_argument("--scene", choices=SCENES, action="append")
    parser.add_argument("--dt", default="0.01,0.004", help="steps [s]")
    parser.add_argument("--repetitions", type=int, default=40)
    parser.add_argument("--out", type=Path, help="file for the table, which docs/make_laws.py puts into the page")
    given = parser.parse_args()
    lines = [HEAD]
    print(HEAD)
    with tempfile.TemporaryDirectory() as folder:
        for dt in map(float, given.dt.split(",")):
            for scene in given.scene or SCENES:
                rows = table(Setting(given.sim, scene, dt, Path(folder)), given.repetitions)
                print("\n".join(rows), flush=True)
                lines += rows
        version = made_of(Setting(given.sim, SCENES[0], 0.01, Path(folder)), make_scene(SCENES[0]), 0).build().version
    lines += ["", f"{given.sim} {version}, {N_ENV} environments, {given.repetitions} repetitions."]
    print("\n".join(lines[-2:]))
    if given.out:
        given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
