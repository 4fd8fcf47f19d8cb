"""Records the scenes with closed-form answers on the engines that are installed, and draws their tables into
docs/physics/engines.md: which engine keeps which law at which step.

usage: python docs/make_laws.py FOLDER [SIMULATOR|SCENE...]

What FOLDER has already is not recorded again; with names of simulators or scenes, no others are recorded. An engine
without recordings in FOLDER keeps the rows that the page has of it.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from page_blocks import block, redraw

from gpusimbench import open_recording
from gpusimbench.evaluator.results.canonical import Law, laws
from gpusimbench.evaluator.runs.physics.facts import PhysicsFacts
from gpusimbench.evaluator.runs.physics.laws import laws_of

PAGE = Path(__file__).resolve().parent / "physics" / "engines.md"
BASE = 0.01
STEPS = (BASE, 0.005)
FINE = (BASE, 0.001)
"""Steps [s]; the second of MuJoCo C, which is fast on a CPU, is finer."""
STEPS_OF = {"ball-drop": (BASE, 0.001)}
"""Steps [s] of scenes that have others: a bounce is over in a few steps."""
SECONDS = {
    "pendulum": 10.0, "sliding-block": 2.0, "free-body": 20.0, "double-pendulum": 10.0, "ball-drop": 1.5,
    "four-bar": 10.0,
}  # fmt: skip
FIRST = ("pendulum", "sliding-block")
INTEGRATED = {"free-body": ("", "Euler", "RK4"), "double-pendulum": ("", "implicit", "RK4")}
"""Scenes without contacts, and which integrators are compared there; each has another that does as the default does."""
SHOWN = {
    "free-body": "middle_", "ball-drop": "low_(restitution|gain)",
    "sliding-block": "level_acceleration|uphill_distance|stick_|slip_",
}  # fmt: skip
"""Of the laws of a scene, those whose keys match; all of the others."""
ENVS, SPREAD = 16, 0.8
HOPS = "highest hop of the level block"
_HEAD = 3  # lines of a table before its first engine
_TIME = 900  # for one recording [s]

_RUNS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    *((scene, "mujoco", ()) for scene in FIRST),
    ("sliding-block", "mujoco", ("--option", "cone=pyramidal")),
    ("sliding-block", "mujoco", ("--option", "solref=0.04 1")),
    *((scene, "warp", ()) for scene in FIRST),
    ("pendulum", "mjx", ("--impl", "jax")),
    ("pendulum", "newton", ()),
    *(("pendulum", "newton", ("--solver", name)) for name in ("featherstone", "steel", "xpbd")),
    ("sliding-block", "newton", ("--solver", "xpbd")),
    ("sliding-block", "newton", ()),
    ("sliding-block", "brax", ("--solver", "positional")),
    ("sliding-block", "mjx", ("--impl", "jax")),
    *((scene, name, ()) for name in ("physx", "sapien", "genesis") for scene in FIRST),
    *(
        (scene, "mujoco", ("--option", f"integrator={integrator}") if integrator else ())
        for scene, integrators in INTEGRATED.items() for integrator in integrators
    ),
    *((scene, "warp", ()) for scene in INTEGRATED),
    *((scene, "mjx", ("--impl", "jax")) for scene in INTEGRATED),
    ("double-pendulum", "newton", ()),
    ("double-pendulum", "newton", ("--solver", "xpbd")),
    *(
        ("four-bar", "mujoco", tuple(word for option in options for word in ("--option", option)))
        for options in ((), ("solref=0.002 1",), ("integrator=RK4",), ("integrator=RK4", "solref=0.002 1"))
    ),
    ("four-bar", "warp", ()),
    ("four-bar", "mjx", ("--impl", "jax")),
    ("four-bar", "genesis", ()),
    ("ball-drop", "mujoco", ()),
    ("ball-drop", "mujoco", ("--option", "solref=0.02 0.2")),
    ("ball-drop", "warp", ()),
    ("ball-drop", "newton", ("--solver", "xpbd", "--option", "restitution=on")),
    ("ball-drop", "newton", ("--solver", "steel")),
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One engine with its options at one step [s].

    hop  how high the level block rises above where it begins [m], mean over environments; None without blocks
    """

    engine: str
    dt: float
    laws: dict[str, Law]
    hop: float | None


def name_of(scene: str, simulator: str, options: Sequence[str], dt: float) -> str:
    """Of the folder of a recording."""
    given = (option.replace("=", "-").replace(" ", "-").strip("-") for option in options)
    return "-".join([scene, simulator, *given, f"{dt:g}"])


def steps_of(scene: str, simulator: str, options: Sequence[str]) -> tuple[float, ...]:
    """At which a simulator is recorded [s]: MuJoCo C by default, and of loops with any options, at a finer one."""
    fine = simulator == "mujoco" and (not options or scene == "four-bar")
    return STEPS_OF.get(scene, FINE if fine else STEPS)


