"""One run: its phases, in order, into one recording.

    baseline   nothing of the engine exists yet; memory is read
    init       the simulator is built; what it says of itself is written
    warmup     steps that are excluded from throughput; the first pays for compilation
    timed      nothing is recorded but clocks, memory and clock rates of the hardware
    capture    a fresh simulator; the full state of every environment, or the last states of those that fail
    import     of a model file: what the engine made of it, tried on a simulator of its own

Validity gates are asked after the warm-up, after the timed phase and after the capture. One that fired before the
capture leaves it out, unless a state was not finite: the states before it show what happened. What the engine counts
(contacts, rows, overflow bits) is kept for every captured step, and for the last step of the warm-up and of the timed
phase. What the engine compiles for a phase, it compiles before it, under clocks of its own.

A run that cannot finish, or takes longer than it may, still ends its recording, with the reason. Only a crash of the
process, or a disk that takes no more bytes, leaves a recording without an end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.samples import Sampling
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.view import LogWriter
from gpusimbench.recorder.failure import Interrupted, TimedOut, cause_of
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.host import (
    clock_problem,
    describe_host,
    describe_software,
    numeric_environment,
    package_list,
    peak_rss_bytes,
)
from gpusimbench.recorder.run import vary
from gpusimbench.recorder.run.capture_phase import CapturePhase
from gpusimbench.recorder.run.engine import Engine, apply_environment
from gpusimbench.recorder.run.flight_phase import FlightPhase
from gpusimbench.recorder.run.given_actions import streams_of
from gpusimbench.recorder.run.import_phase import write_imported, write_trials
from gpusimbench.recorder.run.journal import Journal, Phase
from gpusimbench.recorder.run.pace import COMPILE, REBUILD, Report
from gpusimbench.recorder.run.timed_phase import warm_up_and_time
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.scenes.registry import scene_of
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas import FORMAT, GENERATED, model_files, topics
from gpusimbench.schemas.action_generator import describe_generator
from gpusimbench.schemas.arrays import MEDIA_TYPE
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DataLost, GsbError
from gpusimbench.schemas.initial import GIVEN
from gpusimbench.schemas.provenance import (
    ENGINE_LOG,
    PACKAGES,
    PROVENANCE,
    SCENE,
    SIMULATION,
    Provenance,
)
from gpusimbench.schemas.treatment import VARIED


@dataclass(frozen=True)
class RunEnd:
    """How a run ended: COMPLETE, FAILED or INVALID, why, and a name of gsb.v1.Cause, empty when complete."""

    status: str
    reason: str
    cause: str
    path: Path


@dataclass(frozen=True)
class _Adapter:
    """The adapter that a configuration names, with its options.

    options  of the adapter's own type
    """

    adapter: type[Simulator]
    configuration: RunConfiguration
    options: Any

    @classmethod
    def chosen(cls, c: RunConfiguration, scene: Scene) -> _Adapter:
        """Load it and set the variables that it asks for; GsbError where it is not there or refuses an option."""
        adapter = find_simulator(c.simulator).load()
        options = adapter.parsed(c.simulator, scene, c.options)
        apply_environment(adapter.environment(options, c.determinism))
        return cls(adapter, c, options)

    def make(self, scene: Scene, n_env: int) -> Simulator:
        """A simulator of a scene, not yet built."""
        c = self.configuration
        return self.adapter(scene, n_env=n_env, dt=c.dt, seed=c.seed, options=self.options, determinism=c.determinism)


class Run:
    """Records one run into `path`.

    provenance   what is known before the run's process begins; the run adds its machine and software
    log          returns what the engine printed so far
    reserved     the .partial file of `path` is there already, empty, made for this run
    inputs       files that the run is given: by the names GIVEN and CONTROLS arrays, by model_files.MODEL an archive
    interrupted  whether the one who started this process has interrupted it: an engine that handles signals itself may
                 keep them from this process
    """

    def __init__(
        self,
        provenance: Provenance,
        path: Path,
        *,
        progress: Report,
        log: Callable[[], bytes],
        reserved: bool = False,
        inputs: Mapping[str, bytes] | None = None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        self._configuration = provenance.configuration
        self._path = path
        self._progress = progress
        self._log = log
        self._provenance = provenance
        self._reserved = reserved
        self._inputs = inputs or {}
        self._interrupted = interrupted

    def record(self) -> RunEnd:
        """Run all phases. DataLost where the file cannot be written; any other failure is a RunEnd.

        Takes over SIGINT and SIGTERM: the first ends the run, and none comes between the run and the file's end.
        """
        sink = Sink(self._path, compression=self._configuration.compression, reserved=self._reserved)
        try:
            journal = Journal(sink)
            c, progress = self._configuration, self._progress
            captured = (
                FlightPhase(journal, c, progress)
                if c.keep
                else CapturePhase(journal, c, progress, self._inputs.get(GIVEN))
            )
            status, reason, cause = self._guarded(journal, captured)
            if log := self._log():
                sink.attach(ENGINE_LOG, "text/plain", log)
            if journal.shown_log:
                journal.shown_log.status(status, reason)
            sink.finish(status, reason, cause=cause, last_step=captured.last_step, peak_rss_bytes=peak_rss_bytes())
        except BaseException:
            sink.abandon()
            raise
        return RunEnd(status, reason, cause, self._path)

    def _guarded(self, journal: Journal, captured: CapturePhase | FlightPhase) -> tuple[str, str, str]:
        try:
            try:
                with Gpus() as gpus:
                    self._run_phases(journal, captured, gpus)
                interruption.check()
            finally:
                interruption.ignore()
                self._progress(interruption.ENDING, 0, 1)
        except DataLost:
            raise
        except BaseException as error:
            ended = self._struck(error, journal.phase)
            if ended is None and isinstance(error, SystemExit):
                raise
            error = ended or error
            return "FAILED", _reason(error, journal.phase), cause_of(error)
        if journal.fired:
            return "INVALID", *journal.reason
        return "COMPLETE", "", ""

    def _struck(self, error: BaseException, phase: str) -> GsbError | None:
        # An engine may make any error of an interruption: numpy and others call it a failed import.
        struck = interruption.struck() or ("INTERRUPTED" if self._interrupted() else "")
        if not struck:
            return None
        made = "" if isinstance(error, KeyboardInterrupt) else f"; what followed: {_error_in_words(error)}"
        if struck == "TIMEOUT":
            return TimedOut(f"timeout: more than {self._configuration.timeout:g} s, in phase {phase}{made}")
        return Interrupted(f"interrupted in phase {phase}{made}")

    def _run_phases(self, journal: Journal, captured: CapturePhase | FlightPhase, gpus: Gpus) -> None:
        configuration = self._configuration
        with interruption.shielded():  # a recording that has an end says what it is of
            interruption.install(also_ignored=True)
            interruption.expire_after(configuration.timeout)
            trouble: GsbError | None = None
            scene: Scene | None = None
            engine: _Adapter | None = None
            try:
                scene = scene_of(configuration, self._inputs)
                engine = _Adapter.chosen(configuration, scene)
            except GsbError as error:
                trouble = error  # raised once the recording says what it is of
            varied = self._write_origin(journal, gpus, scene)

        sampling = Sampling(journal.sink, gpus)
        try:
            with Phase(journal, sampling, "baseline"):
                for problem in filter(None, (clock_problem(), *gpus.problems)):
                    journal.event("NOTE", problem)
                sampling.checkpoint("baseline")
                sampling.start()
            if trouble or scene is None or engine is None:
                raise trouble or GsbError("no scene")
            self._step(journal, captured, sampling, scene, engine, varied)
            if "import" in configuration.phases and isinstance(scene, ModelScene) and not journal.fired:
                sampling.use_allocator(None)
                self._progress("import", 0, 1)
                with Phase(journal, sampling, "import"):
                    write_trials(journal, scene, engine.make, dt=configuration.dt, seed=configuration.seed)
        except DataLost:
            sampling.stop()  # the file takes nothing more
            raise
        except BaseException:
            _end_sampling(journal, sampling)
            raise
        _end_sampling(journal, sampling)

    def _write_origin(self, journal: Journal, gpus: Gpus, scene: Scene | None) -> Variation | None:
        """Write what the recording is of, as far as that is known; returns how its environments differ."""
        configuration, sink = self._configuration, journal.sink
        provenance = replace(
            self._provenance,
            host=describe_host(),
            gpus=gpus.describe(),
            software=describe_software(),
            environment=numeric_environment(),
        )
        captures = "capture" in configuration.phases and not configuration.keep
        if captures and scene and scene.actions and describe_generator(scene.actions, configuration.seed):
            sink.profile = GENERATED
        sink.metadata("gsb", _summary(provenance))
        sink.attach(PROVENANCE, "application/json", provenance.to_json().encode())
        sink.attach(PACKAGES, "text/plain", package_list().encode())
        varied: Variation | None = None
        if scene is not None:
            sink.attach(SCENE, "application/json", scene.to_json().encode())
            varied = vary.variation(configuration.vary, scene, n_env=configuration.n_env, seed=configuration.seed)
            if varied is not None:
                sink.attach(VARIED, MEDIA_TYPE, vary.attachment(varied))
        for name, data in self._inputs.items():
            archive = name == model_files.MODEL
            sink.attach(*(model_files.attachment(data) if archive else (name, MEDIA_TYPE, data)))
        sink.channel(topics.RUN_EVENT, "gsb.v1.Event")
        if configuration.view:
            journal.shown_log = LogWriter(sink)
        return varied

    def _step(
        self, journal: Journal, captured: CapturePhase | FlightPhase, sampling: Sampling, scene: Scene,
        adapter: _Adapter, varied: Variation | None,
    ) -> None:  # fmt: skip
        """Build the simulator and step it: the phases from init to capture."""
        configuration = self._configuration

        def new_simulator() -> Simulator:
            simulator = adapter.make(scene, configuration.n_env)
            simulator.streams = streams_of(configuration)
            if varied is not None:
                simulator.vary(varied)
            return simulator

        with Engine(new_simulator, configuration.initial, self._inputs.get(GIVEN)) as engine:
            with Phase(journal, sampling, "init"):
                self._progress("init", 0, 1)
                description = journal.clocked("build", engine.start)
                self._write_description(journal.sink, scene, description)
                sampling.use_allocator(engine.simulator.allocator_bytes)
                write_imported(journal, engine.simulator)
                if stepped := [phase for phase in ("timed", "capture") if phase in configuration.phases]:
                    self._progress(COMPILE, 0, 1)
                    journal.compile(engine.simulator, stepped[0])
                sampling.checkpoint("post-init")
            if "timed" in configuration.phases:
                warm_up_and_time(journal, sampling, engine, description, configuration, self._progress)
                sampling.checkpoint("final")
            if "capture" in configuration.phases and journal.worth_capturing:
                if "timed" in configuration.phases:
                    sampling.use_allocator(None)
                    self._progress(REBUILD, 0, 1)
                    engine.start()
                    self._progress(COMPILE, 0, 1)
                    journal.compile(engine.simulator, "capture")
                with Phase(journal, sampling, "capture"):
                    fired, before = journal.fired, list(journal.problems)
                    captured.run(engine.simulator, description)
                    if fired and all(gate[0] != "NOT_FINITE" for gate in journal.problems if gate not in before):
                        journal.gate(_too_short(configuration), "NOT_FINITE")
            if "timed" not in configuration.phases:
                sampling.checkpoint("final")
            sampling.drain()

    def _write_description(self, sink: Sink, scene: Scene, description: Description) -> None:
        timed = "timed" in self._configuration.phases
        simulation = description.recorded(scene, "rebuilt after the timed phase" if timed else "first build")
        sink.attach(SIMULATION, "application/json", simulation.to_json().encode())
        for name, (media_type, data) in description.attachments.items():
            sink.attach(name, media_type, data)


def _end_sampling(journal: Journal, sampling: Sampling) -> None:
    sampling.stop()
    for failed in sampling.failures():
        journal.event("NOTE", failed)


def _too_short(c: RunConfiguration) -> str:
    timed = c.warmup + c.timed_steps
    more = f": --steps {timed} captures as many as were stepped before" if c.steps < timed else ""
    return f"the states of the capture are finite up to its last step, {c.steps}{more}"


def _reason(error: BaseException, phase: str) -> str:
    match error:
        case KeyboardInterrupt():
            return f"interrupted in phase {phase}"
        case MemoryError():
            return f"out of host memory in phase {phase}"
        case GsbError():
            return str(error)
    return _error_in_words(error, f" in phase {phase}")


def _error_in_words(error: BaseException, where: str = "") -> str:
    text = " ".join(str(error).split()) or "no message"
    return f"{type(error).__name__}{where}: {text}"


def _summary(provenance: Provenance) -> dict[str, str]:
    configuration = provenance.configuration
    return {
        "format": FORMAT,
        "run_id": provenance.run_id,
        "simulator": configuration.simulator,
        "scene": configuration.scene,
        "n_env": str(configuration.n_env),
        "dt": repr(configuration.dt),
        "created_utc": provenance.created_utc,
    }
