"""Options of MuJoCo Warp, and its levels of determinism."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.recorder.options import MEASURED, require
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions

LEVELS = {
    "default": "the engine as it ships: opt.deterministic is NONE",
    "off": "opt.deterministic NONE, whatever the engine's default",
    "contacts": "opt.deterministic CONTACTS: contacts are sorted",
    "constraint": "opt.deterministic CONSTRAINT: constraint rows have a canonical order",
    "contacts-constraint": "both of these",
    "atomics": "opt.deterministic ATOMICS: sums by atomic operations have a fixed order",
    "run-to-run": "opt.deterministic ALL: the three together",
    "warp-run-to-run": "warp.config.deterministic RUN_TO_RUN for all kernels, opt.deterministic NONE",
    "gpu-to-gpu": "opt.deterministic ALL and warp.config.deterministic GPU_TO_GPU",
}
"""By level, what it sets."""

SETTINGS = {
    "default": ((), "off"),
    "off": (("NONE",), "off"),
    "contacts": (("CONTACTS",), "off"),
    "constraint": (("CONSTRAINT",), "off"),
    "contacts-constraint": (("CONTACTS", "CONSTRAINT"), "off"),
    "atomics": (("ATOMICS",), "off"),
    "warp-run-to-run": (("NONE",), "run-to-run"),
    "run-to-run": (("ALL",), "off"),
    "gpu-to-gpu": (("ALL",), "gpu-to-gpu"),
}
"""By level, bits of opt.deterministic (mujoco_warp.DeterminismType), and warp.config.deterministic."""


@dataclass(frozen=True)
class WarpOptions(MjcfOptions):
    """Options of MuJoCo Warp.

    device   auto (the first GPU that CUDA shows, else the CPU), cpu or cuda
    nconmax  contacts (and candidate pairs) per env, in a pool that all environments share; 0: measured
    njmax    constraint rows per env; 0: measured
    """

    device: str = "auto"
    nconmax: int = 0
    njmax: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, MEASURED, "nconmax", "njmax")
