"""Whether laws in closed form notice a change of the size that they claim to notice, and none where nothing changed.

An engine is given a parameter (benchmarks.law_changes) that differs from what the recording declares, by exactly the
change that a recording without it claims to show. Every recording draws its own initial states, and is written and read
as any other. For each law, two claims are counted:

    two recordings  the one before and the one after the change differ (rank-sum test of measured minus predicted, 5 %)
    verdict         the law of the recording after the change is BROKEN

Without a change, 5 % of the pairs differ by the test's construction, and no law should be broken. A law that the engine
breaks without any change claims no size for its verdict.

    python -m benchmarks.law_power [--sim NAME] [--option NAME=VALUE] [--scene NAME] [--dt S,S...] [--repetitions N]
        [--parameter NAME] [--seed FIRST] [--out FILE]
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import stats

from benchmarks.arguments import end_table, of_counts
from benchmarks.law_changes import BUILT, POSITIVE, WHOLE, Change, change_model, changed_scene
from gpusimbench import RecordingWriter, Scene, Simulator, open_recording
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.sections.mechanics import size
from gpusimbench.evaluator.results.canonical import Law, laws
from gpusimbench.evaluator.runs.physics.facts import LawCounts, LawValues, PhysicsFacts
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.recorder.run import start
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.initial import Initial

M = TypeVar("M")

N_ENV = 32
BLOCK = 100
SPREAD = {
    "pendulum": 0.8,
    "sliding-block": 0.8,
    "free-body": 0.8,
    "ball-drop": 0.5,
    "double-pendulum": 0.8,
    "dice-drop": 0.8,
    "four-bar": 0.8,
}
"""Of --initial, by scene, as docs/physics.md records them."""


@dataclass(frozen=True)
class Setting:
    """What is recorded again and again: a scene on a simulator at a step [s], in a folder.

    options  of the simulator, as text
    seed     of the first recording; each has one of its own, upward from it
    n_env    environments of each recording
    only     parameter whose claims are counted; "": of all
    """

    simulator: str
    scene: str
    dt: float
    folder: Path
    options: Mapping[str, str] = field(default_factory=dict)
    seed: int = 1
    n_env: int = N_ENV
    only: str = ""


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


def made_of(setting: Setting, engines: Scene, seed: int, options: Mapping[str, str]) -> Simulator:
    """The simulator, not built yet, of the scene that the engine is given."""
    adapter = find_simulator(setting.simulator).load()
    options = adapter.parsed(setting.simulator, engines, {**setting.options, **options})
    return adapter(engines, n_env=setting.n_env, dt=setting.dt, seed=seed, options=options)


def record(setting: Setting, changes: Sequence[Change], seed: int, measure: Callable[[Recording], M]) -> M:
    """Records a scene of which the engine is given another version, and returns what is measured of the recording."""
    declared = make_scene(setting.scene)
    built = any(one.parameter in BUILT for one in changes)
    # a batch steps models of its own, mj_step the model that is changed; both give the same bits
    options = {"stepping": "mj_step"} if built else {}
    engines = changed_scene(declared, changes)
    simulator = made_of(setting, engines, seed, options)
    path = setting.folder / f"{seed}.mcap"
    steps = round(declared.sample_time / setting.dt)
    try:
        made = simulator.build()
        if built and isinstance(simulator, MujocoC):
            change_model(simulator._compiled.model, changes)
        # a loop begins closed with the lengths that the engine has
        begun = start.drawn_states(Initial(SPREAD[setting.scene]), engines, made.fields, simulator.state(), seed)
        simulator.set_state(begun)
        simulator.compile("capture")
        writer = RecordingWriter(
            path, simulator=setting.simulator, version=made.version, scene=declared, n_env=setting.n_env, dt=setting.dt,
            steps=steps, fields=made.fields, device=made.device, seed=seed, deviations=made.deviations, view=(),
        )  # fmt: skip
        with writer as log:
            log.append(*begun)
            for first in range(0, steps, BLOCK):
                log.append(*simulator.states(min(BLOCK, steps - first)))
        return measure(open_recording(path))
    finally:
        simulator.close()
        path.unlink(missing_ok=True)


def measured(setting: Setting, changes: Sequence[Change], seed: int) -> tuple[LawValues, ...]:
    """The laws of a recording whose engine is given another version of the scene; TypeError where there are none."""
    found = record(setting, changes, seed, laws_of)
    if isinstance(found, Missing):
        raise TypeError(found.reason)
    return tuple(one for one in found if isinstance(one, LawValues))


def judged(values: tuple[LawValues | LawCounts, ...] | Missing, scene: str) -> dict[str, Law]:
    """The laws of one recording, by key."""
    facts = PhysicsFacts(scene, N_ENV, ((0, N_ENV - 1),), {}, laws=values)
    return {law.key: law for law in laws("", [facts]) if isinstance(law, Law)}


def differ(one: LawValues, other: LawValues) -> bool:
    """Whether a test of 5 % tells two recordings apart, by measured minus predicted of their environments."""
    assert not isinstance(one.predicted, Missing) and not isinstance(other.predicted, Missing)
    off = [np.subtract(one.measured, one.predicted), np.subtract(other.measured, other.predicted)]
    before, after = (values[np.isfinite(values)] for values in off)
    return bool(stats.mannwhitneyu(before, after).pvalue < 0.05)


def trials(setting: Setting, repetitions: int) -> dict[tuple[str, str], Counts]:
    """Counts by law and parameter; each repetition draws initial states of its own for each of its recordings."""
    found: dict[tuple[str, str], Counts] = {}
    seeds = iter(range(setting.seed, setting.seed + 1_000_000))
    for repetition in range(repetitions):
        sign = 1.0 if repetition % 2 else -1.0
        before = measured(setting, (), next(seeds))
        again = measured(setting, (), next(seeds))
        claimed: dict[str, dict[tuple[str, str], float]] = {"least": {}, "breaks": {}}
        by_key, again_by_key = ({law.key: law for law in of} for of in (before, again))
        for law in judged(before, setting.scene).values():
            for one in law.sensitivities:
                if one.least is not None and setting.only in ("", one.parameter):
                    counts = found.setdefault((law.key, one.parameter), Counts(law, one.parameter))
                    claimed["least"][law.key, one.parameter] = one.least
                    counts.least.append(one.least)
                    counts.pairs_unchanged.append(differ(by_key[law.key], again_by_key[law.key]))
                    counts.broken_unchanged.append(not law.held)
                    if one.breaks is not None:
                        claimed["breaks"][law.key, one.parameter] = one.breaks
                        counts.breaks.append(one.breaks)
        for claim, sizes in claimed.items():
            for keys in recorded_together(sizes):
                changes = [change(key, sizes[key], sign) for key in keys]
                after = measured(setting, changes, next(seeds))
                after_by_key = {law.key: law for law in after}
                verdicts = judged(after, setting.scene)
                for key in keys:
                    if claim == "least":
                        found[key].pairs.append(differ(by_key[key[0]], after_by_key[key[0]]))
                    else:
                        found[key].broken.append(key[0] in verdicts and not verdicts[key[0]].held)
    return found


def recorded_together(keys: Iterable[tuple[str, str]]) -> list[list[tuple[str, str]]]:
    """Laws that one recording can change together: of one kind, of different bodies, and of parameters that each of
    them has."""
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for key, parameter in keys:
        kind = key if parameter in WHOLE else key.rpartition("_")[2]
        groups.setdefault((kind, parameter), []).append((key, parameter))
    return list(groups.values())


def change(law: tuple[str, str], size: float, sign: float) -> Change:
    """Of the parameter of a law, whose key begins with the body's name; upward only where it cannot be less."""
    key, parameter = law
    return Change(parameter, key.rpartition("_")[0], size if parameter in POSITIVE else sign * size)


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


