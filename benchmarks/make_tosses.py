"""Makes the synthetic set of tosses that stands in where the measured one is not: recorder/trials/synthetic_tosses.npz.

usage: python -m benchmarks.make_tosses [FILE]

MuJoCo throws the cube of scene cube-toss with known parameters and a step of 1/4736 s. What a camera adds to it is
known as well: lengths are 2 % short, positions and orientations are noisy, and velocities are means over the interval
before a row. Nobody measured these tosses. They are for trying the whole path, and for tests that need to know the
truth.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.cube_toss import EDGE, MASS, RATE
from gpusimbench.recorder.trials.tosses import SYNTHETIC

TOSSES = 48
SUBSTEPS = 32
SEED = 570
FRICTION = 0.18
LENGTH_SCALE = 0.98
NOISE_M = 3e-4
NOISE_RAD = 2e-3
NOISE_M_S = 5e-3
NOISE_RAD_S = 2e-2
_MOST_ROWS = 300
_STILL_ROWS = 10

_MODEL = f"""
<mujoco>
  <option timestep="{1.0 / RATE / SUBSTEPS}" cone="elliptic" impratio="10" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="0 0 1" friction="{FRICTION} 0.001 0.0001" solref="0.004 1"/>
    <body><freejoint/>
      <geom type="box" size="{EDGE / 2} {EDGE / 2} {EDGE / 2}" mass="{MASS}" friction="{FRICTION} 0.001 0.0001"
        solref="0.004 1"/>
    </body>
  </worldbody>
</mujoco>
"""

Rows = dict[str, list[NDArray[np.float64]]]


def main() -> None:
    """Write the set."""
    rng = np.random.default_rng(SEED)
    model = mujoco.MjModel.from_xml_string(_MODEL)
    rows: Rows = {name: [] for name in ("position", "quaternion", "velocity", "angular_velocity")}
    first = [0]
    for _ in range(TOSSES):
        _throw(model, rng, rows)
        first.append(len(rows["position"]))
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else SYNTHETIC
    arrays: dict[str, Any] = {name: np.array(values, dtype=np.float32) for name, values in rows.items()}
    np.savez_compressed(path, first=np.array(first, dtype=np.int32), **arrays)
    print(f"{path}: {TOSSES} tosses, {first[-1]} rows, {path.stat().st_size} bytes")


def _throw(model: mujoco.MjModel, rng: np.random.Generator, rows: Rows) -> None:
    """One toss: from a random first state until the cube lies still."""
    data = mujoco.MjData(model)
    heading = rng.uniform(-np.pi, np.pi)
    toward = heading + np.pi + rng.uniform(-0.4, 0.4)
    speed = rng.normal(1.05, 0.12)
    data.qpos[:3] = 0.31 * np.cos(heading), 0.31 * np.sin(heading), rng.uniform(0.12, 0.16)
    data.qpos[3:] = _unit(rng.normal(size=4))
    data.qvel[:3] = speed * np.cos(toward), speed * np.sin(toward), rng.uniform(-0.5, 0.5)
    data.qvel[3:] = rng.normal(size=3) * 2.4
    before, still = data.qpos[:3] - data.qvel[:3] / RATE, 0
    before[2] += model.opt.gravity[2] / RATE**2 / 2  # it fell freely until now
    for _ in range(_MOST_ROWS):
        _track(data, before, rng, rows)
        slow = np.linalg.norm(data.qvel[:3]) < 0.01 and np.linalg.norm(data.qvel[3:]) < 0.1
        still = still + 1 if slow else 0
        if still > _STILL_ROWS:
            return
        before = data.qpos[:3].copy()
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)


def _track(data: mujoco.MjData, before: NDArray[np.float64], rng: np.random.Generator, rows: Rows) -> None:
    """What a camera makes of a state; MuJoCo's angular velocity is in the body's frame, as the measured set has it."""
    turn = rng.normal(size=3) * NOISE_RAD / 2
    seen = np.empty(4)
    mujoco.mju_mulQuat(seen, data.qpos[3:], _unit(np.array([1.0, *turn])))
    rows["position"].append(LENGTH_SCALE * (data.qpos[:3] + rng.normal(size=3) * NOISE_M))
    rows["quaternion"].append(_unit(seen))
    rows["velocity"].append(LENGTH_SCALE * ((data.qpos[:3] - before) * RATE + rng.normal(size=3) * NOISE_M_S))
    rows["angular_velocity"].append(data.qvel[3:] + rng.normal(size=3) * NOISE_RAD_S)


def _unit(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(quaternion / np.linalg.norm(quaternion))


if __name__ == "__main__":
    main()
