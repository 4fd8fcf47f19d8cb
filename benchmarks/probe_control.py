"""Whether gsb-probe finds faults that are there, and none that are not.

The calibration simulator gets one fault for each question, of one unit in the last place up; and as many probes have
none. Seeds, numbers of environments, spreads and steps differ from probe to probe. What each probe answers comes from
its recordings, which a second process makes, in the calibration simulator's own environment (gsb-record --setup
calibration); it records all of them, since a process of its own for each of a few thousand runs would take hours.

    python -m benchmarks.probe_control [--probes 165] [--clean 165]         the counts of docs/probe.md
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

SIZES = (1, 4, 64, 4096)
"""Of faults, in units in the last place."""

OUTCOMES = 1024
"""Of what a run draws, times the size: with two outcomes, half of all pairs of runs would be equal by chance."""

SLOPE, LEVEL = "inclined-collision", "free-fall"
"""Scenes. A slope is not its own image by a half turn, so that states are not turned there."""

SOUND = {"regime": "exact"}
"""Options with which nothing depends on what should not matter."""

FOUND_BY = {
    "runs": {"regime": "run-order", "entropy": "build"},
    "envs": {"regime": "offset"},
    **{
        key: {"fault": key, **SOUND}
        for key in (
            "capture",
            "number",
            "slot",
            "neighbours",
            "poison",
            "bystanders",
            "fresh",
            "restored",
            "process",
            "mirrored",
            "turned",
            "relabelled",
            "set",
        )
    },
}
"""By question, the options that plant its fault; and `ulps`, its size."""


@dataclass(frozen=True)
class Probe:
    """One probe.

    planted  key of the question; empty for none
    ulps     size of the fault
    """

    number: int
    planted: str
    ulps: int
    scene: str
    seed: int
    n_env: int
    steps: int
    spread: float
    at: int

    @property
    def options(self) -> dict[str, str]:
        """Of the calibration simulator."""
        given = FOUND_BY[self.planted] if self.planted else SOUND
        ulps = OUTCOMES * self.ulps if self.planted == "runs" else self.ulps
        size = {"ulps": str(ulps), "at": str(self.at)} if self.planted else {}
        return {**given, **size, "device": "cpu"}


def probes(count: int, clean: int, seed: int = 0) -> Iterator[Probe]:
    """Those with a fault, which take turns, and those without."""
    drawn = random.Random(seed)
    for number in range(count + clean):
        planted = list(FOUND_BY)[number % len(FOUND_BY)] if number < count else ""
        ulps = SIZES[number // len(FOUND_BY) % len(SIZES)] if planted else 0
        steps, scene = drawn.randrange(30, 61), drawn.choice((SLOPE, LEVEL))
        yield Probe(
            number, planted, ulps, LEVEL if planted == "turned" else scene, drawn.randrange(2**32),
            drawn.randrange(3, 9), steps, drawn.choice((0.03125, 0.25, 1.0)), drawn.randrange(1, steps // 3),
        )  # fmt: skip


def as_it_should(probe: Probe, answers: dict[str, str]) -> bool:
    """Whether a fault was found, or, where none was planted, every question that can be asked was answered yes."""
    if probe.planted:
        return answers[probe.planted] == "no"
    return all(
        said == ("not asked" if (key, probe.scene) == ("turned", SLOPE) else "yes") for key, said in answers.items()
    )


def plan_of(probe: Probe) -> Any:
    """Its plan, as gsb-probe makes it."""
    from gpusimbench.evaluator.probe.runs import Plan

    options = tuple(f"{name}={value}" for name, value in probe.options.items())
    numbers = (1, 2 * probe.n_env)
    return Plan(
        "calibration", probe.scene, "default", options, probe.seed, probe.steps, probe.n_env, numbers, probe.spread
    )


def configurations(probe: Probe, folder: Path) -> list[dict[str, Any]]:
    """Of the runs that it lacks, as a recording keeps them; of arms that differ, more are recorded.

    A run that continues a snapshot also has the file with the snapshot, `saved`; it waits until there is such a file.
    """
    from gpusimbench.evaluator.probe.runs import differing
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.recorder.command.arguments import parser
    from gpusimbench.recorder.command.configure import configure
    from gpusimbench.recorder.command.parser import fill
    from gpusimbench.schemas.location import place

    found = []
    plan = plan_of(probe)
    there = [Recording(place(str(path))) for path in sorted(folder.glob("*.mcap"))]
    for arm in plan.missing([recording.configuration for recording in there], differing(there)):
        if arm.continued:
            saved = (r.path for r in there if arm.continued in r.configuration.snapshots)
            found += [_continuing(path, arm.continued) for path in list(saved)[:1]]
            continue
        if probe.scene == SLOPE and arm.initial.endswith(",mirror:xy"):
            continue
        command_line = parser()
        arguments = command_line.parse_args(plan.arguments(arm, "."))
        fill(arguments, command_line.unless_given)
        found.append(configure(arguments)[0].to_json())
    return found


def _continuing(path: Any, step: int) -> dict[str, Any]:
    from gpusimbench.recorder.sets.replay import begun, read_source

    source = read_source(Path(str(path)))
    return {**begun(source, source.configuration, step)[0].to_json(), "saved": str(path)}


def record(jobs: Path) -> None:
    """Make the runs of a file of jobs, in this process, which has Taichi."""
    from gpusimbench.recorder.run.run import Run
    from gpusimbench.schemas.configuration import RunConfiguration
    from gpusimbench.schemas.initial import GIVEN
    from gpusimbench.schemas.mcap.reader import Container
    from gpusimbench.schemas.provenance import Provenance
    from gpusimbench.schemas.treatment import snapshot_name

    for number, job in enumerate(json.loads(jobs.read_text())):
        path, c = Path(job["path"]), RunConfiguration.from_json(job["configuration"])
        saved = job["configuration"].get("saved")
        given = Container(Path(saved)).attachment(snapshot_name(c.first_step)) if saved else None
        path.parent.mkdir(parents=True, exist_ok=True)
        run = Run(
            Provenance(f"{number:032x}", "2026-01-01T00:00:00Z", (), c), path,
            progress=lambda phase, done, of: None, log=lambda: b"", inputs={} if given is None else {GIVEN: given},
        )  # fmt: skip
        outcome = run.record()
        if outcome.status != "COMPLETE":
            raise SystemExit(f"{path}: {outcome.status}: {outcome.reason}")


def judged(folder: Path) -> dict[str, str]:
    """What a probe answers: question to answer."""
    from gpusimbench.evaluator.probe.arms import arms_of
    from gpusimbench.evaluator.probe.questions import answers
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.schemas.location import place

    (arms,) = arms_of([Recording(place(str(path))) for path in sorted(folder.glob("*.mcap"))])
    return {finding.key: finding.answer.value for finding in answers(arms)}


def python_of_calibration() -> str:
    """The interpreter of the calibration simulator's environment."""
    from gpusimbench.recorder.environments.store import find

    prepared = find("calibration")
    if prepared is None:
        raise SystemExit("needs the calibration simulator: gsb-record --setup calibration")
    return str(prepared.folder / "bin" / "python")


