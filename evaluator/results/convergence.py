"""Groups that differ in the time step alone: how fast their states at the sample time approach those of the finest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey
from gpusimbench.evaluator.runs.labels import labels, options_given
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.convergence import FEWEST_STEPS, Order, fit_order

FEWEST_GROUPS = FEWEST_STEPS + 1
"""Steps of a family: the finest is what the others are compared with."""


@dataclass(frozen=True)
class Convergence:
    """Steps of one simulator, with one set of settings, on one device and scene, from the same initial states.

    label    without the step
    scene    its name
    time     simulated time at which states are compared [s]
    finest   the smallest step [s], which the others are compared with
    what     is compared: "joints" or "positions"
    unit     of the errors: rad, m
    found    the fitted order, or why there is none
    left_out steps that were not compared, each with the reason
    """

    label: str
    scene: str
    time: float
    finest: float
    what: str
    unit: str
    found: Order | Missing
    left_out: tuple[str, ...] = ()


def convergences(results: Sequence[GroupResult], times: dict[str, float]) -> tuple[Convergence, ...]:
    """Every family of at least FEWEST_GROUPS steps.

    times  simulated time at which positions of each scene are compared [s]
    """
    families: dict[GroupKey, dict[float, GroupResult]] = {}
    for result in results:
        if result.group.complete:
            families.setdefault(_family(result.group.key), {}).setdefault(result.group.key.dt, result)
    chosen = {key: by_dt for key, by_dt in families.items() if len(by_dt) >= FEWEST_GROUPS}
    runs = [run for by_dt in chosen.values() for result in by_dt.values() for run in result.group.recordings]
    named = labels(list(chosen), options_given(runs))
    return tuple(
        _converges(label, [by_dt[dt] for dt in sorted(by_dt)], times[key.scene])
        for label, (key, by_dt) in zip(named, chosen.items(), strict=True)
    )


def _family(key: GroupKey) -> GroupKey:
    # how many steps are warm-up and timed follows from the step where a scene has a window in seconds
    return replace(key, dt=0.0, warmup=0, timed_steps=0)


def _converges(label: str, by_dt: Sequence[GroupResult], time: float) -> Convergence:
    left_out, states = [], dict[float, NDArray[np.float64]]()
    what, unit = "positions", "m"
    for result in by_dt:
        dt, run = result.group.key.dt, result.group.complete[0]
        found = _state(run)
        if not math.isclose(sampling_step(time, dt) * dt, time, rel_tol=1e-9):
            left_out.append(f"{dt:g} s: {time:g} s is no whole number of steps")
        elif isinstance(found, Missing):
            left_out.append(f"{dt:g} s: {found.reason}")
        else:
            what, unit, states[dt] = found
    finest = min(states, default=min(result.group.key.dt for result in by_dt))
    scene = by_dt[0].group.key.scene
    order: Order | Missing = Missing(f"an order needs {FEWEST_GROUPS} steps that can be compared")
    if len(states) >= FEWEST_GROUPS:
        steps = [dt for dt in states if dt != finest]
        errors = [np.linalg.norm(states[dt] - states[finest], axis=1) for dt in steps]
        order = fit_order(steps, np.array(errors), finest=finest)
    return Convergence(label, scene, time, finest, what, unit, order, tuple(left_out))


def _state(run: Run) -> tuple[str, str, NDArray[np.float64]] | Missing:
    """What is compared, its unit, and the numbers of each environment, [env, number]; hinges before slides before
    positions."""
    if not isinstance(run.joints, Missing):
        for unit, joints in (("rad", run.joints.turning), ("m", run.joints.sliding)):
            if not isinstance(joints, Missing) and joints.space.coordinates.shape[1]:
                return "joints", unit, joints.space.coordinates
    if isinstance(run.positions, Missing):
        return run.positions
    local = run.positions.local
    return "positions", "m", local.reshape(len(local), -1)
