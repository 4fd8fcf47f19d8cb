"""The paper's figures in a terminal, marked as the paper's."""

from __future__ import annotations

from typing import IO

from gpusimbench.evaluator.render.console import make_console, plain_table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.results.published import SCALING, SOURCE, VARIABILITY, AtLargest


def print_published(stream: IO[str]) -> None:
    """Print both published tables; none of it was measured by this project."""
    console = make_console(stream)
    console.print(f"published figures, not results of this evaluation ({SOURCE})", style="bold")
    variability = plain_table("simulator", "type", "W1 to real [cm]", "between envs [cm]", "between runs [cm]")
    for row in VARIABILITY:
        variability.add_row(row.simulator, str(row.regime), str(row.w1_real), str(row.parallel), str(row.run_to_run))
    console.print(variability)
    console.print()
    console.print("published, at the largest number of environments", style="bold")
    scaling = plain_table("simulator", "free-fall envs", "env-steps/s", "GB", "franka envs", "env-steps/s", "GB")
    for at in SCALING:
        scaling.add_row(at.simulator, *_cells(at.free_fall), *_cells(at.franka))
    console.print(scaling)
    console.print()


def _cells(at: AtLargest | None) -> tuple[str, str, str]:
    if at is None:
        return ("not supported", NONE, NONE)
    return (f"{at.n_env_max:,}", f"{at.fps:,.0f}", f"{at.memory_gb:.1f}")
