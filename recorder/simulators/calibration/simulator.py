"""A calibration simulator: an instrument whose answer is known, not an engine. Never ranked.

Spheres on damped springs, float32, semi-implicit Euler, in Taichi kernels. Which environments and runs differ is asked
for (`regime`), and so is by how much (`shift`, `ulps`), so that it is known what the evaluation has to find.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, Ability
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.calibration.model import deviations
from gpusimbench.recorder.simulators.calibration.options import BY_RUN, CalibrationOptions, entropy_of
from gpusimbench.recorder.simulators.evidence import CONTACTS, Evidence
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims, rows_of
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import body_field

_FIELDS = ("position", "linear_velocity", "angular_velocity")
_ENTROPY = "entropy.txt"


class Calibration(Simulator):
    """N environments of spheres whose differences are built in."""

    Options = CalibrationOptions
    distribution = "taichi"
    abilities = BODIES - {Ability.CAPSULES}

    @classmethod
    def environment(cls, options: Any, determinism: str) -> dict[str, str]:
        """See Simulator.environment: Taichi does not ask the network for newer versions of itself."""
        return {"TI_SKIP_VERSION_CHECK": "ON"}

    def build(self) -> Description:
        """See Simulator.build."""
        options: CalibrationOptions = self.options
        if options.env >= self.n_env:
            raise UsageError(f"option 'env' is {options.env}, and there are {self.n_env} environments, from 0 on")
        device = _start(options.device)
        import taichi as ti

        from gpusimbench.recorder.simulators.calibration.world import World

        entropy = entropy_of(options)
        self._world = World(self.scene, n_env=self.n_env, dt=self.dt, options=options, entropy=entropy)
        self._counted: NDArray[np.int32] | None = None
        self._stepped = False
        names = [body.name for body in self.scene.moving()]
        self._groups = [np.array([names.index(name) for name in group]) for group in self.scene.groups().values()]
        config = ti.lang.impl.current_cfg()
        # The digits stand for chance, which an engine would not tell: kept with the run, and no setting, since runs
        # of different settings are not compared.
        draws = options.regime in BY_RUN
        kept = {_ENTROPY: ("text/plain", f"{entropy}\n".encode())} if draws else {}
        drawn = f"see {_ENTROPY}" if draws else "not drawn"
        return Description(
            version=".".join(map(str, ti.__version__)),
            device=device,
            options={**vars(options), "device": "cpu" if device == "cpu" else "cuda", "entropy": drawn},
            switches={
                "instrument": True,
                "precision": "float32",
                "fast_math": bool(config.fast_math),
                "opt_level": int(config.opt_level),
                "substeps": self._world.substeps,
                "sums": "racing atomic additions" if options.regime == "atomics" else "one thread an environment",
            },
            deviations=deviations(options.contacts),
            fields=tuple(
                body_field(group, name, "float32", bodies)
                for group, bodies in self.scene.groups().items()
                for name in _FIELDS
            ),
            timing_covers="Taichi kernels, one launch a step (atomics: three a substep), and one synchronisation; no "
            "state is copied",
            attachments=kept,
            counters=(CONTACTS,),
        )

    def compile(self, phase: str) -> None:
        """See Simulator.compile."""
        self._world.rehearse(storing=phase == "capture")

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        import taichi as ti

        self._counted, self._stepped = None, True
        for _ in range(n_step):
            self._world.step()
        self._world.fault.after_uncaptured(self._world)
        ti.sync()

    def state(self) -> States:
        """See Simulator.state."""
        return self._split(self._world.state())

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        return StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE)

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._world.done, dict(zip(_FIELDS, self._world.state(), strict=True)))

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._put([snapshot.arrays[name] for name in _FIELDS], envs, snapshot.step)
        self._world.fault.after("restored" if self._stepped else "process", self._world, envs)

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset."""
        self._put(self._world.first, envs, 0)
        self._world.fault.after("fresh", self._world, envs)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state."""
        given = [array[rows_of(envs)].copy() for array in self._world.first]
        left = iter(states)
        for group in self._groups:
            for array in given:
                array[:, group] = next(left)
        self._world.put(given, envs, self._world.done if envs is not None else 0)
        self._world.fault.after("set", self._world, envs)
        self._counted = None

    def _put(self, arrays: Sequence[NDArray[Any]], envs: Envs, step: int) -> None:
        self._world.put(
            [array[rows_of(envs)] for array in arrays], envs, self._world.done if envs is not None else step
        )
        self._counted = None

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        self._stepped = True
        states, counts = [], []
        for first in range(0, n_step, self._world.rows):
            rows = min(self._world.rows, n_step - first)
            for row in range(rows):
                self._world.step()
                self._world.store(row)
            fields, counted = self._world.stored(rows)
            states.append(self._split(fields))
            counts.append(counted)
        self._counted = np.concatenate(counts)
        return tuple(map(np.concatenate, zip(*states, strict=True)))

    def _split(self, fields: list[NDArray[np.float32]]) -> States:
        return tuple(array[..., group, :] for group in self._groups for array in fields)

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        return Evidence({CONTACTS.name: self._world.counts()[None] if self._counted is None else self._counted})

    def close(self) -> None:
        """See Simulator.close."""
        vars(self).pop("_world", None)


@cache
def _start(device: str) -> str:
    """Start Taichi, once a process; "cpu" or the GPU's name. UsageError where Taichi has no such device here."""
    import taichi as ti

    ti.init(
        arch=ti.cpu if device == "cpu" else ti.cuda,
        default_fp=ti.f32,
        default_ip=ti.i32,
        fast_math=False,
        offline_cache=False,
        cpu_max_num_threads=len(os.sched_getaffinity(0)),
        log_level=ti.ERROR,
    )
    if ti.lang.impl.current_cfg().arch != ti.cuda:
        if device == "cuda":
            raise UsageError("option 'device' is auto, cpu or cuda, and Taichi has no 'cuda' here")
        return "cpu"
    with Gpus() as gpus:
        found = gpus.describe()
    return str(found[0].get("name", "cuda")) if found else "cuda"
