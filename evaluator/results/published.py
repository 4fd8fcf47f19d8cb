"""Figures of the GPUSimBench paper, for display beside results and never as results.

Source: GPUSimBench, RTX 5070, published. The machine was one RTX 5070 12 GB with an i5-13400F and 32 GB of memory; the
simulators are those of `SIMULATOR_VERSIONS`. Nothing here was measured by this project, nor does it enter a metric.
"""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = "GPUSimBench, RTX 5070, published"
MACHINE = "RTX 5070 12 GB, i5-13400F, 32 GB"

SIMULATOR_VERSIONS = {
    "Isaac Lab": "2.2.1",
    "ManiSkill": "3.0.0b22",
    "Madrona": "main",
    "Genesis": "0.3.11",
    "MuJoCo Warp": "main",
    "MJX": "MuJoCo 3.4.0",
    "Playground": "0.1.0",
}


NAMES = {
    "genesis": "Genesis",
    "isaaclab": "Isaac Lab",
    "madrona": "Madrona",
    "maniskill": "ManiSkill",
    "mjx": "MJX",
    "warp": "MuJoCo Warp",
    "playground": "Playground",
}
"""The paper's simulators, by their names in recordings."""


@dataclass(frozen=True)
class AtLargest:
    """Throughput and memory at the largest number of environments that a simulator sustained.

    n_env_max  environments
    fps        mean over successful runs [env-steps/s]
    memory_gb  GPU memory increment, mean over successful runs [GB]
    """

    n_env_max: int
    fps: float
    memory_gb: float


@dataclass(frozen=True)
class Scaling:
    """One simulator's row of the scaling table; None where the scene is not supported."""

    simulator: str
    free_fall: AtLargest | None
    franka: AtLargest | None


@dataclass(frozen=True)
class PublishedValue:
    """Mean and standard deviation [cm], and the decimals that both were printed with."""

    mean: float
    sd: float
    decimals: int

    def __str__(self) -> str:
        return f"{self.mean:.{self.decimals}f} ± {self.sd:.{self.decimals}f}"


@dataclass(frozen=True)
class Variability:
    """One simulator's row of the variability table, inclined collision, 16 environments, 10 runs.

    regime      published type, 1 to 4
    w1_real     distance to the real trials [cm]
    parallel    variability between environments [cm]
    run_to_run  variability between runs [cm]
    """

    regime: int
    simulator: str
    w1_real: PublishedValue
    parallel: PublishedValue
    run_to_run: PublishedValue


SCALING = (
    Scaling("Genesis", AtLargest(2**11, 2.234e4, 7.8), AtLargest(2**17, 11.124e6, 6.4)),
    Scaling("Isaac Lab", AtLargest(2**12, 47.189e4, 3.3), AtLargest(2**15, 1.851e6, 8.1)),
    Scaling("Madrona", AtLargest(2**18, 48.108e4, 9.5), None),
    Scaling("ManiSkill", AtLargest(2**12, 7.375e4, 8.3), AtLargest(2**15, 0.149e6, 8.3)),
    Scaling("MJX", AtLargest(2**9, 0.534e4, 10.6), AtLargest(2**19, 1.905e6, 10.6)),
    Scaling("MuJoCo Warp", AtLargest(2**11, 16.600e4, 5.9), AtLargest(2**19, 3.541e6, 9.8)),
    Scaling("Playground", AtLargest(2**8, 0.003e4, 8.9), AtLargest(2**17, 0.135e6, 10.3)),
)


def _row(regime: int, simulator: str, real: PublishedValue, *others: float) -> Variability:
    parallel, parallel_sd, between, between_sd = others
    return Variability(
        regime, simulator, real, PublishedValue(parallel, parallel_sd, 2), PublishedValue(between, between_sd, 2)
    )


VARIABILITY = (
    _row(1, "Isaac Lab", PublishedValue(5.4, 0.0, 3), 4.21, 0.0, 0.0, 0.0),
    _row(1, "ManiSkill", PublishedValue(2.52, 0.0, 3), 4.76, 0.0, 0.0, 0.0),
    _row(2, "Genesis", PublishedValue(4.78, 0.0, 3), 0.0, 0.0, 0.0, 0.0),
    _row(2, "MJX", PublishedValue(3.97, 0.0, 3), 0.0, 0.0, 0.0, 0.0),
    _row(3, "Madrona", PublishedValue(211.6, 2.22, 2), 32.53, 1.86, 11.47, 1.4),
    _row(3, "MuJoCo Warp", PublishedValue(4.23, 0.74, 3), 4.55, 1.39, 2.15, 0.82),
    _row(4, "Playground", PublishedValue(3.38, 0.11, 3), 0.0, 0.0, 1.39, 0.47),
)
