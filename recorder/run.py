"""One run: its phases, in order, into one recording.

    baseline   nothing of the engine exists yet; memory is read
    init       the simulator is built; what it says of itself is written
    warmup     steps that are excluded from throughput; the first pays for compilation
    timed      nothing is recorded but clocks
    capture    a fresh simulator; the full state of every environment

A run that cannot finish still ends its recording, with the reason. Only a crash of the process, or a disk that takes
no more bytes, leaves a recording without an end.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recorder import interruption
from recorder.capture.actions import declare_actions, write_actions
from recorder.capture.sink import Sink
from recorder.capture.states import StateWriter, declare_fingerprints, write_fingerprints
from recorder.options import parse_options
from recorder.probes.gpu import Gpus
from recorder.probes.host import describe_host, numeric_environment, peak_rss_bytes
from recorder.probes.memory import MemorySampler
from recorder.probes.software import describe_software, package_list
from recorder.scenes.base import Scene
from recorder.scenes.registry import make_scene
from recorder.simulators.base import Description, Simulator
from recorder.simulators.registry import find_simulator
from schemas import FORMAT, topics
from schemas.configuration import RunConfiguration
from schemas.errors import DataLost, GsbError
from schemas.fingerprint import fingerprint
from schemas.messages import enum_values, message_class
from schemas.provenance import ENGINE_LOG, PACKAGES, PROVENANCE, SCENE, SIMULATION, Provenance, Simulation

Progress = Callable[[str, int, int], None]
"""Called with a phase, the steps done in it, and the steps that it has."""

_PROGRESS_STEPS = 10


@dataclass(frozen=True)
class Outcome:
    """How a run ended: COMPLETE, FAILED or INVALID, and why."""

    status: str
    reason: str
    path: Path


class Run:
    """Records one run into `path`.

    run_id     unique (UUID4)
    argv       the user's command
    created    UTC, ISO 8601
    log        returns what the engine printed so far
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
    ) -> None:
        self._configuration = configuration
        self._path = path
        self._progress = progress
        self._log = log
        self._provenance = Provenance(run_id, created, argv, configuration)
        self._problems: list[str] = []
        self._last_step = 0
        self._events = enum_values("gsb.v1.EventKind")

    def record(self) -> Outcome:
        """Run all phases. DataLost where the file cannot be written; any other failure is an Outcome."""
        sink = Sink(self._path, compression=self._configuration.compression)
        try:
            with Gpus() as gpus:
                status, reason = self._guarded(sink, gpus)
            interruption.ignore()
            if log := self._log():
                sink.attach(ENGINE_LOG, "text/plain", log)
            sink.finish(status, reason, last_step=self._last_step, peak_rss_bytes=peak_rss_bytes())
        except BaseException:
            sink.abandon()
            raise
        return Outcome(status, reason, self._path)

    def _guarded(self, sink: Sink, gpus: Gpus) -> tuple[str, str]:
        phase = ["baseline"]
        try:
            self._run_phases(sink, gpus, phase)
        except DataLost:
            raise
        except KeyboardInterrupt:
            return "FAILED", f"interrupted in phase {phase[0]}"
        except MemoryError:
            return "FAILED", f"out of host memory in phase {phase[0]}"
        except GsbError as error:
            return "FAILED", str(error)
        except Exception as error:
            text = " ".join(str(error).split()) or "no message"
            return "FAILED", f"{type(error).__name__} in phase {phase[0]}: {text}"
        if self._problems:
            return "INVALID", "; ".join(self._problems)
        return "COMPLETE", ""

    def _run_phases(self, sink: Sink, gpus: Gpus, phase: list[str]) -> None:
        configuration = self._configuration
        scene = make_scene(configuration.scene)
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
        sink.attach(SCENE, "application/json", scene.to_json().encode())
        sink.channel(topics.RUN_EVENT, "gsb.v1.Event")

        memory = _Memory(sink, MemorySampler(gpus), len(gpus))
        try:
            with _Phase(self, sink, memory, "baseline", phase):
                memory.checkpoint("baseline")
                memory.start()
            adapter = find_simulator(configuration.simulator).load()
            options = parse_options(configuration.simulator, adapter.Options, configuration.options)

            def new_simulator() -> Simulator:
                return adapter(
                    scene, n_env=configuration.n_env, dt=configuration.dt, seed=configuration.seed, options=options
                )

            with _Phase(self, sink, memory, "init", phase):
                self._progress("init", 0, 1)
                simulator = new_simulator()
                description = simulator.build()
                self._write_description(sink, scene, description)
                memory.checkpoint("post-init")
            try:
                if "timed" in configuration.phases:
                    self._warm_up_and_time(sink, memory, simulator, phase)
                    if "capture" in configuration.phases:
                        simulator.close()
                        simulator = new_simulator()
                        simulator.build()
                if "capture" in configuration.phases and not self._problems:
                    with _Phase(self, sink, memory, "capture", phase):
                        self._capture(sink, simulator, description)
                memory.checkpoint("final")
                memory.drain()
            finally:
                simulator.close()
        finally:
            memory.stop()

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
        )
        sink.attach(SIMULATION, "application/json", simulation.to_json().encode())
        for name, (media_type, data) in description.attachments.items():
            sink.attach(name, media_type, data)

    def _warm_up_and_time(self, sink: Sink, memory: _Memory, simulator: Simulator, phase: list[str]) -> None:
        configuration = self._configuration
        interval = simulator.timing_interval
        hashes = []
        # The whole warm-up's clocks are kept too: its first step shows what compilation costs.
        with _Phase(self, sink, memory, "warmup", phase):
            simulator.prepare(self._actions(simulator.scene, 0, configuration.warmup))
            clocks = self._step_with_clocks(simulator, "warmup", configuration.warmup, interval)
            hashes.append(fingerprint(simulator.state()))
            memory.checkpoint("post-warmup")
        self._write_timing(sink, "warmup", clocks, 0, interval, "")
        simulator.prepare(self._actions(simulator.scene, configuration.warmup, configuration.timed_steps))
        with _Phase(self, sink, memory, "timed", phase):
            clocks = self._step_with_clocks(simulator, "timed", configuration.timed_steps, interval)
        state = simulator.state()
        hashes.append(fingerprint(state))
        self._write_timing(sink, "timed", clocks, configuration.warmup, interval, "see simulation.json")
        # Two hashes at steps that the capture may pass as well: equal ones show that capturing changed nothing.
        declare_fingerprints(sink, "timed")
        write_fingerprints(
            sink, "timed", np.stack(hashes), first_step=configuration.warmup,
            stride=configuration.timed_steps, dt=configuration.dt,
        )  # fmt: skip
        if not all(np.isfinite(array).all() for array in state):
            self._gate(sink, "timed", f"a state is not finite after {configuration.timed_steps} timed steps")

    def _step_with_clocks(self, simulator: Simulator, phase: str, steps: int, interval: int) -> np.ndarray:
        count = -(-steps // interval)
        clocks = np.empty((2, count), dtype=np.int64)
        shown = max(1, count // _PROGRESS_STEPS)
        clock = time.perf_counter_ns
        gc.collect()
        gc.disable()  # a collection inside the timed loop would be charged to the engine
        try:
            for k in range(count):
                if k % shown == 0:
                    self._progress(phase, k * interval, steps)
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
        configuration = self._configuration
        writer = StateWriter(
            sink, description.fields, n_env=configuration.n_env, dt=configuration.dt, stride=configuration.stride
        )
        if simulator.scene.actions is not None:
            declare_actions(sink, simulator.scene.actions, n_env=configuration.n_env)
        problem = writer.feed([array[np.newaxis] for array in simulator.state()])
        while writer.last_step < configuration.steps and not problem:
            self._progress("capture", writer.last_step, configuration.steps)
            first = writer.last_step
            count = min(writer.steps_per_block, configuration.steps - first)
            actions = self._actions(simulator.scene, first, count)
            if actions is not None and simulator.scene.actions is not None:
                write_actions(sink, simulator.scene.actions.name, actions, first_step=first, dt=configuration.dt)
            simulator.prepare(actions)
            problem = writer.feed(simulator.states(count))
            self._last_step = writer.last_step
        writer.flush()
        if problem:
            self._gate(sink, "capture", problem)
        for fired in simulator.gates():
            self._gate(sink, "capture", fired)

    def _actions(self, scene: Scene, first_step: int, n_step: int) -> NDArray[np.float32] | None:
        if scene.actions is None:
            return None
        c = self._configuration
        return scene.actions.draw(c.seed, n_env=c.n_env, first_step=first_step, n_step=n_step)

    def _gate(self, sink: Sink, phase: str, problem: str) -> None:
        self._problems.append(problem)
        self.event(sink, "GATE", phase, problem)

    def event(self, sink: Sink, kind: str, phase: str, text: str = "") -> None:
        """Write an event of the run."""
        message = message_class("gsb.v1.Event")(
            kind=self._events[f"EVENT_KIND_{kind}"],
            phase=phase,
            monotonic_ns=time.perf_counter_ns(),
            unix_ns=time.time_ns(),
            text=text,
        )
        sink.write(topics.RUN_EVENT, message.SerializeToString())


class _Memory:
    """Memory readings of a run, written between phases: the sink belongs to one thread."""

    def __init__(self, sink: Sink, sampler: MemorySampler, gpu_count: int) -> None:
        self._sink = sink
        self._sampler = sampler
        metadata = {"unit": "byte", "rate": "100 Hz and at checkpoints"}
        sink.channel(topics.MEMORY_HOST, "gsb.v1.MemorySample", metadata)
        for index in range(gpu_count):
            for source in ("device", "process"):
                sink.channel(topics.gpu_memory(index, source), "gsb.v1.MemorySample", metadata)

    def start(self) -> None:
        self._sampler.start()

    def stop(self) -> None:
        self._sampler.stop()

    def checkpoint(self, name: str) -> None:
        self._sampler.checkpoint(name)

    def enter(self, phase: str) -> None:
        self._sampler.phase = phase

    def drain(self) -> None:
        sample: Any = message_class("gsb.v1.MemorySample")
        for reading in self._sampler.take():
            message = sample(
                source=reading.source,
                device=reading.device,
                monotonic_ns=reading.monotonic_ns,
                used_bytes=reading.used_bytes,
                total_bytes=reading.total_bytes,
                phase=reading.phase,
                checkpoint=reading.checkpoint,
            )
            self._sink.write(reading.topic, message.SerializeToString())


class _Phase:
    """Marks a phase in the recording and in the memory readings."""

    def __init__(self, run: Run, sink: Sink, memory: _Memory, name: str, current: list[str]) -> None:
        self._run = run
        self._sink = sink
        self._memory = memory
        self._name = name
        self._current = current

    def __enter__(self) -> None:
        self._current[0] = self._name
        self._memory.enter(self._name)
        self._run.event(self._sink, "PHASE_BEGIN", self._name)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, DataLost):
            return  # the file takes nothing more
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
