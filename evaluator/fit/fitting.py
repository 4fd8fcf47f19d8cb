"""The runs of a fit: the reference, the start, those of the search, and one with the fitted options."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import COMMAND, about, as_path, record
from gpusimbench.evaluator.fit.document import Fit, compared, dump_csv
from gpusimbench.evaluator.fit.search import Evaluation, Parameters, best_of, parameters, search
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses, errors_of, measured_tosses
from gpusimbench.schemas import checks
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.tosses import EVEN
from gpusimbench.schemas.writing import write_file

SCENE = "cube-toss"

TABLE = "evaluations.csv"
"""Every evaluation, beside the recordings that are kept."""

_CM = 100.0


@dataclass(frozen=True)
class Asked:
    """What a fit is asked for.

    simulator  name in the registry
    names      of the options that are fitted
    given      options as text: those that stay, and starts of those that are fitted
    tosses     path of the set; None for gsb-record's default
    dt         step [s]; None for the scene's
    budget     evaluations at most
    out        folder of what is kept
    """

    simulator: str
    names: tuple[str, ...]
    given: Mapping[str, str]
    tosses: Path | None
    dt: float | None
    budget: int
    out: Path


def fit(asked: Asked) -> Fit:
    """Search on even tosses, and judge on odd ones; the recordings of the reference, the start and the fitted options
    stay in the folder.

    UsageError for options that cannot be fitted, GsbError where the start cannot be recorded or judged.
    """
    known = about(asked.simulator)["options"]
    tosses = [] if asked.tosses is None else ["--tosses", as_path(asked.tosses)]
    reference = _recording(_record_one(["--sim", "real", "--scene", SCENE, *tosses], asked.out))
    measured = measured_tosses(reference)
    if measured is None:
        raise GsbError(f"{reference.path} has no tosses")
    if asked.dt is not None:
        per_row = round(measured.dt / asked.dt)
        if per_row < 1 or abs(per_row * asked.dt / measured.dt - 1.0) > 1e-6:
            raise UsageError(
                f"--dt {asked.dt:g} is no whole part of {measured.dt:.6g} s, the time between measured rows"
            )
    wanted = parameters(asked.names, known, asked.given, {"friction": _friction(reference)})
    runs = _Runs(asked, measured, tosses)
    made = runs.searched(wanted)
    best = best_of(made)
    if best is None or runs.start is None:
        raise GsbError(f"the start cannot be judged: {why_missing(made[0].error)}")
    start = made[0]
    after, command = runs.start, ""
    if best is not start:
        words = [f"--fitted={name}={EVEN}" for name in best.options]
        after = _recording(_record_one([*runs.arguments(best.options), *words], asked.out))
        command = shlex.join([COMMAND, *runs.arguments(best.options), *words])
    simulation = runs.start.simulation
    version = simulation.version if simulation else ""
    others = [f"{name}={value}" for name, value in asked.given.items() if name not in wanted.start]
    return Fit(
        simulator=" ".join(filter(None, (asked.simulator, f"[{', '.join(others)}]" if others else "", version))),
        source=measured.name(),
        sha256=measured.known.sha256,
        start=dict(start.options),
        fitted=dict(best.options),
        budget=asked.budget,
        command=command,
        evaluations=made,
        compared=compared(runs.start, after, measured),
        before=runs.start.content_hash,
        after=after.content_hash,
    )


class _Runs:
    """Runs of the simulator with other options.

    start  the recording of the first evaluation, which stays; None where there is none
    """

    def __init__(self, asked: Asked, measured: MeasuredTosses, tosses: Sequence[str]) -> None:
        self._asked = asked
        self._measured = measured
        self._tosses = tosses
        self.start: Recording | None = None

    def arguments(self, options: Mapping[str, str]) -> list[str]:
        """Arguments of gsb-record for these options."""
        asked = self._asked
        words = [f"--option={name}={value}" for name, value in {**asked.given, **options}.items()]
        steps = [] if asked.dt is None else [f"--dt={asked.dt!r}", f"--stride={self._per_row(asked.dt)}"]
        whole = ["--sim", asked.simulator, "--scene", SCENE, "--runs", "1", "--phases", "capture", "--no-view"]
        return [*whole, *self._tosses, *steps, *words]

    def searched(self, wanted: Parameters) -> tuple[Evaluation, ...]:
        """All evaluations of the search, which are a table in the folder while it goes on."""
        made: list[Evaluation] = []
        passing = self._asked.out / "passing"
        with stage(f"fitting {self._asked.simulator}", self._asked.budget) as progress:

            def evaluate(options: Mapping[str, str]) -> float | Missing:
                error = self._error(options, passing if made else self._asked.out)
                made.append(Evaluation(options, error))
                write_file(self._asked.out / TABLE, dump_csv(made))
                progress.advance()
                return error

            try:
                return search(wanted, evaluate, self._asked.budget)
            finally:
                shutil.rmtree(passing, ignore_errors=True)

    def _error(self, options: Mapping[str, str], folder: Path) -> float | Missing:
        """Mean error of position on even tosses [cm]; of the start the recording stays."""
        try:
            path = _record_one(self.arguments(options), folder)
        except GsbError as error:
            return Missing(str(error))
        recording = _recording(path)
        errors = errors_of(recording, self._measured, EVEN)
        if folder == self._asked.out:
            self.start = recording
        else:
            path.unlink()
        return errors if isinstance(errors, Missing) else float(errors.position.mean()) * _CM

    def _per_row(self, dt: float) -> int:
        return max(1, round(self._measured.dt / dt))


def _record_one(arguments: Sequence[str], folder: Path) -> Path:
    """The recording of a run; GsbError says why there is none, or none that is whole."""
    made, refused = record([*arguments, "--out", as_path(folder)], lambda text: None)
    if refused or not made:
        raise GsbError(refused or f"{COMMAND} made no run")
    if made[0].file is None or made[0].status != "complete":
        raise GsbError(f"the run is {made[0].status}: {made[0].reason}")
    return made[0].file


def _recording(path: Path) -> Recording:
    return Recording(place(str(path)))


def _friction(reference: Recording) -> float:
    """The coefficient that the scene has, of the body that moves."""
    bodies = [body for body in checks.objects(reference.scene, "bodies") if body.get("group")]
    return checks.number(checks.mapping(bodies[0], "material"), "kinetic_friction", 0, 1e9)
