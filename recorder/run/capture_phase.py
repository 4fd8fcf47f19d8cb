"""The capture phase: a fresh simulator, and the full state of every environment into the recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import psutil

from gpusimbench.recorder import interruption
from gpusimbench.recorder.capture.actions import ActionWriter
from gpusimbench.recorder.capture.evidence import EvidenceWriter
from gpusimbench.recorder.capture.ranges import Ranges, row_bytes
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.capture.view import ViewWriter
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.recorder.capture.writing import Block, CaptureClock, Writing, step_and_capture
from gpusimbench.recorder.failure import NoHostMemory
from gpusimbench.recorder.run.given_actions import begin_anew, prepare, write_applied
from gpusimbench.recorder.run.intervention import Teacher, intervene
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.run.pace import Report
from gpusimbench.recorder.run.start import saved
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.captured import RING_BLOCKS, Held
from gpusimbench.schemas.arrays import MEDIA_TYPE
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, DataLost
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.treatment import Intervention, snapshot_name

_USABLE = 0.8  # of what the system says is available


class _Blocks:
    """Writes blocks of captured steps: states, the actions that led to them, and what the engine counted.

    problem  the first state that is not finite, after which nothing is written; empty where all are
    """

    def __init__(
        self, journal: Journal, c: RunConfiguration, states: StateWriter, simulator: Simulator, description: Description
    ) -> None:
        sink, actions, workers = journal.sink, simulator.scene.actions, states.workers
        self._journal, self._states, self._first_step = journal, states, c.first_step
        self._actions: ActionWriter | None = None
        if actions is not None:
            self._actions = ActionWriter(
                sink, workers, actions, seed=c.seed, streams=simulator.streams, dt=c.dt, n_step=c.captured_steps
            )
        self._counted = EvidenceWriter(sink, description, "capture", dt=c.dt, stride=1, workers=workers)
        self.problem = ""

    def write(self, block: Block) -> None:
        """Write the next block; nothing where a state before it is not finite."""
        if self.problem:
            return
        if block.first_step != self._states.last_step + 1:
            raise ValueError(
                f"the simulator gave states up to step {self._states.last_step}, then from {block.first_step} on"
            )
        shown = block.captured.evidence() if block.first_step > self._first_step else None
        begun: list[Callable[[], None]] = []

        def begin() -> None:
            # while this thread writes the states, others draw and digest the actions and add up the counts
            if block.actions is not None and self._actions is not None:
                begun.append(self._actions.begin(block.actions, block.captured.actions, block.first_step - 1))
            if shown is not None:
                count = self._counted.begin(shown, first_step=block.first_step)
                begun.append(lambda: self._journal.counted(count()))

        # before the actions: a file that is cut short has hashes of every step whose actions it has
        problem = self._states.take(block.captured, begin)
        for end in begun:
            end()
        self.problem = problem or ""


class CapturePhase:
    """Steps a simulator and writes all of its states.

    writer  of the states; None before the first step
    """

    def __init__(
        self,
        journal: Journal,
        configuration: RunConfiguration,
        progress: Report,
        given: bytes | None = None,
    ) -> None:
        """given: the attachment GIVEN of the run."""
        self._given = given
        self._journal = journal
        self._configuration = configuration
        self._progress = progress
        self.writer: StateWriter | None = None

    @property
    def last_step(self) -> int:
        """The last one whose state is in the file."""
        return max(0, self.writer.last_recorded_step) if self.writer else 0

    def run(self, simulator: Simulator, description: Description) -> None:
        """Step from the initial state to the last step; what speaks against the states is a gate of the journal."""
        c, sink = self._configuration, self._journal.sink
        view = self._view(simulator.scene, description) if c.view else None
        intervention = Intervention.of(c.intervention)
        writer = self.writer = StateWriter(
            sink, description.fields, n_env=c.n_env, dt=c.dt, stride=c.stride, first_step=c.first_step, view=view,
            may_fail=intervention.poisoned(c.n_env) if intervention else frozenset(),
            n_row=c.captured_steps + 1,
        )  # fmt: skip
        begin_anew(simulator, c)
        blocks = _Blocks(self._journal, c, writer, simulator, description)
        kept = None
        if c.capture == "memory":
            n_action = len(simulator.scene.actions.joints) if simulator.scene.actions else 0
            kept = StatesInMemory(
                description.fields, n_env=c.n_env, rows=c.captured_steps + 1, n_action=n_action, workers=writer.workers
            )
        snapshots: dict[int, bytes] = {}
        between = self._between(simulator, description, intervention, snapshots)
        simulator.reserve(min(c.captured_steps, writer.steps_per_block))
        writer.begin()
        clock = CaptureClock()
        try:
            self._step(simulator, writer.steps_per_block, blocks, kept, clock, between)
        except DataLost:
            raise
        except BaseException:
            writer.flush()  # whatever ended the run, the states so far are good
            self._attach(snapshots)
            raise
        writer.flush()
        self._attach(snapshots)
        if writer.last_step != c.steps and not blocks.problem:
            raise ValueError(f"the simulator gave states up to step {writer.last_step}, not of all {c.steps} steps")
        clock.written()
        self._write_clock(clock, writer)
        if blocks.problem:
            self._journal.not_finite(blocks.problem)
        self._journal.ask_gates(simulator)
        if not blocks.problem:
            write_applied(self._journal, simulator, c, c.first_step, c.captured_steps)

    def _between(
        self, simulator: Simulator, description: Description, intervention: Intervention | None,
        snapshots: dict[int, bytes],
    ) -> list[tuple[int, Callable[[], None]]]:  # fmt: skip
        """What is done between steps, and after which: states are saved to `snapshots`, environments treated."""
        c = self._configuration

        def save(step: int) -> None:
            snapshots[step] = saved(simulator)

        between = [(step, partial(save, step)) for step in c.snapshots]
        if intervention and intervention.kind.repeats:
            teacher = Teacher(self._given, simulator, description)
            between += [(step, partial(teacher.set, number)) for number, step in enumerate(intervention.stops(c.steps))]
        elif intervention and intervention.step >= c.first_step:
            between.append((intervention.step, partial(intervene, simulator, description.fields, intervention, c)))
        return sorted(between, key=lambda call: call[0])  # a snapshot of the same step comes first

    def _step(
        self, simulator: Simulator, block_steps: int, blocks: _Blocks, kept: StatesInMemory | None, clock: CaptureClock,
        between: Sequence[tuple[int, Callable[[], None]]],
    ) -> None:  # fmt: skip
        """Make all steps, and have their states written by another thread, meanwhile or afterwards."""
        c = self._configuration

        def captured(done: int) -> None:
            interruption.check()
            self._progress("capture", done, c.steps)

        # until it has finished, the sink is its thread's
        writing = Writing(kept.keep if kept else blocks.write)
        try:
            step_and_capture(
                simulator,
                writing,
                clock,
                first=c.first_step,
                last=c.steps,
                block_steps=block_steps,
                prepare=lambda first, count: prepare(simulator, c, first, count),
                progress=captured,
                stopped=lambda: bool(blocks.problem),
                between=between,
            )
        finally:
            try:
                writing.finish()
            finally:
                if kept:
                    self._progress(interruption.ENDING, 0, 1)  # however long the disk takes
                    with interruption.shielded():
                        kept.write(blocks.write)

    def _attach(self, snapshots: dict[int, bytes]) -> None:
        # not while stepping: the file is another thread's then
        for step, data in snapshots.items():
            self._journal.sink.attach(snapshot_name(step), MEDIA_TYPE, data)

    def _view(self, scene: Scene, description: Description) -> ViewWriter | None:
        try:
            return ViewWriter(
                self._journal.sink,
                self._configuration,
                fields=description.fields,
                scene=scene,
                attachments=description.attachments,
                env_origins=description.env_origins,
            )
        except DamagedRecording as error:  # a scene of somebody else's, of which states can be recorded all the same
            self._journal.event("NOTE", f"nothing was written for viewers: {error}")
            return None

    def _write_clock(self, clock: CaptureClock, writer: StateWriter) -> None:
        c = self._configuration
        block = writer.steps_per_block * row_bytes(c.n_env, writer.fields)
        how = {
            "lossless": f"another thread writes them meanwhile; {RING_BLOCKS} blocks of at most {block} bytes are held",
            "memory": "they are kept in memory, and written after the last step",
        }
        covers = f"from block to block: steps, and their states, counts and hashes on the host; {how[c.capture]}"
        rows, first = writer.steps_per_block, c.first_step
        self._journal.timing("capture", clock.blocks, first, rows, covers)
        self._journal.timing("stall", clock.stalls, first, rows, "the engine stands still until a block was written")
        self._journal.timing("drain", clock.drain, c.steps, 1, "from the last state on the host to that in the file")


class StatesInMemory:
    """Memory for the states of `rows` steps, all of it touched before the first one is made.

    n_action  numbers that an environment is given in a step

    Raises NoHostMemory where the machine has not that much to spare.
    """

    def __init__(self, fields: Sequence[StateField], *, n_env: int, rows: int, n_action: int, workers: Workers) -> None:
        need = rows * (row_bytes(n_env, fields) + n_env * n_action * np.dtype(np.float32).itemsize)
        available = int(psutil.virtual_memory().available * _USABLE)
        if need > available:
            raise NoHostMemory(
                f"--capture memory keeps {need / 1e9:.1f} GB of states, and {available / 1e9:.1f} GB may be used: "
                "capture fewer steps, or lossless"
            )
        shapes = [(rows, n_env, len(field.items), field.width) for field in fields]
        # zeros alone would give no memory yet
        self._arrays = [np.full(shape, 0, dtype=f.dtype) for shape, f in zip(shapes, fields, strict=True)]
        self._actions = np.full((rows, n_env, n_action), 0, dtype=np.float32)
        self._ranges = [slice(envs.start, envs.stop) for envs in Ranges(n_env).each]
        self._workers = workers
        self._blocks: list[Block] = []
        self._filled = 0

    def keep(self, block: Block) -> None:
        """Copy a block."""
        first = self._filled

        def copy(envs: slice) -> tuple[int, bool]:
            states, actions = block.captured.states(envs), block.captured.actions(envs)
            for kept, array in zip(self._arrays, states, strict=True):
                kept[first : first + len(array), envs] = array
            if actions is not None:
                self._actions[first : first + len(actions), envs] = actions
            return len(states[0]), actions is not None

        (count, acted) = next(iter(set(self._workers.start(copy, self._ranges))))
        rows = slice(first, first + count)
        self._filled += count
        shown = block.captured.evidence()
        captured = Held(
            tuple(array[rows] for array in self._arrays),
            None if shown is None else shown.copy(),
            self._actions[rows] if acted else None,
        )
        self._blocks.append(Block(block.first_step, captured, block.actions))

    def write(self, write: Callable[[Block], None]) -> None:
        """Have everything that was kept written, in order."""
        for block in self._blocks:
            write(block)
