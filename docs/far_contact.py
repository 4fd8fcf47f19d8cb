"""Two cubes whose contact MuJoCo Warp puts 45 km away: python docs/far_contact.py

The cubes, of 2 cm, lie beside each other, one turned against the other by 1.6 degrees, so that two edges are parallel
but for 2e-7 rad. Their poses are those of the environment of recordings/not-finite-h100 at step 36, the last finite
one. For each collision function this prints how many contacts the pair has, how far the farthest lies from the nearer
cube's centre, and of how many poses that differ by at most two units in the last place a contact is farther than 1 m.
"""

from __future__ import annotations

import mujoco
import mujoco_warp
import numpy as np
import warp as wp

MODEL = """
<mujoco>
  <option> <flag nativeccd="{native}"/> </option>
  <worldbody>
    <body> <freejoint/> <geom type="box" size="0.01 0.01 0.01" mass="0.005"/> </body>
    <body> <freejoint/> <geom type="box" size="0.01 0.01 0.01" mass="0.005"/> </body>
  </worldbody>
</mujoco>
"""
POSES = np.array(
    [
        -0.019999997690320015, 1.246120873155121e-09, 0.030975069850683212,
        0.9999997615814209, 9.67505400240043e-08, 3.657568470316619e-08, -4.137485493105331e-12,
        0.00023212058295030147, 1.3346876936992658e-09, 0.03091704659163952,
        0.9999029040336609, -1.014344661598443e-07, -0.0139346644282341, 7.2184844768230505e-09,
    ],
    np.float32,
)  # fmt: skip
"""qpos: position [m] and quaternion wxyz of each cube."""
NEIGHBOURS = 511
FAR = 1.0  # m


def neighbours() -> np.ndarray:
    """The poses, and random poses that differ from them by at most two units in the last place, [world, 14]."""
    units = np.random.default_rng(0).integers(-2, 3, size=(NEIGHBOURS, POSES.size))
    units[:, [3, 10]] = 0  # w of the quaternions
    return np.concatenate([POSES[None], POSES + units.astype(np.float32) * np.spacing(POSES)])


def by_mujoco(poses: np.ndarray) -> list[np.ndarray]:
    """Contact positions [contact, 3] of each world."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(native="enable"))
    data = mujoco.MjData(model)
    found = []
    for pose in poses:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        found.append(data.contact.pos.copy())
    return found


def by_mujoco_warp(poses: np.ndarray, native: str) -> list[np.ndarray]:
    """Contact positions [contact, 3] of each world. native: enable or disable, of the convex collision function."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(native=native))
    on_device = mujoco_warp.put_model(model)
    data = mujoco_warp.put_data(model, mujoco.MjData(model), nworld=len(poses), nconmax=16, njmax=64)
    data.qpos = wp.array(poses, dtype=float)
    mujoco_warp.kinematics(on_device, data)
    mujoco_warp.com_pos(on_device, data)
    mujoco_warp.collision(on_device, data)
    count = int(data.nacon.numpy()[0])
    positions, world = data.contact.pos.numpy()[:count], data.contact.worldid.numpy()[:count]
    return [positions[world == index] for index in range(len(poses))]


def distance(contacts: np.ndarray) -> float:
    """How far the farthest contact lies from the nearer cube's centre [m]; 0 where there is no contact."""
    centres = POSES.reshape(2, 7)[:, :3]
    if not len(contacts):
        return 0.0
    return float(np.linalg.norm(contacts[:, None] - centres, axis=-1).min(axis=1).max())


def main() -> None:
    """Print a line for each collision function."""
    poses = neighbours()
    for name, worlds in (
        (f"MuJoCo C {mujoco.__version__}", by_mujoco(poses)),
        (f"MuJoCo Warp {mujoco_warp.__version__}, convex (default)", by_mujoco_warp(poses, "enable")),
        (f"MuJoCo Warp {mujoco_warp.__version__}, box-box (nativeccd disabled)", by_mujoco_warp(poses, "disable")),
    ):
        far = sum(distance(contacts) > FAR for contacts in worlds[1:])
        first = f"{len(worlds[0])} of the pair, farthest {distance(worlds[0]):.3g} m"
        print(f"{name}: contacts: {first}; farther than {FAR:g} m in {far} of {NEIGHBOURS} other poses")


if __name__ == "__main__":
    main()
