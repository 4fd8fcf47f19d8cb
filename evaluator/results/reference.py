"""What simulations are compared with: real trials, or another recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import Density
from gpusimbench.evaluator.metrics.tosses import LocalErrors, TossErrors
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.positions import NO_JOINTS, JointSample
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses, errors_of, local_errors_of, measured_tosses
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.text import plural


@dataclass(frozen=True)
class Reference:
    """The positions and joints that simulations are compared with.

    label      what they are
    path       of the recording
    run_id     of the recording
    measured   True for real trials, False for another simulation
    scene      that they belong to
    positions  [m], shape [trial, item, 2]; no item where it has joints alone
    density    on the shared grid
    tosses     measured motions of a thrown cube; None where it has none
    joints     at the sample step, or why there are none
    """

    label: str
    path: Place
    run_id: str
    measured: bool
    scene: str
    positions: NDArray[np.float64]
    density: Density | None = None
    tosses: MeasuredTosses | None = None
    joints: JointSample | Missing = NO_JOINTS


@dataclass(frozen=True)
class References:
    """The references of a set of recordings.

    said      where they came from, and why others cannot be used; or why there is none
    by_scene  the reference of each scene that has its own
    main      the reference that stands for all; None where there is none
    doubts    about their units, a sentence each
    """

    said: str
    by_scene: Mapping[str, Reference] = field(default_factory=dict)
    main: Reference | None = None
    doubts: tuple[str, ...] = ()

    def of(self, scene: str) -> Reference | Missing:
        """What a scene is compared with: its own reference, or the main one, which is of another scene."""
        return self.by_scene.get(scene) or self.main or Missing(self.said)


def references(given: Run | None, runs: Sequence[Run], scenes: Sequence[str]) -> References:
    """The reference that was given, for every scene; without one, of each scene the only real trials among the runs.

    scenes  that are evaluated: the main reference is that of the first which has its own
    """
    candidates = [run for run in runs if run.configuration.simulator == REAL] if given is None else [given]
    found: dict[str, Reference] = {}
    doubts, reasons, said = [], [], []
    for scene, trials in gathered((run.configuration.scene, run) for run in candidates).items():
        if len(trials) > 1:
            reasons.append(f"{len(trials)} recordings of real trials of {scene} are here: choose one with --reference")
            continue
        made = _reference(trials[0])
        if isinstance(made, Missing):
            reasons.append(f"the reference {trials[0].path.name} {made.reason}")
            continue
        found[scene] = made
        said.append(f"{made.label if given is not None else 'the real trials'} in {made.path.name}")
        if trials[0].doubt:
            doubts.append(f"the reference {made.path.name}: {trials[0].doubt.text}")
    if not found:
        return References("; ".join(reasons) or "no reference: give real trials or another recording with --reference")
    main = next((found[scene] for scene in scenes if scene in found), next(iter(found.values())))
    return References("; ".join([f"compared with {' and '.join(said)}", *reasons]), found, main, tuple(doubts))


def _reference(run: Run) -> Reference | Missing:
    if run.status != "complete":
        return Missing(f"is {run.status}: {run.reason}")
    if run.dropouts:
        return Missing(f"lost data: {run.dropouts[0]}")
    c = run.configuration
    measured = c.simulator == REAL
    try:
        tosses = measured_tosses(Recording(run.path)) if measured else None
    except DamagedRecording as error:
        return Missing(f"cannot be used: {error}")
    if not isinstance(run.positions, Missing):
        planar = run.positions.planar
    elif tosses:  # each has an end of its own, whatever the sample time is
        planar = tosses.motion.position[-1][:, np.newaxis, :2]
    elif not isinstance(run.joints, Missing) and run.joints.any:
        planar = np.zeros((c.n_env, 0, 2))
    else:
        return Missing(f"cannot be used: {run.positions.reason}")
    if run.doubt and run.doubt.wrong:
        return Missing(f"cannot be used: {run.doubt.text}: record it again with --unit")
    label = tosses.name() if tosses else plural(len(planar), "real trial") if measured else ""
    label = label or f"{c.simulator} with {plural(c.n_env, 'env')}, dt {c.dt:g} s"
    return Reference(
        label, run.path, run.provenance.run_id, measured, c.scene, planar, tosses=tosses, joints=run.joints
    )


def toss_errors(
    runs: Sequence[Run], reference: Reference | Missing
) -> tuple[list[TossErrors | Missing], list[LocalErrors | Missing]]:
    """Errors of each run against measured tosses, over all of them and locally; states are read again."""
    if isinstance(reference, Missing) or reference.tosses is None:
        none = Missing(reference.reason if isinstance(reference, Missing) else "the reference has no tosses")
        return [none] * len(runs), [none] * len(runs)
    if any(run.configuration.scene != reference.scene for run in runs):
        none = Missing(f"the reference is of scene {reference.scene}")
        return [none] * len(runs), [none] * len(runs)
    errors: list[TossErrors | Missing] = []
    local: list[LocalErrors | Missing] = []
    for run in runs:
        recording = Recording(run.path)
        errors.append(errors_of(recording, reference.tosses))
        local.append(local_errors_of(recording, reference.tosses))
    return errors, local