def record(folder: Path, chosen: Sequence[str]) -> None:
    """Record what is not there yet; an engine that fails at its first step is left out at the others."""
    scenes = [name for name in chosen if name in SECONDS]
    simulators = [name for name in chosen if name not in SECONDS]
    for scene, simulator, options in _RUNS:
        for dt in steps_of(scene, simulator, options):
            target = folder / name_of(scene, simulator, options, dt)
            left_out = any(asked and name not in asked for asked, name in ((scenes, scene), (simulators, simulator)))
            if left_out or list(target.glob("*.mcap")):
                continue
            command = [sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", simulator, *options]
            steps = round(SECONDS[scene] / dt)
            command += ["--scene", scene, "--dt", f"{dt:g}", "--steps", f"{steps}", "--no-view"]
            command += ["--n-env", f"{ENVS}", "--runs", "1", "--phases", "capture"]
            command += ["--initial", f"random:{SPREAD:g}", "--out", str(target)]
            try:
                done = subprocess.run(
                    command, check=False, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, timeout=_TIME
                ).returncode
            except subprocess.TimeoutExpired:
                done = -1
            print(f"{target.name}: exit code {done}", flush=True)
            if done:
                break


def rows(folder: Path, scene: str) -> Iterator[Row]:
    """What was recorded of a scene, in the order of the runs, long steps first."""
    for of, simulator, options in _RUNS:
        for dt in sorted({*STEPS, *FINE}, reverse=True):
            found = sorted((folder / name_of(of, simulator, options, dt)).glob("*.mcap")) if of == scene else []
            for path in found:
                recording = open_recording(path)
                if not recording.usable or recording.simulation is None:
                    continue
                facts = PhysicsFacts(scene, ENVS, ((0, ENVS - 1),), {}, laws=laws_of(recording))
                engine = labelled(f"{simulator} {recording.simulation.version}", options)
                hop = None
                if scene == "sliding-block":
                    level = recording.state("cubes", "position").field.items.index("level")
                    height = recording.state("cubes", "position").read(slice(None), slice(None))[:, :, level, 2]
                    hop = float((height - height[0]).max(axis=0).mean())
                measured = {
                    law.key: law for law in laws("", [facts])
                    if isinstance(law, Law) and re.match(SHOWN.get(scene, ""), law.key)
                }  # fmt: skip
                yield Row(engine, dt, measured, hop)


def labelled(engine: str, options: Sequence[str]) -> str:
    """An engine with its options, as rows name it."""
    said = " ".join(option for option in options if option != "--option").replace("--", "")
    return f"{engine}, {said}" if said else engine


def with_earlier(scene: str, shown: str, earlier: str) -> str:
    """The table of a scene with the earlier rows of engines that it has no row of, in the order of the runs.

    SystemExit where earlier rows have other columns.
    """
    order = [labelled(simulator, options) for of, simulator, options in _RUNS if of == scene]
    new, old = shown.strip().splitlines(), earlier.strip().splitlines()
    measured = {_without_version(line) for line in new[_HEAD:]}
    kept = [line for line in old[_HEAD:] if _without_version(line) in {*order} - measured]
    if kept and new[0] != old[0]:
        names = ", ".join(dict.fromkeys(map(_without_version, kept)))
        raise SystemExit(f"the table of {scene} would have other columns than the page has: record these too: {names}")
    ordered = sorted([*new[_HEAD:], *kept], key=lambda line: order.index(_without_version(line)))
    return "\n".join([*new[:_HEAD], *ordered])


def _without_version(line: str) -> str:
    return re.sub(r"^(\S+) [^\s,]+", r"\1", line.split("|")[1].strip())


def table(found: Sequence[Row]) -> str:
    """A row for each engine and step, a column for each law."""
    titles: dict[str, Law] = {}
    for key, law in ((key, law) for row in found for key, law in row.laws.items()):
        if key not in titles or titles[key].predicted is None:
            titles[key] = law  # of an engine that was told what decides it, if any was
    heads = [f"{law.title}{f' [{law.unit}]' if law.unit else ''}" for law in titles.values()]
    predicted = ["-" if law.predicted is None else f"{law.predicted:.4g}" for law in titles.values()]
    hops = any(row.hop is not None for row in found)
    heads += [f"{HOPS} [mm]"] if hops else []
    lines = [f"| engine | step | {' | '.join(heads)} |", f"| --- | ---: {'| ---: ' * len(heads)}|"]
    lines.append(f"| *predicted* | | {' | '.join([*predicted, *(['0'] if hops else [])])} |")
    for row in found:
        cells = [cell(row.laws.get(key)) for key in titles]
        cells += [f"{1000 * row.hop:.2g}"] if row.hop is not None else []
        lines.append(f"| {row.engine} | {1000 * row.dt:g} ms | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(law: Law | None) -> str:
    """A measured value, bold where the law is broken."""
    if law is None:
        return "-"
    shown = f"{law.measured:.4g}"
    return f"**{shown}**" if law.held is False else shown


def main() -> None:
    """Record, and write the tables into the page."""
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    folder = Path(sys.argv[1]).resolve()
    record(folder, sys.argv[2:])
    page = PAGE.read_text(encoding="utf-8")
    shown = {scene: table(found) for scene in SECONDS if (found := list(rows(folder, scene)))}
    named = {f"laws of {scene}": scene for scene in shown}
    redraw(PAGE, {name: with_earlier(scene, shown[scene], block(page, name)) for name, scene in named.items()})


if __name__ == "__main__":
    main()
