"""What lies where when the scene's outcome is read."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.solids import FixedBox
from gpusimbench.evaluator.metrics.physics.vectors import largest, length
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.depth import REST
from gpusimbench.evaluator.runs.physics.facts import Check, Facts, measured
from gpusimbench.evaluator.runs.physics.setting import Setting
from gpusimbench.evaluator.runs.physics.states import States

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def end_facts(setting: Setting, last: States) -> Facts:
    """The fastest motion and the fastest spin of cubes above a floor, once the scene's sample time is over."""
    checks = (Check.END_SPEED, Check.END_SPIN)
    time = float(last.step[-1]) * setting.dt
    if time < setting.sample_time * (1.0 - 1e-9):
        why = f"the states end at {time:g} s, before {setting.sample_time:g} s"
        return dict.fromkeys(checks, Missing(why))
    if last.linear is None or last.angular is None:
        return dict.fromkeys(checks, Missing("velocities were not recorded"))
    cubes = [i for i, body in enumerate(setting.world.moving) if body.half]
    on_floor = _above_a_floor(setting, last.position[-1][:, cubes])
    if not on_floor.any():
        return dict.fromkeys(checks, Missing("no cube is above a floor at the end"))
    judged = on_floor.any(axis=1)
    speed, spin = (np.where(on_floor, length(of[-1][:, cubes]), 0.0) for of in (last.linear, last.angular))
    note = f"{np.count_nonzero(on_floor)} of {on_floor.size} cubes are above a floor"
    slowest = REST / max(setting.world.moving[i].reach for i in cubes)
    spins = f"{np.count_nonzero(spin > slowest)} of them spin"
    return {
        Check.END_SPEED: measured(
            speed.max(axis=1)[judged], low=None, high=0.0, tolerance=REST, of="1 cm/s", note=note
        ),
        Check.END_SPIN: measured(
            spin.max(axis=1)[judged], low=None, high=0.0, tolerance=slowest, of="1 cm/s of a corner",
            note=spins,
        ),
    }  # fmt: skip


def _above_a_floor(setting: Setting, place: Array) -> Mask:
    # [env, cube]
    found = np.zeros(place.shape[:2], dtype=bool)
    for floor in setting.world.fixed:
        if floor.level:
            above = place[..., 2] >= floor.top
            if isinstance(floor.solid, FixedBox):
                above &= largest(np.abs(floor.solid.local(place)[..., :2]) - floor.solid.half[:2]) <= 0
            found |= above
    return found
