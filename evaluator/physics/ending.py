"""What lies where when the scene's outcome is read."""

from __future__ import annotations

import numpy as np

from evaluator.metrics.physics.solids import FixedBox
from evaluator.physics.depth import REST
from evaluator.physics.facts import Check, Fact, NotMeasured, measured
from evaluator.physics.setting import Setting
from evaluator.physics.states import States


def end_speed(setting: Setting, last: States) -> Fact:
    """The fastest cube above a floor at the last row, once the scene's sample time is over."""
    time = float(last.step[-1]) * setting.dt
    if time < setting.sample_time * (1.0 - 1e-9):
        return NotMeasured(Check.END_SPEED, f"the states end at {time:g} s, before {setting.sample_time:g} s")
    if last.linear is None:
        return NotMeasured(Check.END_SPEED, "velocities were not recorded")
    cubes = [i for i, body in enumerate(setting.world.moving) if body.half]
    if not cubes:
        return NotMeasured(Check.END_SPEED, "there are no cubes")
    place = last.position[-1][:, cubes]
    on_floor = np.zeros(place.shape[:2], dtype=bool)
    for floor in setting.world.fixed:
        if floor.level:
            above = place[..., 2] >= floor.top
            if isinstance(floor.solid, FixedBox):
                above &= (np.abs(floor.solid.local(place)[..., :2]) <= floor.solid.half[:2]).all(axis=-1)
            on_floor |= above
    if not on_floor.any():
        return NotMeasured(Check.END_SPEED, "no cube is above a floor at the end")
    speed = np.where(on_floor, np.linalg.norm(last.linear[-1][:, cubes], axis=-1), 0.0).max(axis=1)
    return measured(
        Check.END_SPEED, speed[on_floor.any(axis=1)], low=None, high=0.0, tolerance=REST, of="1 cm/s",
        note=f"{np.count_nonzero(on_floor)} of {on_floor.size} cubes are above a floor",
    )  # fmt: skip
