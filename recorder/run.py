"""One run: its phases, in order, into one recording.

    baseline   nothing of the engine exists yet; memory is read
    init       the simulator is built; what it says of itself is written
    warmup     steps that are excluded from throughput; the first pays for compilation
    timed      nothing is recorded but clocks and memory
    capture    a fresh simulator; the full state of every environment

Between two clock readings of the timed phase lies what the simulator says of it (Description.timing_covers). From the
first reading to the last, memory is sampled as well, at 100 Hz from another thread; nothing is written, drawn or
reported meanwhile, and Python collects no garbage. An interval has `timing_interval` steps; the last may have fewer.

Validity gates are asked after the warm-up, after the timed phase and after the capture. What the engine counts
(contacts, rows, overflow bits) is kept for every captured step, and for the last step of the warm-up and of the timed
phase. What the engine compiles for a phase, it compiles before it, under clocks of its own.

A run that cannot finish, or takes longer than it may, still ends its recording, with the reason. Only a crash of the
process, or a disk that takes no more bytes, leaves a recording without an end.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder import clock, interruption
from gpusimbench.recorder.capture.actions import Actions, declare_actions, write_action_stream, write_actions
from gpusimbench.recorder.capture.evidence import EvidenceWriter
from gpusimbench.recorder.capture.kept import KeptStates
from gpusimbench.recorder.capture.memory import MemoryWriter
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter, declare_fingerprints, row_bytes, write_fingerprints
from gpusimbench.recorder.capture.stepping import CaptureClock, step_and_capture
from gpusimbench.recorder.capture.view import LogWriter, ViewWriter
from gpusimbench.recorder.capture.writing import Block, Writing
from gpusimbench.recorder.engine import Engine
from gpusimbench.recorder.environment import apply_environment
from gpusimbench.recorder.failure import Interrupted, TimedOut, cause_of
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.host import describe_host, numeric_environment, peak_rss_bytes
from gpusimbench.recorder.probes.memory import MemorySampler
from gpusimbench.recorder.probes.software import describe_software, package_list
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.captured import RING_BLOCKS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas import FORMAT, topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, DataLost, GsbError
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.provenance import (
    ENGINE_LOG,
    PACKAGES,
    PROVENANCE,
    SCENE,
    SIMULATION,
    Provenance,
    ReplayOf,
    Simulation,
)

Progress = Callable[[str, int, int], None]
"""Called with a phase, the steps done in it, and the steps that it has; with interruption.ENDING at the end."""

_T = TypeVar("_T")

_CLOCKED = {
    "build": "import of the engine, sizing of its buffers, loading of the model, allocation",
    "compile_timed": "compilation of what the timed phase runs",
    "compile_capture": "compilation of what the capture phase runs",
}

_SAMPLED = "memory is sampled from another thread at 100 Hz"


@dataclass(frozen=True)
class Outcome:
    """How a run ended: COMPLETE, FAILED or INVALID, why, and one of recorder.failure.CAUSES, empty when complete."""

    status: str
    reason: str
    cause: str
    path: Path


class Run:
    """Records one run into `path`.

    run_id       unique (UUID4)
    argv         the user's command
    created      UTC, ISO 8601
    log          returns what the engine printed so far
    reserved     the .partial file of `path` is there already, empty, made for this run
    replay_of    the recording whose configuration it is
    interrupted  whether the one who started this process has interrupted it: an engine that handles signals itself may
                 keep them from this process
    """

    def __init__(
        self,
        configuration: RunConfiguration,
        path: Path,
        *,
        run_id: str,
        argv: tuple[str, ...],
        created: str,
        progress: Progress,
        log: Callable[[], bytes],
        reserved: bool = False,
        replay_of: ReplayOf | None = None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        self._configuration = configuration
        self._path = path
        self._progress = progress
        self._log = log
        self._provenance = Provenance(run_id, created, argv, configuration, replay_of=replay_of)
        self._reserved = reserved
        self._interrupted = interrupted
        self._problems: list[tuple[str, str]] = []  # cause and sentence of each gate that fired
        self._writer: StateWriter | None = None
        self._shown_log: LogWriter | None = None
        self._events = enum_values("gsb.v1.EventKind")

    def record(self) -> Outcome:
        """Run all phases. DataLost where the file cannot be written; any other failure is an Outcome.

        Takes over SIGINT and SIGTERM: the first ends the run, and none comes between the run and the file's end.
        """
        sink = Sink(self._path, compression=self._configuration.compression, reserved=self._reserved)
        try:
            status, reason, cause = self._guarded(sink)
            if log := self._log():
                sink.attach(ENGINE_LOG, "text/plain", log)
            last_step = max(0, self._writer.last_recorded_step) if self._writer else 0
            if self._shown_log:
                self._shown_log.status(status, reason)
            sink.finish(status, reason, cause=cause, last_step=last_step, peak_rss_bytes=peak_rss_bytes())
        except BaseException:
            sink.abandon()
            raise
        return Outcome(status, reason, cause, self._path)

    def _guarded(self, sink: Sink) -> tuple[str, str, str]:
        phase = ["baseline"]
        try:
            try:
                with Gpus() as gpus:
                    self._run_phases(sink, gpus, phase)
                interruption.check()
            finally:
                interruption.ignore()
                self._progress(interruption.ENDING, 0, 1)
        except DataLost:
            raise
        except BaseException as error:
            ended = self._struck(error, phase[0])
            if ended is None and isinstance(error, SystemExit):
                raise
            error = ended or error
            return "FAILED", _reason(error, phase[0]), cause_of(error)
        if self._problems:
            # a gate that fires in each phase is said once
            return "INVALID", "; ".join(dict.fromkeys(text for _, text in self._problems)), self._problems[0][0]
        return "COMPLETE", "", ""

    def _struck(self, error: BaseException, phase: str) -> GsbError | None:
        # An engine may make any error of an interruption: numpy and others call it a failed import.
        struck = interruption.struck() or ("INTERRUPTED" if self._interrupted() else "")
        if not struck:
            return None
        made = "" if isinstance(error, KeyboardInterrupt) else f"; what followed: {_said(error)}"
        if struck == "TIMEOUT":
            return TimedOut(f"timeout: more than {self._configuration.timeout:g} s, in phase {phase}{made}")
        return Interrupted(f"interrupted in phase {phase}{made}")

    def _run_phases(self, sink: Sink, gpus: Gpus, phase: list[str]) -> None:
        configuration = self._configuration
        with interruption.shielded():  # a recording that has an end says what it is of
            interruption.install(also_ignored=True)
            interruption.expire_after(configuration.timeout)
            trouble: GsbError | None = None
            scene: Scene | None = None
            try:
                scene = make_scene(configuration.scene)
                adapter = find_simulator(configuration.simulator).load()
                options = parse_options(configuration.simulator, adapter.Options, configuration.options)
                apply_environment(adapter.environment(options, configuration.determinism))
            except GsbError as error:
                trouble = error  # raised once the recording says what it is of
            provenance = replace(
                self._provenance,
                host=describe_host(),
                gpus=gpus.describe(),
                software=describe_software(),
                environment=numeric_environment(),
            )
            sink.metadata("gsb", _summary(provenance))
            sink.attach(PROVENANCE, "application/json", provenance.to_json().encode())
            sink.attach(PACKAGES, "text/plain", package_list().encode())
            if scene is not None:
                sink.attach(SCENE, "application/json", scene.to_json().encode())
            sink.channel(topics.RUN_EVENT, "gsb.v1.Event")
            if configuration.view:
                self._shown_log = LogWriter(sink)

        memory = MemoryWriter(sink, MemorySampler(gpus), len(gpus))
        try:
            with _Phase(self, sink, memory, "baseline", phase):
                for problem in filter(None, (clock.problem(), *gpus.problems)):
                    self.event(sink, "NOTE", "baseline", problem)
                memory.checkpoint("baseline")
                memory.start()

            if trouble or scene is None:
                raise trouble or GsbError("no scene")
            built = scene

            def new_simulator() -> Simulator:
                return adapter(
                    built,
                    n_env=configuration.n_env,
                    dt=configuration.dt,
                    seed=configuration.seed,
                    options=options,
                    determinism=configuration.determinism,
                )

            with Engine(new_simulator) as engine:
                with _Phase(self, sink, memory, "init", phase):
                    self._progress("init", 0, 1)
                    description = self._clocked(sink, "build", engine.start)
                    self._write_description(sink, built, description)
                    memory.use_allocator(engine.simulator.allocator_bytes)
                    self._compile(
                        sink, engine.simulator, configuration.phases[0] if len(configuration.phases) == 1 else "timed"
                    )
                    memory.checkpoint("post-init")
                if "timed" in configuration.phases:
                    self._warm_up_and_time(sink, memory, engine.simulator, description, phase)
                    memory.checkpoint("final")
                if "capture" in configuration.phases and not self._problems:
                    if "timed" in configuration.phases:
                        memory.use_allocator(None)
                        engine.start()
                        self._compile(sink, engine.simulator, "capture")
                    with _Phase(self, sink, memory, "capture", phase):
                        self._capture(sink, engine.simulator, description)
                if "timed" not in configuration.phases:
                    memory.checkpoint("final")
                memory.drain()
        except DataLost:
            memory.stop()  # the file takes nothing more
            raise
        except BaseException:
            self._end_memory(sink, memory, phase[0])
            raise
        self._end_memory(sink, memory, phase[0])

    def _end_memory(self, sink: Sink, memory: MemoryWriter, phase: str) -> None:
        memory.stop()
        if failed := memory.failures():
            self.event(sink, "NOTE", phase, failed)

    def _write_description(self, sink: Sink, scene: Scene, description: Description) -> None:
        simulation = Simulation(
            version=description.version,
            device=description.device,
            options=description.options,
            switches=description.switches,
            deviations=description.deviations,
            fields=description.fields,
            scene={"name": scene.name, "sha256": scene.sha256(), "parameters": scene.parameters},
            env_origins=description.env_origins,
            timing_covers=description.timing_covers,
            fresh_start="rebuilt after the timed phase" if "timed" in self._configuration.phases else "first build",
            buffers=description.buffers,
            counters=description.counters,
            overflow_bits=description.overflow_bits,
        )
        sink.attach(SIMULATION, "application/json", simulation.to_json().encode())
        for name, (media_type, data) in description.attachments.items():
            sink.attach(name, media_type, data)

    def _clocked(self, sink: Sink, what: str, work: Callable[[], _T]) -> _T:
        start = time.perf_counter_ns()
        done = work()
        clocks = np.array([[start], [time.perf_counter_ns()]], dtype=np.int64)
        self._write_timing(sink, what, clocks, 0, 1, _CLOCKED[what])
        return done

    def _compile(self, sink: Sink, simulator: Simulator, phase: str) -> None:
        self._clocked(sink, f"compile_{phase}", lambda: simulator.compile(phase))

    def _warm_up_and_time(
        self, sink: Sink, memory: MemoryWriter, simulator: Simulator, description: Description, phase: list[str]
    ) -> None:
        configuration = self._configuration
        covers = f"{description.timing_covers}; {_SAMPLED}"
        interval = simulator.timing_interval
        hashes = []
        counted = EvidenceWriter(
            sink, description, "timed", dt=configuration.dt, stride=max(1, configuration.timed_steps)
        )
        # The whole warm-up's clocks are kept too: its first step shows what compilation costs.
        with _Phase(self, sink, memory, "warmup", phase):
            simulator.prepare(self._handed(simulator, 0, configuration.warmup))
            clocks = self._step_with_clocks(simulator, "warmup", configuration.warmup, interval)
            hashes.append(fingerprint(simulator.state()))
            memory.checkpoint("post-warmup")
        self._write_timing(sink, "warmup", clocks, 0, interval, covers)
        if configuration.warmup:
            self._count(sink, "warmup", simulator, counted, configuration.warmup)
        self._ask_gates(sink, "warmup", simulator)
        simulator.prepare(self._handed(simulator, configuration.warmup, configuration.timed_steps))
        with _Phase(self, sink, memory, "timed", phase):
            clocks = self._step_with_clocks(simulator, "timed", configuration.timed_steps, interval)
        state = simulator.state()
        hashes.append(fingerprint(state))
        self._write_timing(sink, "timed", clocks, configuration.warmup, interval, covers)
        # Two hashes at steps that the capture may pass as well: equal ones show that capturing changed nothing.
        declare_fingerprints(sink, "timed")
        write_fingerprints(
            sink, "timed", np.stack(hashes), first_step=configuration.warmup,
            stride=configuration.timed_steps, dt=configuration.dt,
        )  # fmt: skip
        if not all(np.isfinite(array).all() for array in state):
            self._gate(
                sink, "timed", f"a state is not finite after {configuration.timed_steps} timed steps", "NOT_FINITE"
            )
        self._count(sink, "timed", simulator, counted, configuration.warmup + configuration.timed_steps)
        self._ask_gates(sink, "timed", simulator)
        self._write_action_stream(sink, "timed", simulator, configuration.warmup, configuration.timed_steps)

    def _step_with_clocks(self, simulator: Simulator, phase: str, steps: int, interval: int) -> np.ndarray:
        count = -(-steps // interval)
        clocks = np.empty((2, count), dtype=np.int64)
        clock = time.perf_counter_ns
        self._progress(phase, 0, steps)  # and not again before the last step: throughput counts what lies between
        gc.collect()
        gc.disable()  # a collection inside the timed loop would be charged to the engine
        try:
            for k in range(count):
                clocks[0, k] = clock()
                simulator.step(min(interval, steps - k * interval))
                clocks[1, k] = clock()
        finally:
            gc.enable()
        return clocks

    def _write_timing(
        self, sink: Sink, phase: str, clocks: np.ndarray, first_step: int, interval: int, covers: str
    ) -> None:
        topic = topics.timing(phase)
        sink.channel(topic, "gsb.v1.StepTiming", {"clock": "host monotonic [ns]", "covers": covers})
        message = message_class("gsb.v1.StepTiming")(
            first_step=first_step, steps_per_interval=interval, start_ns=clocks[0].tolist(), end_ns=clocks[1].tolist()
        )
        sink.write(topic, message.SerializeToString())

    def _capture(self, sink: Sink, simulator: Simulator, description: Description) -> None:
        c = self._configuration
        view = self._view(sink, simulator.scene, description) if c.view else None
        writer = self._writer = StateWriter(
            sink, description.fields, n_env=c.n_env, dt=c.dt, stride=c.stride, view=view
        )
        if simulator.scene.actions is not None:
            declare_actions(sink, simulator.scene.actions, n_env=c.n_env)
        counted = EvidenceWriter(sink, description, "capture", dt=c.dt, stride=1, workers=writer.workers)
        kept = (
            KeptStates(
                description.fields,
                n_env=c.n_env,
                rows=c.steps + 1,
                n_action=len(simulator.scene.actions.joints) if simulator.scene.actions else 0,
                workers=writer.workers,
            )
            if c.capture == "memory"
            else None
        )
        problems: list[str] = []

        def write(block: Block) -> None:
            if problems:
                return  # nothing of use follows a state that is not finite
            if block.first_step != writer.last_step + 1:
                raise ValueError(
                    f"the simulator gave states up to step {writer.last_step}, then from {block.first_step} on"
                )
            drawn = block.actions
            if drawn is not None and simulator.scene.actions is not None:
                held = block.captured.actions

                def applied(envs: range) -> NDArray[np.float32]:
                    found = held(slice(envs.start, envs.stop))
                    return drawn(envs) if found is None else found

                name, first = simulator.scene.actions.name, block.first_step - 1
                write_actions(sink, writer.workers, name, applied, n_env=c.n_env, first_step=first, dt=c.dt)
            problem = writer.take(block.captured)
            if block.first_step:
                self._gate_counts(sink, "capture", block.captured.evidence(), counted, block.first_step)
            if problem:
                problems.append(problem)

        def captured(done: int) -> None:
            interruption.check()
            self._progress("capture", done, c.steps)

        simulator.reserve(min(c.steps, writer.steps_per_block))
        # until it has finished, the sink is its thread's
        writing = Writing(kept.keep if kept else write)
        clock = CaptureClock()
        try:
            try:
                step_and_capture(
                    simulator,
                    writing,
                    clock,
                    steps=c.steps,
                    block_steps=writer.steps_per_block,
                    prepare=lambda first, count: self._prepare(simulator, first, count),
                    progress=captured,
                    stopped=lambda: bool(problems),
                )
            finally:
                try:
                    writing.finish()
                finally:
                    if kept:
                        self._progress(interruption.ENDING, 0, 1)  # however long the disk takes
                        with interruption.shielded():
                            kept.write(write)
        except DataLost:
            raise
        except BaseException:
            writer.flush()  # whatever ended the run, the states so far are good
            raise
        writer.flush()
        if writer.last_step != c.steps and not problems:
            raise ValueError(f"the simulator gave states up to step {writer.last_step}, not of all {c.steps} steps")
        clock.written()
        self._write_capture_clock(sink, clock, writer)
        if problems:
            self._gate(sink, "capture", problems[0], "NOT_FINITE")
        self._ask_gates(sink, "capture", simulator)
        if not problems:
            self._write_action_stream(sink, "capture", simulator, 0, c.steps)

    def _view(self, sink: Sink, scene: Scene, description: Description) -> ViewWriter | None:
        try:
            return ViewWriter(
                sink, self._configuration, fields=description.fields, scene=scene, env_origins=description.env_origins
            )
        except DamagedRecording as error:  # a scene of somebody else's, of which states can be recorded all the same
            self.event(sink, "NOTE", "capture", f"nothing was written for viewers: {error}")
            return None

    def _prepare(self, simulator: Simulator, first_step: int, n_step: int) -> Actions | None:
        scene, c = simulator.scene, self._configuration
        if not simulator.draws_actions:
            given = self._actions(scene, first_step, n_step)
            simulator.prepare(given)
            return None if given is None else lambda envs: given[:, envs.start : envs.stop]
        simulator.prepare(None)
        drawn = scene.actions
        if drawn is None:
            return None
        return lambda envs: drawn.draw(
            c.seed, n_env=len(envs), first_env=envs.start, first_step=first_step, n_step=n_step
        )

    def _write_capture_clock(self, sink: Sink, clock: CaptureClock, writer: StateWriter) -> None:
        c = self._configuration
        block = writer.steps_per_block * row_bytes(c.n_env, writer.fields)
        how = {
            "lossless": f"another thread writes them meanwhile; {RING_BLOCKS} blocks of at most {block} bytes are held",
            "memory": "they are kept in memory, and written after the last step",
        }
        covers = f"from block to block: steps, and their states, counts and hashes on the host; {how[c.capture]}"
        rows = writer.steps_per_block
        self._write_timing(sink, "capture", clock.blocks, 0, rows, covers)
        self._write_timing(sink, "stall", clock.stalls, 0, rows, "the engine stands still until a block was written")
        self._write_timing(
            sink, "drain", clock.drain, c.steps, 1, "from the last state on the host to that in the file"
        )

    def _count(self, sink: Sink, phase: str, simulator: Simulator, counted: EvidenceWriter, first_step: int) -> None:
        self._gate_counts(sink, phase, simulator.evidence(), counted, first_step)

    def _gate_counts(
        self, sink: Sink, phase: str, found: Evidence | None, counted: EvidenceWriter, first_step: int
    ) -> None:
        if found is not None:
            for fired in counted.feed(found, first_step=first_step):
                self._gate(sink, phase, fired, "BUFFER")

    def _write_action_stream(self, sink: Sink, phase: str, simulator: Simulator, first_step: int, n_step: int) -> None:
        if simulator.scene.actions is None:
            return
        problem = write_action_stream(
            sink,
            phase,
            simulator.scene.actions,
            seed=self._configuration.seed,
            n_env=self._configuration.n_env,
            first_step=first_step,
            n_step=n_step,
            applied=simulator.applied(),
        )
        if problem:
            self._gate(sink, phase, problem)

    def _handed(self, simulator: Simulator, first_step: int, n_step: int) -> NDArray[np.float32] | None:
        return None if simulator.draws_actions else self._actions(simulator.scene, first_step, n_step)

    def _actions(self, scene: Scene, first_step: int, n_step: int) -> NDArray[np.float32] | None:
        if scene.actions is None:
            return None
        c = self._configuration
        return scene.actions.draw(c.seed, n_env=c.n_env, first_step=first_step, n_step=n_step)

    def _ask_gates(self, sink: Sink, phase: str, simulator: Simulator) -> None:
        for fired in simulator.gates():
            self._gate(sink, phase, fired)

    def _gate(self, sink: Sink, phase: str, problem: str, cause: str = "ENGINE") -> None:
        self._problems.append((cause, problem))
        self.event(sink, "GATE", phase, problem)

    def event(self, sink: Sink, kind: str, phase: str, text: str = "") -> None:
        """Write an event of the run."""
        message = message_class("gsb.v1.Event")(
            kind=self._events[f"EVENT_KIND_{kind}"],
            phase=phase,
            monotonic_ns=time.perf_counter_ns(),
            unix_ns=clock.calendar_ns(),
            text=text,
        )
        sink.write(topics.RUN_EVENT, message.SerializeToString())
        if self._shown_log:
            self._shown_log.event(kind, message)


def _reason(error: BaseException, phase: str) -> str:
    match error:
        case KeyboardInterrupt():
            return f"interrupted in phase {phase}"
        case MemoryError():
            return f"out of host memory in phase {phase}"
        case GsbError():
            return str(error)
    return _said(error, f" in phase {phase}")


def _said(error: BaseException, where: str = "") -> str:
    text = " ".join(str(error).split()) or "no message"
    return f"{type(error).__name__}{where}: {text}"


class _Phase:
    """Marks a phase in the recording and in the memory readings."""

    def __init__(self, run: Run, sink: Sink, memory: MemoryWriter, name: str, current: list[str]) -> None:
        self._run = run
        self._sink = sink
        self._memory = memory
        self._name = name
        self._current = current

    def __enter__(self) -> None:
        interruption.check()
        self._current[0] = self._name
        self._memory.enter(self._name)
        self._run.event(self._sink, "PHASE_BEGIN", self._name)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, DataLost):
            return  # the file takes nothing more
        self._memory.leave()
        self._run.event(self._sink, "PHASE_END", self._name)
        self._memory.drain()


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
