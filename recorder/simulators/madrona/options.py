"""Options of the adapter of Madrona."""

from __future__ import annotations

import os
from dataclasses import dataclass

from gpusimbench.recorder.options import require

VARIABLE = "GSB_MADRONA_MODULE"
"""Environment variable with the module's import name, for when the option `module` is not given."""


@dataclass(frozen=True)
class MadronaOptions:
    """Options of Madrona.

    module        import name of your simulator module; empty: what GSB_MADRONA_MODULE says
    device        cpu, cuda (the first GPU) or cuda:N
    num_substeps  of the solver in a step; 0: as many as the module has by itself
    """

    module: str = ""
    device: str = "cpu"
    num_substeps: int = 0

    def __post_init__(self) -> None:
        kind, colon, index = self.device.partition(":")
        if self.device not in ("cpu", "cuda") and not (kind == "cuda" and colon and index.isdecimal()):
            raise ValueError(f"device is cpu, cuda or cuda:N, not '{self.device}'")
        require(self, (lambda v: v >= 0, "0 (the module's own) or more"), "num_substeps")

    @property
    def gpu(self) -> int | None:
        """Number of the GPU that is asked for; None for the CPU."""
        return None if self.device == "cpu" else int(self.device.partition(":")[2] or 0)

    def module_name(self) -> str:
        """The module's import name, of the option or else of the environment; empty where neither names one."""
        return self.module or os.environ.get(VARIABLE, "")
