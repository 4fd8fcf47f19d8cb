"""Recordings of any groups, by the public writer: a humanoid, a pendulum, and whatever names a stranger gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas.fields import StateField, ball_fields, body_fields, joint_field


@dataclass(frozen=True)
class Described(Scene):
    """A scene whose description is any text."""

    text: str = ""

    def to_json(self) -> str:
        """The text."""
        return self.text


@dataclass(frozen=True)
class Layout:
    """What a recording holds.

    scene        its name
    fields       state fields
    n_env        environments
    steps        captured
    described    scene.json as it is; empty: there is none
    noise        amplitude by which runs and environments differ from step 1 on; 0: all are alike
    """

    scene: str
    fields: tuple[StateField, ...]
    n_env: int = 4
    steps: int = 20
    described: str = ""
    noise: float = 1e-3


def humanoid(n_env: int = 64, dtype: str = "float32") -> Layout:
    """A floating base and 27 joints, one of which slides, and two ball joints."""
    joints = tuple(f"joint_{k}" for k in range(27))
    fields = (
        *body_fields({"bodies": ("torso",)}, dtype),
        joint_field("joints", "qpos", dtype, joints, slides=("joint_26",)),
        joint_field("joints", "qvel", dtype, joints, slides=("joint_26",)),
        *ball_fields("balls", dtype, ("shoulder_left", "shoulder_right")),
    )
    return Layout("humanoid", fields, n_env=n_env)


def pendulum() -> Layout:
    """One hinge."""
    fields = tuple(joint_field("joints", name, "float64", ("hinge",)) for name in ("qpos", "qvel"))
    return Layout("pendulum", fields)


def cart_pole() -> Layout:
    """A slide and a hinge: one field of two units."""
    names = ("slider", "hinge")
    fields = tuple(joint_field("joints", name, "float64", names, slides=("slider",)) for name in ("qpos", "qvel"))
    return Layout("cart-pole", fields)


HOSTILE = ("<script>alert(1)</script>", "\x1b[31mred\x1b[0m \u202e\x00", "=cmd|' /C calc'!A0,'\"`$(id)|x" + "w" * 300)


def hostile() -> Layout:
    """Three free bodies whose names, group and scene are of a hostile user."""
    return Layout("<b>scene</b>\n\x1b[2J", body_fields({"things": HOSTILE}, "float32"))


def states(layout: Layout, run: int = 0) -> list[np.ndarray[Any, Any]]:
    """An array a field, [step, env, item, width]: smooth motions, apart by noise that grows."""
    draw = np.random.default_rng(run)
    rows = np.arange(layout.steps + 1)
    made = []
    for number, one in enumerate(layout.fields):
        shape = (len(rows), layout.n_env, len(one.items), one.width)
        base = np.sin(0.1 * rows[:, None, None, None] + np.arange(len(one.items))[None, None, :, None] + number)
        noise = layout.noise * draw.standard_normal(shape[1:]) * (rows > 0)[:, None, None, None]
        values = np.broadcast_to(base, shape) * 0.5 + noise
        if one.field == "orientation":
            values = values + np.array([2.0, 0.0, 0.0, 0.0])
            values /= np.linalg.norm(values, axis=-1, keepdims=True)
        made.append(values.astype(one.dtype))
    return made


def write(folder: Path, layout: Layout, run: int = 0, *, simulator: str = "mine", **others: Any) -> Path:
    """A recording of a layout."""
    path = folder / f"{simulator}-{run}.mcap"
    scene = Described(layout.scene, "", (), text=layout.described) if layout.described else layout.scene
    announced: dict[str, Any] = {
        "simulator": simulator, "version": "1.0", "scene": scene, "n_env": layout.n_env, "dt": 0.01,
        "steps": layout.steps, "fields": layout.fields, "run_index": run, **others,
    }  # fmt: skip
    with RecordingWriter(path, **announced) as log:
        log.append(*states(layout, run))
    return path


def runs(folder: Path, layout: Layout, count: int = 3, **others: Any) -> Sequence[Path]:
    """Several runs of a layout."""
    return [write(folder, layout, run, **others) for run in range(count)]
