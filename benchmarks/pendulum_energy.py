"""How much energy a swinging rod gains in PhysX, by solver, iterations and how gravity is applied.

A frictionless pendulum keeps its energy. With TGS, an articulation's step of i position iterations moves the joint by
v dt + a dt^2 (i + 1) / (2 i) and its speed by a dt, with the acceleration a of the beginning of the step. For small
oscillations of angular frequency w, the determinant of that map is 1 + (w dt)^2 (i - 1) / (2 i) instead of 1, so that
ln(energy) grows by (i - 1) / (2 i) times (w dt)^2 a step. If that is the cause, the measured growth of ln(energy) over
(i - 1) / (2 i) is the same number for every i, but for the amplitude, which lowers w as it grows.

    python -m benchmarks.pendulum_energy        the table of docs/physics/engines.md; needs the environment of PhysX
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from gpusimbench.evaluator.results.canonical import Law
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.recorder import cli

CASES: tuple[tuple[str, ...], ...] = (
    *((f"position_iterations={i}",) for i in (1, 2, 4, 8, 16)),
    ("external_forces_every_iteration=false",),
    ("solver=PGS",),
)
DEFAULT = 16  # position iterations


def measured(options: tuple[str, ...], folder: Path) -> tuple[float, float, float]:
    """Period [s], the period that the law predicts [s], and the energy gained from the first to the last period, over
    that of the first."""
    asked = ["--sim", "physx", "--scene", "pendulum", "--n-env", "4", "--runs", "1", "--phases", "capture"]
    asked += [f"--option={option}" for option in ("device=cpu", *options)]
    code = cli.main([*asked, "--initial", "random:0.01", "--no-view", "--out", str(folder)])
    assert code == 0, f"gsb-record ended with {code}"
    [group] = evaluate_files(sorted(folder.glob("*.mcap"))).results
    period, energy = (law for law in group.laws if isinstance(law, Law))
    assert period.predicted is not None
    return period.measured, period.predicted, energy.measured


def main() -> None:
    """Print the table."""
    print("| options | period [s] | energy gained | growth of ln(energy) over (i - 1) / (2 i) |")
    print("| --- | ---: | ---: | ---: |")
    for options in CASES:
        with tempfile.TemporaryDirectory() as folder:
            period, predicted, gained = measured(options, Path(folder))
        named = dict(option.split("=") for option in options)
        i = int(named.get("position_iterations", DEFAULT))
        share = (i - 1) / (2 * i)
        ratio = f"{math.log1p(gained) / share:.2f}" if share and "position_iterations" in named else "-"
        print(f"| `{' '.join(options)}` | {period:.4f} | {100 * gained:.3g} % | {ratio} |", flush=True)
    print(f"\nPredicted period: {predicted:.4f} s.")


if __name__ == "__main__":
    main()
