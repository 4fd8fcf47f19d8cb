"""Options of ManiSkill: PhysX's, with ManiSkill's own defaults."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.recorder.options import one_of
from gpusimbench.recorder.simulators.sapien.options import SapienOptions


@dataclass(frozen=True)
class ManiSkillOptions(SapienOptions):
    """Options of PhysX, with what ManiSkill's SimConfig and SceneConfig have for them.

    device                auto (as ManiSkill chooses: the CPU for one environment, a GPU for more), cpu or cuda
    angular_damping       ManiSkill sets none, so that PhysX's default is in force
    max_angular_velocity  the same
    """

    device: str = "auto"
    solver_position_iterations: int = 15
    solver_velocity_iterations: int = 1
    bounce_threshold: float = 2.0
    contact_offset: float = 0.02
    rest_offset: float = 0.0
    sleep_threshold: float = 0.005
    angular_damping: float = 0.05
    max_angular_velocity: float = 100.0

    def _check_device(self) -> None:
        one_of("device", self.device, ("auto", "cpu", "cuda"))

    def chosen_device(self, n_env: int) -> str:
        """The kind of device that steps so many environments: "cpu" or "cuda"."""
        if self.device == "auto":
            return "cuda" if n_env > 1 else "cpu"
        return self.device
