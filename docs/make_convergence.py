"""Records engines at several time steps, and draws their orders of convergence into docs/physics.md.

usage: python docs/make_convergence.py FOLDER

What FOLDER has already is not recorded again. An engine that is not installed has no row.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.report.sections.convergence import said
from gpusimbench.evaluator.results.convergence import Convergence
from gpusimbench.evaluator.results.evaluate import evaluate_files

PAGE = Path(__file__).resolve().parent / "physics.md"
BEGIN, END = "<!-- convergence: docs/make_convergence.py -->", "<!-- end of convergence -->"
SECONDS = {"pendulum": 1.0, "free-fall": 0.2}
STEPS = (0.02, 0.01, 0.005, 0.0025, 0.00125)
ENVS = 16
SPEED = 2.0
"""Standard deviation of the angular velocities [rad/s] that the pendulums begin with."""

_MUJOCO = tuple(("--option", f"integrator={name}") for name in ("Euler", "implicitfast", "RK4"))
_RUNS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    *(("pendulum", "mujoco", options) for options in _MUJOCO),
    *(("pendulum", "warp", options) for options in _MUJOCO),
    *(("pendulum", "mjx", ("--impl", "jax", *options)) for options in _MUJOCO),
    *(
        ("free-fall", name, options)
        for name, options in (
            ("mujoco", ()), ("warp", ()), ("mjx", ("--impl", "jax")), ("newton", ()), ("newton", ("--solver", "xpbd")),
            ("brax", ()), ("genesis", ()), ("physx", ()), ("sapien", ()),
        )
    ),
)  # fmt: skip

PENDULUM = """
<mujoco>
  <option timestep="0.01"><flag contact="disable"/></option>
  <worldbody>
    <body pos="0 0 1">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A physical pendulum without friction."""


def record(folder: Path) -> None:
    """Record what is not there yet; an engine that fails at its first step is left out at the others."""
    model = folder / "pendulum.xml"
    model.parent.mkdir(parents=True, exist_ok=True)
    model.write_text(PENDULUM, encoding="utf-8")
    for scene, simulator, options in _RUNS:
        for dt in STEPS:
            steps = round(SECONDS[scene] / dt)
            name = "-".join([scene, simulator, *(o.replace("=", "-").strip("-") for o in options), f"{dt:g}"])
            if list((folder / name).glob("*.mcap")):
                continue
            command = [sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", simulator, *options]
            command += ["--dt", f"{dt:g}", "--steps", f"{steps}", "--stride", f"{steps}", "--no-view"]
            command += ["--runs", "1", "--phases", "capture", "--out", str(folder / name)]
            if scene == "pendulum":
                command += ["--model", str(model), "--n-env", f"{ENVS}", "--initial", f"random:{SPEED:g}"]
            else:
                command += ["--scene", scene, "--n-env", "1"]
            done = subprocess.run(command, check=False, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
            print(f"{name}: exit code {done.returncode}", flush=True)
            if done.returncode:
                break


def table(folder: Path) -> str:
    """A row for each engine and scene."""
    lines = [
        "| scene | engine | error by step | order [95 %] | local orders | |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for scene, seconds in SECONDS.items():
        files = sorted(folder.glob(f"{scene}-*/*.mcap"))
        lines += [row(one) for one in evaluate_files(files, sample_time=seconds).convergences]
    return "\n".join(lines)


def row(one: Convergence) -> str:
    """Errors, order and local orders of an engine, or why there is no order."""
    where = f"| {one.scene}, {one.what} [{one.unit}] at {one.time:g} s | {one.label}"
    if isinstance(one.found, Missing):
        return f"{where} | | | | {one.found.reason} |"
    order = one.found
    errors = ", ".join(f"{e:.2g} at {1000 * dt:g} ms" for dt, e in zip(order.steps, order.errors, strict=True))
    local = ", ".join(f"{p:.2f}" for p in order.local)
    return f"{where} | {errors} | {said(one)} | {local} | {'' if order.asymptotic else 'not in the asymptotic range'} |"


def main() -> None:
    """Record, and write the table into the page."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    folder = Path(sys.argv[1]).resolve()
    record(folder)
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    PAGE.write_text(f"{head}{BEGIN}\n{table(folder)}\n{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