def engine(setting: Setting) -> str:
    """The simulator with its version and options."""
    simulator = made_of(setting, make_scene(setting.scene), 0, {})
    try:
        version = simulator.build().version
    finally:
        simulator.close()
    return ", ".join(
        [f"{setting.simulator} {version}", *(f"{name}={value}" for name, value in setting.options.items())]
    )


def main() -> None:
    """Print the table."""
    parser = of_counts(__doc__)
    parser.add_argument("--sim", default="mujoco")
    parser.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="of the simulator")
    parser.add_argument("--scene", choices=SPREAD, action="append", help="default: pendulum and sliding-block")
    parser.add_argument("--dt", default="0.01,0.004", help="steps [s]")
    parser.add_argument("--parameter", default="", help="count its claims alone")
    given = parser.parse_args()
    options = dict(one.split("=", 1) for one in given.option)
    scenes = given.scene or ["pendulum", "sliding-block"]
    lines = [HEAD]
    print(HEAD)
    with tempfile.TemporaryDirectory() as folder:
        for dt in map(float, given.dt.split(",")):
            for scene in scenes:
                setting = Setting(given.sim, scene, dt, Path(folder), options, given.seed, only=given.parameter)
                rows = table(setting, given.repetitions)
                print("\n".join(rows), flush=True)
                lines += rows
        made = engine(Setting(given.sim, scenes[0], 0.01, Path(folder), options))
    end_table(lines, f"{made}, {N_ENV} environments, {given.repetitions} repetitions.", given.out)


if __name__ == "__main__":
    main()
