"""Variability in joint space: the counterpart of W1 for robots, whose joints no published distance compares.

Angles [rad] and travel [cm] have metrics of their own and never are in one number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.joints import (
    MAX_ENVS,
    JointSpace,
    distance_between_envs,
    distances_between_runs,
    joint_distance,
)
from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.details import JointsBetweenEnvs, JointsBetweenRuns
from gpusimbench.evaluator.results.group_runs import NO_RUN, GroupRuns, Runs, differ, ends_of, named
from gpusimbench.evaluator.results.metric import Axis, Direction, Estimate, Metric, Table, over_runs
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.runs.positions import Joints
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.jackknife import jackknife_pair_mean
from gpusimbench.schemas.text import plural

_UNITS: dict[str, tuple[Callable[[Run | Reference], Joints | Missing], float]] = {
    "rad": (lambda run: run.joints if isinstance(run.joints, Missing) else run.joints.turning, 1.0),
    "cm": (lambda run: run.joints if isinstance(run.joints, Missing) else run.joints.sliding, CM_PER_M),
}
"""By the unit of a metric: its joints of a run, or of a reference, and how many of the unit are one of theirs."""


def joint_spaces(runs: Runs, unit: str) -> list[JointSpace] | Missing:
    """The joints of all runs at the sample step, or why they cannot be compared.

    unit  of the metric: "rad" for hinges and ball joints, "cm" for slides
    """
    if not runs:
        return Missing(NO_RUN)
    of, _ = _UNITS[unit]
    found = [of(run) for run in runs]
    for run, one in zip(runs, found, strict=True):
        if isinstance(one, Missing):
            alike = all(isinstance(other, Missing) and other.reason == one.reason for other in found)
            return one if alike else Missing(f"{named([run])}: {one.reason}")
    joints = [one for one in found if isinstance(one, Joints)]
    if len({(one.names, len(one.space)) for one in joints}) > 1:
        return Missing("the runs have different joints or numbers of environments")
    return [one.space for one in joints]


def run_distances(spaces: list[JointSpace], unit: str) -> NDArray[np.float64]:
    """Distances between runs in the unit of the metric, shape [run, run]; see metrics.joints."""
    return distances_between_runs(spaces) * _UNITS[unit][1]


def _between_envs(unit: str, group: GroupRuns) -> list[float | Missing]:
    """A value of every run; a run that did not record the sample step has none."""
    runs = group.at_sample
    spaces = joint_spaces(runs, unit)
    if not isinstance(spaces, Missing) and runs[0].apart_by_design:
        spaces = Missing(runs[0].apart_by_design)
    if not isinstance(spaces, Missing) and len(spaces[0]) < 2:
        spaces = Missing("needs at least two environments")
    if isinstance(spaces, Missing):
        return [spaces] * len(group.runs)
    scale = _UNITS[unit][1]
    distinct = {_bits(space): space for space in spaces}  # identical runs are computed once
    means = {bits: distance_between_envs(space).mean * scale for bits, space in distinct.items()}
    found = {id(run): means[_bits(space)] for run, space in zip(runs, spaces, strict=True)}
    return [found.get(id(run), Missing("the sample step was not recorded")) for run in group.runs]


def _to_reference(unit: str, group: GroupRuns) -> list[float | Missing]:
    """Of every run: each environment is compared with the same environment of the reference."""
    of, scale = _UNITS[unit]
    reference = group.reference
    if isinstance(reference, Missing):
        return [reference] * len(group.runs)
    if reference.scene != group.scene:
        return [Missing(f"the reference is of scene {reference.scene}")] * len(group.runs)
    target = of(reference)
    return [_from_target(of(run), target, scale) for run in group.runs]


def _from_target(found: Joints | Missing, target: Joints | Missing, scale: float) -> float | Missing:
    if isinstance(found, Missing):
        return found
    if isinstance(target, Missing):
        return Missing(f"of the reference: {target.reason}")
    if len(found.space) != len(target.space):
        return Missing(f"the reference has {plural(len(target.space), 'env')}, this group {len(found.space)}")
    hinges = found.space.coordinates.shape[1]
    if sorted(found.names) != sorted(target.names) or target.space.coordinates.shape[1] != hinges:
        return Missing("the reference has other joints")
    places = [target.names.index(name) for name in found.names]
    balls = [place - hinges for place in places[hinges:]]
    ordered = JointSpace(target.space.coordinates[:, places[:hinges]], target.space.balls[:, balls])
    return float(joint_distance(found.space, ordered).mean()) * scale


def _bits(space: JointSpace) -> tuple[bytes, bytes]:
    return space.coordinates.tobytes(), space.balls.tobytes()


def _parallel(metric: Metric, group: GroupRuns) -> Estimate:
    estimate = over_runs(metric, group)
    if isinstance(estimate.value, Missing) or group.runs[0].configuration.n_env <= MAX_ENVS:
        return estimate
    return replace(estimate, exactness="sampled", method=f"{estimate.method}; {MAX_ENVS} environments drawn by seed")


def _joints(unit: str, group: GroupRuns) -> JointsBetweenEnvs:
    spaces = joint_spaces(group.at_sample, unit)
    return JointsBetweenEnvs(joints=0 if isinstance(spaces, Missing) else spaces[0].joints)


def _run_to_run(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    runs = group.at_sample
    spaces = joint_spaces(runs, metric.unit)
    if isinstance(spaces, Missing):
        return spaces
    if len(runs) < 2:
        return Missing("needs at least two complete runs")
    matrix = run_distances(spaces, metric.unit)
    pairs = matrix[np.triu_indices(len(runs), k=1)]
    interval = jackknife_pair_mean(matrix)
    bounds = ends_of(interval, len(runs), spread=differ(pairs))
    offset = pairs - pairs[0]  # equal pairs have exactly that value
    return Estimate(
        metric,
        float(pairs[0] + offset.mean()),
        n=len(pairs),
        sd=float(offset.std(ddof=1)) if len(pairs) > 1 else None,
        ci95=bounds,
        method=f"{metric.method}, mean and SD over pairs of runs; interval: {interval.method}",
        details=JointsBetweenRuns(n_run=len(runs), joints=spaces[0].joints),
    )


def _of_joints(unit: str, name: str, what: str, joints: str) -> tuple[Metric, Metric, Metric]:
    of = f"root mean square over {joints}"
    return (
        Metric(
            f"joint_{name}_parallel", f"{what} between envs", unit, Direction.LOWER,
            f"the counterpart of `w1_parallel` in [joint space](#joint-space): {of} of the difference between two "
            "environments. Mean over all pairs of environments of a run, then over runs",
            method=f"{of} of the difference between two environments, mean over pairs", table=Table.VARIABILITY,
            values=partial(_between_envs, unit), details=partial(_joints, unit), of_group=_parallel,
            interval="delete-one-run jackknife", optional=True, axis=Axis.VARIABILITY,
        ),
        Metric(
            f"joint_{name}_run_to_run", f"{what} between runs", unit, Direction.LOWER,
            f"the counterpart of `w1_run_to_run` in [joint space](#joint-space): {of} of the difference between the "
            "same environment of two runs, mean over environments. Mean and SD over all pairs of runs",
            method=f"{of} of the difference between the same environment of two runs, mean over environments",
            table=Table.VARIABILITY, of_group=_run_to_run,
            interval="delete-one-run jackknife of a mean over pairs", optional=True, axis=Axis.VARIABILITY,
        ),
        Metric(
            f"joint_{name}_real", f"{what} to the reference", unit, Direction.LOWER,
            f"the counterpart of `w1_real` in [joint space](#joint-space): {of} of the difference between an "
            "environment and the same environment of the reference, mean over environments. Mean over runs",
            method=f"{of} of the difference to the same environment of the reference, mean over environments",
            table=Table.VARIABILITY, values=partial(_to_reference, unit), details=partial(_joints, unit),
            interval="delete-one-run jackknife", optional=True,
        ),
    )  # fmt: skip


JOINT_METRICS = (
    *_of_joints("rad", "angle", "joint angles", "hinges and ball joints"),
    *_of_joints("cm", "slide", "sliding joints", "sliding joints"),
)
"""Of joints that turn, and of joints that slide: between environments, between runs, to the reference."""

BETWEEN_ENVS, BETWEEN_RUNS, TO_REFERENCE = JOINT_METRICS[::3], JOINT_METRICS[1::3], JOINT_METRICS[2::3]
