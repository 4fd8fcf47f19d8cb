"""What of a compiled model MuJoCo's schema of USD has attributes for, which Newton's importer reads.

A list of property lines for a prim of recorder.simulators.physx.stage, for each joint, geom, body and material.
Positions of joints are zero in the reference state there, and angles in radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from gpusimbench.recorder.scenes.emit.usd import literal


class MuJoCoWords:
    """The attributes (mjc:) of the joints, geoms and bodies of a mujoco.MjModel."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def joint(self, joint: int) -> list[str]:
        """Of a hinge or slide."""
        model, dof, at = self._model, int(self._model.jnt_dofadr[joint]), int(self._model.jnt_qposadr[joint])
        numbers = {
            "armature": model.dof_armature[dof], "damping": model.dof_damping[dof],
            "frictionloss": model.dof_frictionloss[dof], "stiffness": model.jnt_stiffness[joint],
            "springref": model.qpos_spring[at] - model.qpos0[at], "margin": model.jnt_margin[joint],
        }  # fmt: skip
        return [
            *_numbers(numbers),
            _array("solreflimit", model.jnt_solref[joint]),
            _array("solimplimit", model.jnt_solimp[joint]),
            _array("solreffriction", model.dof_solref[dof]),
            _array("solimpfriction", model.dof_solimp[dof]),
        ]

    def geom(self, geom: int) -> list[str]:
        """Of a shape that collides."""
        model = self._model
        words = ("condim", "priority", "contype", "conaffinity")
        return [
            *(f"int mjc:{word} = {int(getattr(model, f'geom_{word}')[geom])}" for word in words),
            *_numbers({word: getattr(model, f"geom_{word}")[geom] for word in ("solmix", "margin", "gap")}),
            _array("solref", model.geom_solref[geom]),
            _array("solimp", model.geom_solimp[geom]),
        ]

    def body(self, body: int) -> list[str]:
        """Of a link."""
        return _numbers({"gravcomp": self._model.body_gravcomp[body]})

    def friction(self, coefficients: Sequence[float]) -> list[str]:
        """Of a material: the torsional and the rolling one [m], after that against sliding."""
        _, torsional, rolling = coefficients
        return _numbers({"torsionalfriction": torsional, "rollingfriction": rolling})


def _numbers(numbers: dict[str, Any]) -> list[str]:
    return [f"double mjc:{name} = {literal(float(number))}" for name, number in numbers.items()]


def _array(name: str, numbers: Iterable[Any]) -> str:
    return f"double[] mjc:{name} = [{', '.join(literal(float(number)) for number in numbers)}]"
