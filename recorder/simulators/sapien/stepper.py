"""What simulators on SAPIEN have in common: the loops around their environments."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.sapien.complaints import Complaints
from gpusimbench.recorder.simulators.sapien.cpu import CpuWorlds
from gpusimbench.recorder.simulators.sapien.deviations import deviations
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.recorder.simulators.sapien.settings import library, modification, sha256
from gpusimbench.recorder.simulators.sapien.worlds import Worlds
from gpusimbench.recorder.simulators.snapshot import Envs, Snapshot, StateClaims, absent, partial, picked
from gpusimbench.schemas.provenance import MODIFIED

LEVELS = {
    "default": "PhysX as it ships, without enhanced determinism",
    "enhanced": "PhysX's enhanced determinism (enable_enhanced_determinism): bodies that do not meet do not influence "
    "each other, in whatever order they were added",
}


@dataclass(frozen=True)
class Made:
    """Environments that are ready to step, and what is to be said of them.

    version   of the engine that the user asked for
    switches  beside those of PhysX
    keep      what must live as long as they do
    """

    worlds: Worlds
    version: str
    switches: dict[str, Any]
    keep: tuple[Any, ...] = ()


class SapienStepper(Simulator):
    """N environments that PhysX steps through SAPIEN."""

    determinism_levels = LEVELS

    _complaints: Complaints | None = None

    @abstractmethod
    def make(self, complaints: Complaints) -> Made:
        """The environments; UsageError where they cannot be had."""

    def build(self) -> Description:
        """See Simulator.build."""
        import sapien
        from sapien import physx

        complaints = self._complaints = Complaints()
        made = self._made = self.make(complaints)
        worlds = self._worlds = made.worlds
        self._done = 0  # steps since the build
        options: SapienOptions = self.options
        buffers = {buffer.name: buffer.asked for buffer in worlds.buffers} if worlds.device != "cpu" else None
        digest = sha256(library())
        modified = modification(sapien.__version__, physx.version(), digest)
        return Description(
            version=made.version,
            device=worlds.device,
            options=options.in_force("cpu" if worlds.device == "cpu" else "cuda", buffers),
            switches={
                "precision": "float32",
                "determinism": self.determinism,
                "enable_enhanced_determinism": self.enhanced,
                "physx": physx.version(),
                "libsapien_sha256": digest,
                **({MODIFIED: modified} if modified else {}),
                **made.switches,
            },
            deviations=deviations(self.scene, options),
            fields=worlds.fields,
            timing_covers=worlds.timing_covers,
            env_origins=worlds.env_origins,
            buffers=worlds.buffers,
            counters=worlds.counters,
            overflow_bits=worlds.overflow_bits,
        )

    @property
    def enhanced(self) -> bool:
        """Whether PhysX's enhanced determinism is asked for."""
        return self.determinism == "enhanced"

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        self._worlds.prepare(actions)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        self._worlds.advance(n_step)
        self._done += n_step

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        return None if self.scene.actions is None else self._worlds.applied()

    def state(self) -> States:
        """See Simulator.state."""
        return self._worlds.state()

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        self._done += n_step
        return self._worlds.record(n_step)

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        if options.device != "cpu":
            return StateClaims(*(absent("written for SAPIEN's environments on the CPU alone") for _ in range(4)))
        return StateClaims(*(partial("contacts and friction anchors that PhysX keeps to itself") for _ in range(4)))

    @property
    def _on_cpu(self) -> CpuWorlds:
        assert isinstance(self._worlds, CpuWorlds)  # nothing is claimed elsewhere
        return self._worlds

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._done, self._on_cpu.kept())

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._on_cpu.put(picked(snapshot.arrays, envs), envs)
        if envs is None:
            self._done = snapshot.step

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: PhysxCpuSystem.unpack of the first state."""
        self._on_cpu.begin(envs)
        if envs is None:
            self._done = 0

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: PhysxCpuSystem.unpack of the first state with these poses and velocities."""
        self._on_cpu.place(states, envs)
        if envs is None:
            self._done = 0

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        return self._worlds.evidence()

    def gates(self) -> list[str]:
        """See Simulator.gates; whatever PhysX complains of is a gate."""
        return [] if self._complaints is None else self._complaints.take_sentences()

    def close(self) -> None:
        """See Simulator.close."""
        for name in ("_worlds", "_made"):
            vars(self).pop(name, None)
        if self._complaints is not None:
            self._complaints.close()
