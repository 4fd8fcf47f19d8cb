"""Recordings of given motions, by the recorder's own writers: mechanics with a known answer."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.scenes.base import Scene, Sphere
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import body_fields
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION, Provenance, Simulation

Array = NDArray[np.float64]
Motion = dict[str, Array]
"""Fields of all bodies by name, shape [row, env, body, width], bodies in the scene's order."""


def at_rest(scene: Scene, rows: int, n_env: int = 1) -> Motion:
    """All bodies where the scene puts them, for some rows."""
    bodies = scene.moving()
    shape = (rows, n_env, len(bodies))
    return {
        "position": np.broadcast_to([body.position for body in bodies], (*shape, 3)).copy(),
        "orientation": np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*shape, 4)).copy(),
        "linear_velocity": np.zeros((*shape, 3)),
        "angular_velocity": np.zeros((*shape, 3)),
    }


def rolling(scene: Scene, *, dt: float, rows: int, n_env: int = 1, share: float = 5.0 / 7.0) -> Motion:
    """The ball rolls down the slope by semi-implicit Euler with `share` of g sin(20 degrees); the cubes lie still."""
    motion = at_rest(scene, rows, n_env)
    angle = math.radians(20.0)
    downhill = np.array([math.cos(angle), 0.0, -math.sin(angle)])
    step = np.arange(rows)[:, None]
    speed = share * 9.81 * math.sin(angle) * dt * step
    radius = next(b.shape.radius for b in scene.moving() if isinstance(b.shape, Sphere))
    motion["position"][:, :, 0] += (np.cumsum(speed, axis=0)[:, :, None] * dt) * downhill
    motion["linear_velocity"][:, :, 0] = speed[:, :, None] * downhill
    motion["angular_velocity"][:, :, 0, 1] = speed / radius
    return motion


def falling(scene: Scene, *, dt: float, rows: int, n_env: int = 1, half_steps: int = 1) -> Motion:
    """All bodies fall by a step of a first-order method: z = z0 - g t^2/2 - half_steps g t dt/2, until the ground."""
    motion = at_rest(scene, rows, n_env)
    step = np.arange(rows)
    fallen = 9.81 * dt**2 * (step**2 + half_steps * step) / 2
    lands = int(np.argmax(fallen > 0.5)) if (fallen > 0.5).any() else rows
    fallen[lands:] = 0.5
    speed = np.where(step < lands, 9.81 * dt * step, 0.0)
    motion["position"][..., 2] -= fallen[:, None, None]
    motion["linear_velocity"][..., 2] -= speed[:, None, None]
    return motion


def write_motion(
    folder: Path,
    scene_name: str,
    motion: Mapping[str, Array],
    *,
    dt: float = 0.01,
    stride: int = 1,
    dtype: str = "float64",
    without: tuple[str, ...] = (),
    origins: tuple[tuple[float, float, float], ...] = (),
    change_scene: Callable[[Scene], Scene] = lambda scene: scene,
) -> Path:
    """A complete recording of a motion.

    without  fields that are left out
    origins  of the environments, added to positions as an engine would
    """
    scene = change_scene(make_scene(scene_name))
    fields = tuple(f for f in body_fields(scene.groups(), dtype) if f.field not in without)
    rows, n_env = motion["position"].shape[:2]
    steps = (rows - 1) * stride
    configuration = RunConfiguration(
        simulator="synthetic", scene=scene_name, n_env=n_env, dt=dt, steps=steps, run_index=0, warmup=0,
        timed_steps=0, phases=("capture",), stride=stride, determinism="default", options={},
    )  # fmt: skip
    provenance = Provenance(
        str(uuid.uuid4()), "2026-01-01T00:00:00Z", ("test",), configuration, gpus=(), host={"cpu": "test"},
        environment={},
    )  # fmt: skip
    simulation = Simulation(
        version="1.0", device="cpu", options={}, switches={}, deviations=(), fields=fields,
        scene={"name": scene_name, "sha256": scene.sha256(), "parameters": {}}, env_origins=origins, buffers=(),
        counters=(), overflow_bits=(),
    )  # fmt: skip
    path = folder / f"{uuid.uuid4().hex}.mcap"
    sink = Sink(path, compression="none")
    for name, text in (
        (PROVENANCE, provenance.to_json()),
        (SCENE, scene.to_json()),
        (SIMULATION, simulation.to_json()),
    ):
        sink.attach(name, "application/json", text.encode())
    writer = StateWriter(sink, fields, n_env=n_env, dt=dt, stride=stride)
    shift = np.array(origins)[:, None] if origins else 0.0
    order = {name: index for index, name in enumerate(body.name for body in scene.moving())}
    arrays = []
    for field in fields:
        whole = motion[field.field] + (shift if field.field == "position" else 0.0)
        # a writer is fed every step, and keeps those of its stride
        every = np.repeat(whole, stride, axis=0)[: steps + 1]
        arrays.append(every[:, :, [order[item] for item in field.items]].astype(dtype))
    writer.feed(arrays)
    writer.flush()
    return sink.finish("COMPLETE", "", last_step=steps, peak_rss_bytes=0, cause="")


def heavier_gravity(scene: Scene) -> Scene:
    """The scene with twice the gravity."""
    return replace(scene, gravity=(0.0, 0.0, -19.62))