def table(results: Sequence[tuple[Probe, dict[str, str]]]) -> str:
    """How many of each fault and size were found, and what was said where there was none."""
    lines = ["| planted | " + " | ".join(f"{size} ULP" for size in SIZES) + " |", "|---|" + "---|" * len(SIZES)]
    for planted in FOUND_BY:
        cells = []
        for size in SIZES:
            of = [answers for probe, answers in results if (probe.planted, probe.ulps) == (planted, size)]
            cells.append(f"{sum(answers[planted] == 'no' for answers in of)} of {len(of)}")
        lines.append(f"| {planted} | " + " | ".join(cells) + " |")
    clean = [(probe, answers) for probe, answers in results if not probe.planted]
    found = [as_it_should(probe, answers) for probe, answers in results if probe.planted]
    said = Counter(answer for _, answers in clean for answer in answers.values())
    lines.append(f"\nfound: {sum(found)} of {len(found)} planted faults")
    false = sum(not as_it_should(probe, answers) for probe, answers in clean)
    drawn = [answers for probe, answers in results if probe.planted == "runs"]
    blamed = sum(any(answers[key] == "no" for key in FOUND_BY if key not in ("runs", "envs")) for answers in drawn)
    lines.append(f"blamed: {blamed} of {len(drawn)} probes whose runs differ say that something else matters")
    lines.append(f"false: {false} of {len(clean)} probes without a fault ({dict(said)} over all questions)")
    return "\n".join(lines)


def recorded_elsewhere(jobs: list[dict[str, Any]], file: Path) -> None:
    """Make runs in the calibration simulator's own environment."""
    file.write_text(json.dumps(jobs))
    command = [python_of_calibration(), "-P", "-m", "benchmarks.probe_control", "--record", str(file)]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}", "TI_SKIP_VERSION_CHECK": "ON"}
    subprocess.run(command, check=True, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)


def main() -> None:
    """Plant, record, judge, count."""
    p = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    p.add_argument("--probes", type=int, default=165, help="with a fault (default: %(default)s)")
    p.add_argument("--clean", type=int, help="without a fault (default: as many)")
    p.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    arguments = p.parse_args()
    if arguments.record:
        record(arguments.record)
        return
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        clean = arguments.probes if arguments.clean is None else arguments.clean
        drawn = list(probes(arguments.probes, clean))
        made = 0
        for attempt in range(4):  # all; those that continue others; twice those that differ
            jobs = [
                {"path": str(folder / str(probe.number) / f"{attempt}-{index:02}.mcap"), "configuration": configuration}
                for probe in drawn
                for index, configuration in enumerate(configurations(probe, folder / str(probe.number)))
            ]
            recorded_elsewhere(jobs, folder / "jobs.json")
            made += len(jobs)
        results = [(probe, judged(folder / str(probe.number))) for probe in drawn]
        print(table(results))
        print(f"{made} runs, {time.monotonic() - began:.0f} s")
        for probe, answers in results:
            if not as_it_should(probe, answers):
                print(json.dumps({**asdict(probe), "answers": answers}), file=sys.stderr)


if __name__ == "__main__":
    main()
