"""Records engines at several time steps, and draws their orders of convergence into docs/physics/convergence.md.

usage: python docs/make_convergence.py FOLDER [SIMULATOR...]

What FOLDER has already is not recorded again; with names of simulators, no others are. An engine without recordings in
FOLDER keeps the row that the page has of it; an engine that refuses a scene has a row with its reason.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from page_blocks import block, redraw

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.report.sections.convergence import NOT_ASYMPTOTIC, said, said_locally, why_none
from gpusimbench.evaluator.results.convergence import Convergence
from gpusimbench.evaluator.results.evaluate import evaluate_files

PAGE = Path(__file__).resolve().parent / "physics" / "convergence.md"
SECONDS = {"pendulum": 1.0, "free-fall": 0.2, "ball-drop": 0.1}
"""When states are compared [s]; nothing has touched anything by then."""
STEPS = (0.02, 0.01, 0.005, 0.0025, 0.00125)
ENVS = {"pendulum": 16, "free-fall": 1, "ball-drop": 16}
SPREAD = 0.8  # of the angles [rad]
_TIME = 280  # for one recording [s]

_MUJOCO = {"Euler": 1, "implicitfast": 1, "RK4": 4}
"""Orders of the integrators, by MuJoCo's documentation (Computation, Numerical integration)."""


@dataclass(frozen=True)
class Engine:
    """A simulator with options on a scene.

    order  of the method, where its documentation or its source names it; None where neither was found to
    """

    scene: str
    simulator: str
    options: tuple[str, ...] = ()
    order: int | None = 1

    def folder(self, dt: float) -> str:
        """Of its recording at a step [s]."""
        given = (option.replace("=", "-").strip("-") for option in self.options)
        return "-".join([self.scene, self.simulator, *given, f"{dt:g}"])

    @property
    def label(self) -> str:
        """As rows name it."""
        options = " ".join(option for option in self.options if option != "--option").replace("--", "")
        return f"{self.simulator}{f' [{options}]' if options else ''}"


ENGINES: tuple[Engine, ...] = (
    *(
        Engine("pendulum", name, (*options, "--option", f"integrator={integrator}"), order)
        for name, options in (("mujoco", ()), ("warp", ()), ("mjx", ("--impl", "jax")))
        for integrator, order in _MUJOCO.items()
    ),
    # Genesis raises the time constant of constraints to two steps, which would make steps of different settings
    Engine("pendulum", "genesis", ("--option", "constraint_timeconst=0.04")),
    *(Engine("pendulum", name, order=None) for name in ("physx", "sapien")),
    *(Engine("pendulum", "newton", ("--solver", name)) for name in ("mujoco", "featherstone", "xpbd")),
    Engine("pendulum", "brax", ("--solver", "generalized")),
    *(Engine("free-fall", name) for name in ("mujoco", "warp")),
    Engine("free-fall", "mjx", ("--impl", "jax")),
    *(Engine("free-fall", "newton", ("--solver", name)) for name in ("mujoco", "featherstone", "xpbd")),
    Engine("free-fall", "genesis"),
    *(Engine("free-fall", name, order=None) for name in ("physx", "sapien")),
    # with the 27 cubes of free-fall, Brax's generalized solver takes minutes to compile
    *(Engine("ball-drop", "brax", ("--solver", name)) for name in ("generalized", "positional", "spring")),
)


def command(engine: Engine, dt: float, folder: Path) -> list[str]:
    """That records an engine at a step [s]: its states at the beginning and at the time that is compared."""
    steps = round(SECONDS[engine.scene] / dt)
    given = [sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", engine.simulator, *engine.options]
    given += ["--dt", f"{dt:g}", "--steps", f"{steps}", "--stride", f"{steps}", "--no-view", "--runs", "1"]
    given += ["--phases", "capture", "--out", str(folder / engine.folder(dt)), "--n-env", f"{ENVS[engine.scene]}"]
    if ENVS[engine.scene] > 1:
        given += ["--initial", f"random:{SPREAD:g}"]
    return [*given, "--scene", engine.scene]


def record(folder: Path, chosen: Sequence[str]) -> None:
    """Record what is not there yet; an engine that fails at its first step is left out at the others."""
    folder.mkdir(parents=True, exist_ok=True)
    for engine in ENGINES:
        refused = folder / f"{engine.folder(0)}.txt"
        for dt in STEPS:
            name = engine.folder(dt)
            if list((folder / name).glob("*.mcap")) or (chosen and engine.simulator not in chosen):
                continue
            try:
                done = subprocess.run(
                    command(engine, dt, folder), check=False, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
                    timeout=_TIME, text=True,
                )  # fmt: skip
                code, why = done.returncode, done.stderr.strip().rpartition("\n")[2]
            except subprocess.TimeoutExpired:
                code, why = -1, f"no recording within {_TIME} s"
            print(f"{name}: exit code {code}", flush=True)
            if code:
                reason = re.sub(r"^(gsb-record: |run 1/1 \w+ in [0-9.]+ s: )", "", why)
                refused.write_text(reason + "\n", encoding="utf-8")
                break
            refused.unlink(missing_ok=True)


def rows(folder: Path, earlier: Sequence[str] = ()) -> Iterator[str]:
    """A row for each engine and scene that was recorded, or that refused; of all others the earlier row, if any."""
    kept: dict[tuple[str, str], list[str]] = {}
    for line in earlier:
        where, label = (cell.strip() for cell in line.split("|")[1:3])
        kept.setdefault((where.partition(",")[0], label), []).append(line)
    for engine in ENGINES:
        files = [path for dt in STEPS for path in sorted((folder / engine.folder(dt)).glob("*.mcap"))]
        refused = folder / f"{engine.folder(0)}.txt"
        label = engine.label
        if refused.exists():
            yield f"| {engine.scene} | {label} | | | | | {refused.read_text(encoding='utf-8').strip()} |"
            continue
        found = evaluate_files(files, sample_time=SECONDS[engine.scene]).convergences if files else ()
        yield from [row(one, label, engine) for one in found] or kept.get((engine.scene, label), [])


def table(folder: Path, earlier: str = "") -> str:
    """All rows below their heads; `earlier` is the table that it replaces."""
    head = "| scene | engine | error at the longest step | order [95 %] | of the method | local orders | |"
    shown = rows(folder, earlier.strip().splitlines()[2:])
    return "\n".join([head, "| --- | --- | --- | --- | --- | --- | --- |", *shown])


def row(one: Convergence, label: str, engine: Engine) -> str:
    """Error, order and local orders of an engine, or why there is no order."""
    where = f"| {engine.scene}, {one.what} [{one.unit}] at {one.time:g} s | {label}"
    told = "-" if engine.order is None else f"{engine.order}"
    if isinstance(one.found, Missing):
        return f"{where} | | | {told} | | {'; '.join([one.found.reason, *one.left_out])} |"
    order = one.found
    errors = f"{order.errors[0]:.2g} at {1000 * order.steps[0]:g} ms"
    note = "" if order.asymptotic else why_none(one) or NOT_ASYMPTOTIC
    return f"{where} | {errors} | {said(one)} | {told} | {said_locally(order)} | {note} |"


def main() -> None:
    """Record, and write the table into the page."""
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    folder = Path(sys.argv[1]).resolve()
    record(folder, sys.argv[2:])
    earlier = block(PAGE.read_text(encoding="utf-8"), "convergence")
    redraw(PAGE, {"convergence": table(folder, earlier)})


if __name__ == "__main__":
    main()
