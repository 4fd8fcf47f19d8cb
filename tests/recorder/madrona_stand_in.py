"""A simulator module that honours the contract of docs/madrona.md without being Madrona: numpy, float32.

Bodies fly and turn freely. Where the scene has a ground plane, a damped spring under the centre of each body keeps it
at the height of half its smallest extent; nothing else touches. That is enough to see every obligation of the contract.
"""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np

madrona = SimpleNamespace(ExecMode=SimpleNamespace(CPU="CPU", CUDA="CUDA"))

_STIFFNESS = 2e4  # of the ground, acceleration per depth [1/s2]
_DAMPING = 200.0  # [1/s]


def version() -> str:
    """Name the build."""
    return f"stand-in 1 (numpy {np.__version__}), not Madrona"


class SimManager:
    """All worlds of a scene."""

    def __init__(
        self, *, exec_mode: str, gpu_id: int, num_worlds: int, rand_seed: int, auto_reset: bool,
        scene: str, delta_t: float, num_substeps: int,
    ) -> None:  # fmt: skip
        assert exec_mode == madrona.ExecMode.CPU
        assert gpu_id == 0
        assert 0 <= rand_seed < 2**64
        assert not auto_reset
        self._scene = json.loads(scene)
        bodies = self._moving = [body for body in self._scene["bodies"] if "mass" in body]
        if any(body["shape"]["kind"] == "capsule" for body in bodies):
            raise ValueError("capsules are not simulated")
        self._dt, self._substeps = delta_t, num_substeps or 4
        self._ground = any(body["shape"]["kind"] == "plane" for body in self._scene["bodies"])
        self._radius = np.array([_radius(body["shape"]) for body in bodies], dtype=np.float32)

        def column(*fields: str) -> Any:
            row = np.array([sum((body[field] for field in fields), []) for body in bodies], dtype=np.float32)
            return np.repeat(row[None], num_worlds, axis=0)

        self._position = column("position")
        self._rotation = column("orientation")
        self._velocity = column("linear_velocity", "angular_velocity")
        self._contacts = np.zeros(num_worlds, dtype=np.int32)
        self._dropped = np.zeros(num_worlds, dtype=np.int32)

    def body_names(self) -> list[str]:
        """Name the rows."""
        return [body["name"] for body in self._moving]

    def settings(self) -> dict[str, Any]:
        """Say what is in force."""
        return {
            "solver": "damped spring under each body",
            "num_substeps": self._substeps,
            "delta_t": float(np.float32(self._dt)),
            "gravity": self._scene["gravity"],
            "restitution": 0.3,
            "friction_combination": "none",
        }

    def deviations(self) -> list[tuple[str, str, str, str]]:
        """Say what the scene asks for and does not get."""
        return [("contact", "between all bodies", "with a ground plane alone", "a stand-in")]

    def step(self) -> None:
        """Advance all worlds."""
        h = np.float32(self._dt / self._substeps)
        gravity = np.array(self._scene["gravity"], dtype=np.float32)
        linear, angular = self._velocity[..., :3], self._velocity[..., 3:]
        for _ in range(self._substeps):
            linear += h * gravity
            depth = np.maximum(self._radius - self._position[..., 2], 0) * self._ground
            push = np.maximum(_STIFFNESS * depth - _DAMPING * linear[..., 2], 0) * (depth > 0)
            linear[..., 2] += h * push.astype(np.float32)
            self._position += h * linear
            _turn(self._rotation, angular, h)
        self._contacts[:] = np.count_nonzero(depth, axis=1)

    def position_tensor(self) -> Any:
        """[world, body, 3]."""
        return self._position

    def rotation_tensor(self) -> Any:
        """[world, body, 4], wxyz."""
        return self._rotation

    def velocity_tensor(self) -> Any:
        """[world, body, 6], linear and angular."""
        return self._velocity

    def contact_count_tensor(self) -> Any:
        """[world]."""
        return self._contacts

    def dropped_count_tensor(self) -> Any:
        """[world]."""
        return self._dropped


def _radius(shape: dict[str, Any]) -> float:
    return float(shape["radius"] if shape["kind"] == "sphere" else min(shape["size"]) / 2)


def _turn(rotation: Any, angular: Any, h: np.float32) -> None:
    # q <- dq q, dq the turn by |omega| h about omega in the world frame
    angle = np.linalg.norm(angular, axis=-1, keepdims=True) * h
    vector = angular * h * np.sinc(angle / (2 * np.pi)) / 2
    scalar = np.cos(angle / 2)
    w, v = rotation[..., :1].copy(), rotation[..., 1:].copy()
    rotation[..., :1] = scalar * w - np.sum(vector * v, axis=-1, keepdims=True)
    rotation[..., 1:] = scalar * v + w * vector + np.cross(vector, v)
    rotation /= np.linalg.norm(rotation, axis=-1, keepdims=True)
