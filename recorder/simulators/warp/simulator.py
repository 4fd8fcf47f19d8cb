"""MuJoCo Warp: MuJoCo's physics in Warp kernels, on a GPU or, slowly, on the CPU.

On a GPU one step is captured as a CUDA graph and replayed. Actions are drawn on the device as part of it. For a
capture, further graphs copy the state and what the engine counts into one of a few rings on the device after each step;
while one ring is filled, the one before it is copied to the host.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, VARIED, Ability
from gpusimbench.recorder.failure import Refused, cause_of
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.evidence import (
    CONSTRAINT_ROWS,
    CONTACTS,
    MISPLACED_CONTACTS,
    SOLVER_ITERATIONS,
    Evidence,
)
from gpusimbench.recorder.simulators.flight import Flight, Watch
from gpusimbench.recorder.simulators.mujoco.options import replacement
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots, Slotted
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims, picked
from gpusimbench.recorder.simulators.warp import runtime as warp_runtime
from gpusimbench.recorder.simulators.warp import worlds
from gpusimbench.recorder.simulators.warp.flight import WarpFlight
from gpusimbench.recorder.simulators.warp.options import LEVELS, SETTINGS, WarpOptions
from gpusimbench.recorder.simulators.warp.runtime import DeviceActions
from gpusimbench.recorder.simulators.warp.transfer import COUNTED, WarpSlots, count_misplaced, evidence_of
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Buffer, OverflowBit

_HARMLESS = ("ITERATIONS", "LS_ITERATIONS")  # a limit was reached, nothing was dropped


class MujocoWarp(Slotted):
    """N environments, the worlds of one mujoco_warp.Data."""

    Options = WarpOptions
    distribution = "mujoco-warp"
    abilities = BODIES | ROBOTS | {Ability.CHAINS, Ability.LOOPS, Ability.MODELS, *VARIED.values()}
    timing_interval = 10
    draws_actions = True
    blocks_ahead = 2
    determinism_levels = LEVELS

    def build(self) -> Description:
        """See Simulator.build."""
        options: WarpOptions = self.options
        bits, mode = SETTINGS[self.determinism]
        if "mujoco_warp" in sys.modules and not warp_runtime.has_mode(mode):
            raise GsbError("Warp's determinism mode must be chosen before MuJoCo Warp is imported: use a fresh process")
        self._device = warp_runtime.start(options.device, mode)
        import mujoco
        import mujoco_warp as mjw
        import warp as wp

        from gpusimbench.recorder.simulators.buffer_sizes import measure
        from gpusimbench.recorder.simulators.mujoco.model import compile_scene, compile_varied, raised_tolerance

        compiled = self._compiled = compile_scene(self.scene, dt=self.dt, options=options)
        need = measure(compiled, dt=self.dt, seed=self.seed, varied=self.variation is not None)
        self._nconmax = options.nconmax or need.size(need.pool)
        self._njmax = options.njmax or need.size(need.rows)
        self._fatal = sum(int(bit) for bit in mjw.OverflowType if bit.name not in (*_HARMLESS, "NONE", "ALL"))
        # the engine never resets a world that went bad, and does not know the flag that forbids it
        compiled.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        models = compile_varied(self.scene, self.variation, n_env=self.n_env, dt=self.dt, options=options)
        self._model = self._try(lambda: worlds.put_model(compiled.model, models))
        self._model.opt.warn_overflow = 0  # the bits are recorded; printing them at every step would fill the log
        if bits:
            self._model.opt.deterministic = sum(int(mjw.DeterminismType[bit]) for bit in bits)
        self._data = self._try(lambda: self._new_data(self.n_env))
        actions = self.scene.actions
        self._drawn = None if actions is None else DeviceActions(actions, self.seed, self.streams)
        self._row = wp.zeros(1, dtype=wp.int32)
        self._graphs: dict[str, Any] = {}
        return Description(
            version=mjw.__version__,
            device=warp_runtime.name_of(self._device),
            options={
                **compiled.in_force(options, "warp"),
                "graph_conditional": bool(self._model.opt.graph_conditional),
            },
            switches={
                "precision": "float32",
                "determinism": self.determinism,
                "opt.deterministic": mjw.DeterminismType(self._model.opt.deterministic).name,
                "warp.config.deterministic": wp.config.deterministic.name,
                "warp": wp.config.version,
                "mujoco": version("mujoco"),
            },
            deviations=(
                *compiled.deviations,
                *raised_tolerance(compiled.model.opt.tolerance, float(self._model.opt.tolerance.numpy()[0])),
            ),
            fields=compiled.fields("float32"),
            timing_covers=self._covers(),
            attachments=compiled.attachments,
            buffers=(
                Buffer("nconmax", self._nconmax, "env", CONTACTS.name, self._sized(options.nconmax, need, need.pool)),
                Buffer("naconmax", self._data.naconmax, "all", CONTACTS.name, "nconmax times the environments"),
                Buffer("njmax", self._njmax, "env", CONSTRAINT_ROWS.name, self._sized(options.njmax, need, need.rows)),
            ),
            counters=(CONTACTS, CONSTRAINT_ROWS, SOLVER_ITERATIONS, MISPLACED_CONTACTS),
            overflow_bits=tuple(
                OverflowBit(int(bit).bit_length() - 1, bit.name, bit.name not in _HARMLESS)
                for bit in mjw.OverflowType
                if bit.name not in ("NONE", "ALL")
            ),
        )

    def _sized(self, asked: int, need: Any, needed: int) -> str:
        return "asked for" if asked else str(need.sized_by(needed))

    def _covers(self) -> str:
        how = "replay of one CUDA graph a step" if self._device.is_cuda else "one call of mujoco_warp.step a step"
        drawn = "; the graph draws the actions too" if self.scene.actions is not None else ""
        return f"{how}, {self.timing_interval} steps between two synchronisations{drawn}; nothing is copied"

    def _try(self, work: Callable[[], Any]) -> Any:
        # what the engine does not do, under a determinism level or for a model, is an outcome, not a crash
        try:
            return work()
        except (RuntimeError, ValueError, NotImplementedError) as error:
            text = " ".join(str(error).split())
            if cause_of(error) == "DEVICE_MEMORY":
                raise
            if self.determinism != "default":
                asked = f"determinism '{self.determinism}' for this scene"
                raise Refused(f"MuJoCo Warp refuses {asked}: {text}") from None
            if isinstance(error, NotImplementedError):
                said = f"MuJoCo Warp does not take this scene: {text.rstrip('.')}"
                raise Refused(f"{said}{replacement(said)}") from None
            raise

    def _new_data(self, n_env: int) -> Any:
        import mujoco_warp as mjw

        data = mjw.make_data(self._compiled.model, nworld=n_env, nconmax=self._nconmax, njmax=self._njmax)
        data.qpos.assign(np.tile(self._compiled.qpos0.astype(np.float32), (n_env, 1)))
        data.qvel.assign(np.tile(self._compiled.qvel0.astype(np.float32), (n_env, 1)))
        return data

    def compile(self, phase: str) -> None:
        """See Simulator.compile: builds the kernels on one throw-away environment, then captures the graph."""
        if phase in self._graphs:
            return
        import mujoco_warp as mjw
        import warp as wp

        if not self._graphs:
            spare = self._new_data(1)
            self._try(lambda: (mjw.step(self._model, spare), wp.synchronize_device(self._device)))
            del spare
        if phase == "timed":
            self._graphs[phase] = self._captured(self._one_step)
        elif phase == "capture":
            spare = self._new_slots(1).take()
            self._snapshot(spare)  # builds its kernels
            self._row.zero_()
            self._data.overflow.zero_()
            self._graphs[phase] = None  # captured with the slots, whose size is known when states are asked for

    def reserve(self, n_step: int) -> None:
        """See Simulator.reserve."""
        self.compile("capture")
        if self._slots is not None and self._slots.rows >= n_step:
            return
        self._slots = self._new_slots(n_step)
        self._recording = {
            id(slot): self._captured(lambda slot=slot: self._step_and_snapshot(slot))  # type: ignore[misc]
            for slot in self._slots.all
        }

    def _new_slots(self, rows: int) -> WarpSlots:
        data = self._data
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {
            "qpos": ((rows, *data.qpos.shape), float),
            "qvel": ((rows, *data.qvel.shape), float),
            "counts": ((rows, COUNTED, self.n_env), int),
        }
        if self.scene.actions is not None:
            shapes["ctrl"] = ((rows, *data.ctrl.shape), float)
        return WarpSlots(self._device, shapes)

    def _captured(self, work: Callable[[], None]) -> Any:
        if not self._device.is_cuda:
            return work
        import warp as wp

        def capture() -> Any:
            with wp.ScopedCapture(self._device) as captured:
                work()
            return captured.graph

        graph = self._try(capture)
        return lambda: wp.capture_launch(graph)

    def _one_step(self) -> None:
        import mujoco_warp as mjw

        if self._drawn is not None:
            self._drawn.enqueue(self._data.ctrl)
        mjw.step(self._model, self._data)

    def _snapshot(self, slot: Slot) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        for name in (name for name in slot.arrays if name != "counts"):
            values = getattr(self._data, name)
            wp.launch(kernels.snapshot, dim=values.shape, inputs=[self._row, values], outputs=[slot.arrays[name]])
        self._snapshot_counts(slot.arrays["counts"])
        wp.launch(kernels.advance, dim=1, inputs=[self._row])

    def _snapshot_counts(self, counts: Any) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        data = self._data
        wp.launch(
            kernels.snapshot_counts,
            dim=self.n_env,
            inputs=[self._row, data.nefc, data.solver_niter, data.overflow],
            outputs=[counts],
        )
        wp.launch(
            kernels.count_contacts,
            dim=data.contact.worldid.shape[0],
            inputs=[self._row, data.nacon, data.contact.worldid],
            outputs=[counts],
        )
        count_misplaced(self._model, data, self._row, counts[:, 4])

    def _step_and_snapshot(self, slot: Slot) -> None:
        self._one_step()
        self._snapshot(slot)

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare: the graph draws the actions, by the streams as they are now."""
        if self._drawn is not None:
            self._drawn.follow(self.streams)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        import warp as wp

        self.compile("timed")
        self._counted = None
        one = self._graphs["timed"]
        for _ in range(n_step):
            one()
        wp.synchronize_device(self._device)

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        if self.scene.actions is None:
            return None
        applied: NDArray[np.float32] = self._data.ctrl.numpy()
        return applied

    def state(self) -> States:
        """See Simulator.state."""
        return self._compiled.split(self._data.qpos.numpy().copy(), self._data.qvel.numpy().copy())

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        return StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE)

    def imported(self) -> Imported:
        """See Simulator.imported."""
        from gpusimbench.recorder.simulators.mujoco.imported import imported

        return imported(self._compiled.model, worlds.reader(self._model), "MuJoCo Warp")

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See Simulator.link_poses: mujoco_warp.kinematics."""
        import mujoco_warp as mjw

        mjw.kinematics(self._model, self._data)
        return self._data.xpos.numpy().copy(), self._data.xquat.numpy().copy()

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        self._data.ctrl.assign(controls.astype(np.float32))

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        step = 0 if self._drawn is None else int(self._drawn.step.numpy()[0])
        return Snapshot(step, worlds.kept(self._data))

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        worlds.assign(self._data, picked(snapshot.arrays, envs), envs)
        if envs is None and self._drawn is not None:
            self._drawn.step.fill_(snapshot.step)
        self._counted = None

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: mujoco_warp.reset_data, then the scene's initial positions and velocities."""
        self._begin(self._compiled.qpos0, self._compiled.qvel0, envs)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: mujoco_warp.reset_data, then positions and velocities."""
        self._begin(*self._compiled.joined(states), envs)

    def _begin(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], envs: Envs) -> None:
        worlds.reset(self._model, self._data, envs)
        worlds.assign(self._data, {"qpos": qpos, "qvel": qvel}, envs)
        if envs is None and self._drawn is not None:
            self._drawn.step.zero_()
        self._counted = None

    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> SlotBlock:
        one = self._recording[id(slot)]
        self._row.zero_()
        for _ in range(n_step):
            one()
        slots.begin_copy(slot, n_step)
        compiled = self._compiled
        return SlotBlock(
            slots, slot, n_step,
            split=lambda host, envs: compiled.split(host("qpos")[:, envs], host("qvel")[:, envs]),
            told=lambda host: evidence_of(host("counts")), held="ctrl",
        )  # fmt: skip

    def flight(self, watch: Watch) -> Flight:
        """See Simulator.flight."""
        self.compile("capture")
        return WarpFlight(self._device, self._data, self._compiled, watch, self._one_step, self._captured)

    def evidence(self) -> Evidence:
        """See Simulator.evidence; MuJoCo Warp itself gathers overflow bits over steps."""
        if self._counted is None:
            import warp as wp

            counts = wp.empty((1, COUNTED, self.n_env), dtype=int)
            self._row.zero_()
            self._snapshot_counts(counts)
            return evidence_of(counts.numpy())
        return self._counted

    def allocator_bytes(self) -> tuple[int, int] | None:
        """See Simulator.allocator_bytes."""
        return warp_runtime.allocator_bytes(self._device)

    def close(self) -> None:
        """See Simulator.close."""
        for name in list(vars(self)):
            if name.startswith(("_data", "_model", "_slots", "_recording", "_graphs")):
                delattr(self, name)
