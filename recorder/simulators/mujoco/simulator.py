"""MuJoCo C on the CPU: the embedded default and the float64 reference.

Environments are the simulations of one ``mujoco.batch.Batch``, stepped on a pool of threads; MuJoCo promises results
that are bit-identical to a loop over one MjData each, at any number of threads.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS
from gpusimbench.recorder.scenes.emit.mjcf import deviations
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.counters import CONSTRAINT_ROWS, CONTACTS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.mujoco.options import STATE_COMPONENTS, MjcfOptions
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims


@dataclass(frozen=True)
class MujocoOptions(MjcfOptions):
    """Options of MuJoCo C.

    threads    0: as many as the process may use
    """

    threads: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads < 0:
            raise ValueError("threads is 0 (all that the process may use) or a positive number")


class MujocoC(Simulator):
    """N environments on MuJoCo C."""

    Options = MujocoOptions
    abilities = BODIES | ROBOTS

    def build(self) -> Description:
        """See Simulator.build."""
        import mujoco
        from mujoco.batch import Batch

        from gpusimbench.recorder.simulators.mujoco.model import compile_scene

        options: MujocoOptions = self.options
        compiled = self._compiled = compile_scene(self.scene, dt=self.dt, options=options)
        self._warnings = [mujoco.mjtWarning(kind).name for kind in range(int(mujoco.mjtWarning.mjNWARNING))]
        threads = options.threads or len(os.sched_getaffinity(0))
        self._batch = Batch(compiled.model, nsim=self.n_env, nthread=threads)
        self._batch.reset()
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._qpos[:], self._qvel[:] = compiled.qpos0, compiled.qvel0
        self._contacts = self._batch.bind("ncon")
        self._rows = self._batch.bind("nefc")
        self._counts: NDArray[np.int64] | None = None  # of the last states; None: to be counted when asked
        self._warned = np.zeros((self.n_env, len(self._warnings)), dtype=np.int64)
        self._risen = np.zeros_like(self._warned)  # since gates were asked
        self._actions: NDArray[np.float32] | None = None
        self._next_action = 0
        self._made = 0  # steps since the build
        if self.scene.actions is not None:
            self._ctrl = self._batch.bind("ctrl")
        return Description(
            version=mujoco.__version__,
            device="cpu",
            options={**compiled.in_force(options, "mujoco"), "threads": threads},
            switches={"precision": "float64"},
            deviations=deviations(self.scene),
            fields=compiled.fields("float64"),
            timing_covers="Batch.step of all environments on all threads; no state is copied, nothing is drawn",
            attachments=compiled.attachments,
            counters=(CONTACTS, CONSTRAINT_ROWS),
        )

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        self._actions = actions
        self._next_action = 0

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        self._counts = None
        self._made += n_step
        if self._actions is None:
            self._batch.step(nstep=n_step)
            return
        for _ in range(n_step):
            self._ctrl[:] = self._actions[self._next_action]  # in double precision, which holds every float32
            self._next_action += 1
            self._batch.step()

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        return None if self.scene.actions is None else np.asarray(self._ctrl).astype(np.float32)

    def state(self) -> States:
        """See Simulator.state."""
        return self._compiled.split(self._qpos.copy(), self._qvel.copy())

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims; the components of mjSTATE_INTEGRATION are all that mj_step reads."""
        return StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE)

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._made, {name: np.array(self._batch.bind(name)) for name in STATE_COMPONENTS})

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        for name in STATE_COMPONENTS:
            rows = slice(None) if envs is None else envs
            self._batch.bind(name)[rows] = snapshot.arrays[name][rows]
        if envs is None:
            self._made = snapshot.step
        self._counts = None

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: Batch.reset, then the scene's initial velocities."""
        self._begin(self._compiled.qpos0, self._compiled.qvel0, envs)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: Batch.reset, then positions and velocities."""
        self._begin(*self._compiled.joined(states), envs)

    def _begin(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], envs: Envs) -> None:
        self._count_warnings()  # a reset clears those of its environments
        self._batch.reset(ids=envs)
        self._warned = self._warnings_so_far()
        rows = slice(None) if envs is None else envs
        self._qpos[rows], self._qvel[rows] = qpos, qvel
        if envs is None:
            self._made = 0
        self._counts = None

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        # Not Batch.rollout: it stops a simulation whose warning counters rise and repeats its last state.
        qpos = np.empty((n_step, *self._qpos.shape))
        qvel = np.empty((n_step, *self._qvel.shape))
        counts = []
        for k in range(n_step):
            self.step(1)
            qpos[k] = self._qpos
            qvel[k] = self._qvel
            counts.append(self._count())
        self._counts = np.concatenate(counts)
        return self._compiled.split(qpos, qvel)

    def _count(self) -> NDArray[np.int64]:
        # [row, counter, env]
        pair = (np.asarray(self._contacts).reshape(-1), np.asarray(self._rows).reshape(-1))
        return np.array(pair, dtype=np.int64)[None]

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        counts = self._count() if self._counts is None else self._counts
        return Evidence({CONTACTS.name: counts[:, 0], CONSTRAINT_ROWS.name: counts[:, 1]})

    def gates(self) -> list[str]:
        """See Simulator.gates; every MuJoCo warning is a gate."""
        self._count_warnings()
        risen, self._risen = self._risen, np.zeros_like(self._risen)
        fired = []
        for kind in range(risen.shape[1]):
            envs = np.flatnonzero(risen[:, kind])
            if envs.size:
                name = self._warnings[kind]
                fired.append(f"MuJoCo warning {name}: {int(risen[:, kind].sum())} times, first in env {envs[0]}")
        return fired

    def _warnings_so_far(self) -> NDArray[np.int64]:
        # [env, kind]
        return np.asarray(self._batch.warning)[:, :, 1].astype(np.int64)

    def _count_warnings(self) -> None:
        counts = self._warnings_so_far()
        self._risen += counts - self._warned
        self._warned = counts
