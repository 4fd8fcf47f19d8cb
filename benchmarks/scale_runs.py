"""Recordings whose environments all differ, as those of most GPU simulators do, made by MuJoCo C.

MuJoCo computes equal environments to equal bits, and what is equal is neither read nor solved twice; so each here
begins with velocities of its own, 1e-5 m/s and rad/s apart, and ends up to centimetres from the others.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.fields import StateField

SHIPPED = Path(__file__).resolve().parent.parent / "recordings"
_MODEL = SHIPPED / "mujoco-amd-r0.mcap"
_SCENE = "inclined-collision"


def record(folder: Path, *, runs: int, n_env: int, steps: int) -> list[Path]:
    """Runs of one configuration, every step recorded in float32 and not compressed; their files."""
    import mujoco

    source = open_recording(_MODEL)
    model = mujoco.MjModel.from_xml_string((source.attachment("scene.xml") or b"").decode())
    fields = tuple(replace(field, dtype="float32") for field in source.fields)
    paths = [folder / f"run-{run}.mcap" for run in range(runs)]
    for run, path in enumerate(paths):
        draw = np.random.default_rng(run)
        envs = [mujoco.MjData(model) for _ in range(n_env)]
        for data in envs:
            data.qvel[:] += 1e-5 * draw.standard_normal(model.nv)
            mujoco.mj_kinematics(model, data)
        with RecordingWriter(
            path, simulator="mujoco-perturbed", version=mujoco.__version__, scene=make_scene(_SCENE), n_env=n_env,
            dt=model.opt.timestep, steps=steps, fields=fields, run_index=run,
        ) as log:  # fmt: skip
            for step in range(steps + 1):
                if step:
                    for data in envs:
                        mujoco.mj_step(model, data)
                log.append(*(np.stack([_state(model, data, field) for data in envs]) for field in fields))
    return paths


def _state(model: object, data: object, field: StateField) -> NDArray[np.float32]:
    # one field of one environment, [item, width]
    bodies = [model.body(name).id for name in field.items]  # type: ignore[attr-defined]
    if field.field == "position":
        found = data.xpos[bodies]  # type: ignore[attr-defined]
    elif field.field == "orientation":
        found = data.xquat[bodies]  # type: ignore[attr-defined]
    else:
        linear = field.field == "linear_velocity"
        starts = model.body_dofadr[bodies][:, None] + ([0, 1, 2] if linear else [3, 4, 5])  # type: ignore[attr-defined]
        found = data.qvel[starts]  # type: ignore[attr-defined]
        if not linear:  # MuJoCo has it in the body's frame
            found = np.einsum("nij,nj->ni", data.xmat[bodies].reshape(-1, 3, 3), found)  # type: ignore[attr-defined]
    return np.asarray(found, dtype=np.float32)
