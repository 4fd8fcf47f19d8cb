"""Motions that are known in closed form, environment by environment: what a run did, and what mechanics predicts."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.ball_drop import ball_laws
from gpusimbench.evaluator.runs.physics.canonical.blocks import block_laws
from gpusimbench.evaluator.runs.physics.canonical.dice import dice_laws
from gpusimbench.evaluator.runs.physics.canonical.four_bar import four_bar_laws
from gpusimbench.evaluator.runs.physics.canonical.free_body import free_body_laws
from gpusimbench.evaluator.runs.physics.canonical.pendulum import double_pendulum_laws, pendulum_laws
from gpusimbench.evaluator.runs.physics.facts import LawCounts, LawValues
from gpusimbench.schemas.errors import damage_in
from gpusimbench.schemas.provenance import REAL

_LAWS: dict[str, Callable[[Recording], tuple[LawValues | LawCounts, ...] | Missing]] = {
    "pendulum": pendulum_laws,
    "sliding-block": block_laws,
    "free-body": free_body_laws,
    "ball-drop": ball_laws,
    "double-pendulum": double_pendulum_laws,
    "dice-drop": dice_laws,
    "four-bar": four_bar_laws,
}
"""By scene: its laws, or why none can be measured."""

_KEPT = {"mass", "shift", "but"}  # of --vary: what does not change any law, and how it is drawn
_RATIOS = {"double-pendulum", "four-bar"}  # whose links have factors of their own, so that ratios of masses vary


def laws_of(recording: Recording) -> tuple[LawValues | LawCounts, ...] | Missing:
    """The laws of a canonical scene, or why none can be measured; empty for other scenes and for model files.

    Raises DamagedRecording where the file does not hold what it should.
    """
    c = recording.configuration
    if c.scene not in _LAWS or c.model or c.simulator == REAL:
        return ()
    if c.intervention:
        return Missing("environments were changed on the way")
    kept = _KEPT - {"mass"} if c.scene in _RATIOS else _KEPT
    if c.vary and {part.partition(":")[0] for part in c.vary.split(",")} - kept:
        return Missing(f"environments have other parameters than the scene (--vary {c.vary})")
    with damage_in(recording.path):
        return _LAWS[c.scene](recording)
