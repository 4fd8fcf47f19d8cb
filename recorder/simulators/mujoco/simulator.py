"""MuJoCo C on the CPU: the embedded default and the float64 reference.

Environments are the simulations of one ``mujoco.batch.Batch``, stepped on a pool of threads; MuJoCo promises results
that are bit-identical to a loop over one MjData each, at any number of threads. That loop is there too (worlds.py).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, VARIED, Ability
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import one_of
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import CONSTRAINT_ROWS, CONTACTS, MISPLACED_CONTACTS, Evidence, joined
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import OverflowBit

STEPPING = ("auto", "batch", "mj_step")

_DROPPED = ("mjWARN_CONTACTFULL", "mjWARN_CNSTRFULL")
"""Warnings that there was no room for contacts or constraints; MuJoCo goes on without them."""


@dataclass(frozen=True)
class MujocoOptions(MjcfOptions):
    """Options of MuJoCo C.

    threads    0: as many as the process may use
    stepping   batch: mujoco.batch.Batch; mj_step: mj_step of each environment, which every release of MuJoCo has; auto:
               the batch where there is one, and the model enables neither sleep nor ipc. Both give the same bits
    """

    threads: int = 0
    stepping: str = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads < 0:
            raise ValueError("threads is 0 (all that the process may use) or a positive number")
        one_of("stepping", self.stepping, STEPPING)


class MujocoC(Simulator):
    """N environments on MuJoCo C."""

    Options = MujocoOptions
    distribution = "mujoco"
    abilities = BODIES | ROBOTS | {Ability.CHAINS, Ability.LOOPS, Ability.MODELS, *VARIED.values()}
    across_releases = {"stepping": "mj_step"}

    def build(self) -> Description:
        """See Simulator.build."""
        import mujoco

        from gpusimbench.recorder.simulators.mujoco.model import KNOWS_AUTORESET, compile_scene, compile_varied
        from gpusimbench.recorder.simulators.mujoco.worlds import BatchWorlds, make_worlds

        options: MujocoOptions = self.options
        compiled = self._compiled = compile_scene(self.scene, dt=self.dt, options=options)
        self._warnings = [mujoco.mjtWarning(kind).name for kind in range(int(mujoco.mjtWarning.mjNWARNING))]
        threads = options.threads or len(os.sched_getaffinity(0))
        models = compile_varied(self.scene, self.variation, n_env=self.n_env, dt=self.dt, options=options)
        self._worlds = make_worlds(options.stepping, models or [compiled.model] * self.n_env, threads)
        self._worlds.write("qpos", compiled.qpos0)
        self._worlds.write("qvel", compiled.qvel0)
        self._evidence: Evidence | None = None  # of the last states; None: to be taken when asked
        self._warned = np.zeros((self.n_env, len(self._warnings)), dtype=np.int64)
        self._risen = np.zeros_like(self._warned)  # since gates were asked
        self._dropping = np.zeros_like(self._warned)  # since the last row of overflow bits
        self._dropped = [self._warnings.index(name) for name in _DROPPED]
        self._actions: NDArray[np.float32] | None = None
        self._next_action = 0
        self._made = 0  # steps since the build
        switches = {"precision": "float64"} | ({} if KNOWS_AUTORESET else {"autoreset": "enable"})
        # the batch is what recordings have that do not say
        stepping = {} if isinstance(self._worlds, BatchWorlds) else {"stepping": "mj_step"}
        return Description(
            version=mujoco.__version__,
            device="cpu",
            options={**compiled.in_force(options, "mujoco"), "threads": threads, **stepping},
            switches=switches,
            deviations=compiled.deviations,
            fields=compiled.fields("float64"),
            timing_covers=self._worlds.timing_covers,
            attachments=compiled.attachments,
            counters=(CONTACTS, CONSTRAINT_ROWS, *(() if self._worlds.misplaced() is None else (MISPLACED_CONTACTS,))),
            overflow_bits=tuple(OverflowBit(bit, name, fatal=True) for bit, name in enumerate(_DROPPED)),
        )

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        self._actions = actions
        self._next_action = 0

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        self._evidence = None
        self._made += n_step
        if self._actions is None:
            self._worlds.step(n_step)
            return
        for _ in range(n_step):
            # in double precision, which holds every float32
            self._worlds.write("ctrl", self._actions[self._next_action])
            self._next_action += 1
            self._worlds.step(1)

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        return None if self.scene.actions is None else self._worlds.read("ctrl").astype(np.float32)

    def state(self) -> States:
        """See Simulator.state."""
        return self._compiled.split(self._worlds.read("qpos").copy(), self._worlds.read("qvel").copy())

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims; the components of mjSTATE_INTEGRATION are all that mj_step reads."""
        return StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE)

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot; Refused where bodies may sleep: which of them do is no part of MuJoCo's state, and a
        run that goes on from it differs."""
        from gpusimbench.recorder.simulators.mujoco.worlds import remembers

        if flag := remembers(self._compiled.model):
            raise Refused(
                f"the state that MuJoCo saves of a model with the flag {flag} is incomplete, so a run that goes on "
                f'from it differs; set <flag {flag}="disable"/> in the model'
            )
        return Snapshot(self._made, {name: self._worlds.read(name).copy() for name in self._worlds.state_names})

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        for name in self._worlds.state_names:
            values = snapshot.arrays[name]
            self._worlds.write(name, values if envs is None else values[envs], envs)
        if envs is None:
            self._made = snapshot.step
        self._evidence = None

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: a reset of MuJoCo's, then the scene's initial velocities."""
        self._begin(self._compiled.qpos0, self._compiled.qvel0, envs)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: a reset of MuJoCo's, then positions and velocities."""
        self._begin(*self._compiled.joined(states), envs)

    def _begin(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], envs: Envs) -> None:
        self._count_warnings()  # a reset clears those of its environments
        self._worlds.reset(envs)
        self._warned = self._worlds.warnings()
        self._worlds.write("qpos", qpos, envs)
        self._worlds.write("qvel", qvel, envs)
        if envs is None:
            self._made = 0
        self._evidence = None

    def imported(self) -> Imported:
        """See Simulator.imported."""
        from gpusimbench.recorder.simulators.mujoco.imported import of_c

        return of_c(self._compiled.model)

    def link_poses(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See Simulator.link_poses: mj_kinematics."""
        import mujoco

        model, poses = self._compiled.model, []
        data = mujoco.MjData(model)
        for qpos in self._worlds.read("qpos"):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            poses.append((data.xpos.copy(), data.xquat.copy()))
        positions, orientations = zip(*poses, strict=True)
        return np.array(positions), np.array(orientations)

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        self._worlds.write("ctrl", controls)

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        # Not Batch.rollout: it stops a simulation whose warning counters rise and repeats its last state.
        model = self._compiled.model
        qpos = np.empty((n_step, self.n_env, model.nq))
        qvel = np.empty((n_step, self.n_env, model.nv))
        rows = []
        for k in range(n_step):
            self.step(1)
            qpos[k] = self._worlds.read("qpos")
            qvel[k] = self._worlds.read("qvel")
            rows.append(self._row())
        self._evidence = joined(rows)
        return self._compiled.split(qpos, qvel)

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        return self._row() if self._evidence is None else self._evidence

    def _row(self) -> Evidence:
        """Counts of the last step, and overflow bits of the steps since the last row."""
        self._count_warnings()
        fired, self._dropping = self._dropping[:, self._dropped] > 0, np.zeros_like(self._dropping)
        counts: dict[str, NDArray[np.integer]] = {
            name: self._worlds.read(field).reshape(1, -1).astype(np.int64)
            for name, field in ((CONTACTS.name, "ncon"), (CONSTRAINT_ROWS.name, "nefc"))
        }
        if (misplaced := self._worlds.misplaced()) is not None:
            counts[MISPLACED_CONTACTS.name] = misplaced[None]
        return Evidence(counts, (fired << np.arange(len(_DROPPED))).sum(axis=1, dtype=np.uint32)[None])

    def gates(self) -> list[str]:
        """See Simulator.gates; every MuJoCo warning is a gate, except for the warnings that are overflow bits."""
        self._count_warnings()
        risen, self._risen = self._risen, np.zeros_like(self._risen)
        fired = []
        for kind, name in enumerate(self._warnings):
            envs = np.flatnonzero(risen[:, kind])
            if envs.size and name not in _DROPPED:
                fired.append(f"MuJoCo warning {name}: {int(risen[:, kind].sum())} times, first in env {envs[0]}")
        return fired

    def _count_warnings(self) -> None:
        counts = self._worlds.warnings()
        risen = np.maximum(counts - self._warned, 0)  # releases without autoreset="disable" clear counters
        self._risen += risen
        self._dropping += risen
        self._warned = counts
