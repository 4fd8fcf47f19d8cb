"""Recordings of programs that are no adapter: any program that has states can log them, without a base class.

    with RecordingWriter(
        "run-0.mcap", simulator="mine", version="1.0", scene="toss", n_env=4, dt=0.01, steps=100,
        fields=(body_field("cubes", "position", "float32", ("red", "blue")),),
    ) as log:
        log.append(positions)                # [env, item, 3]: the first state, at step 0
        for _ in range(100):
            positions = simulate(...)
            log.append(positions)

The file is what ``gsb-record`` writes, with the same provenance, and ``gsb-eval`` reads it. Nothing is measured here:
clocks of steps come from the program (``clocks``), memory is not read.
"""

from __future__ import annotations

import math
import sys
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpusimbench.recorder.announced import Announced
from gpusimbench.recorder.capture.array_hashes import ArrayHashWriter, Hashed, checked_name, hashed
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.capture.view import ViewWriter
from gpusimbench.recorder.failure import cause_of
from gpusimbench.recorder.interruption import postponed
from gpusimbench.recorder.plan import utc_now
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.host import describe_host, describe_software, numeric_environment, peak_rss_bytes
from gpusimbench.recorder.programs.folder import placed
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration, open_end
from gpusimbench.schemas.errors import DamagedRecording, DataLost, UsageError
from gpusimbench.schemas.fields import ENV, StateField
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import (
    LOGGED,
    PROVENANCE,
    Deviation,
    Provenance,
    Simulation,
)
from gpusimbench.schemas.text import stored_text


def closed(sink: Sink, provenance: Provenance, last_step: int) -> RunConfiguration:
    """Write the number of steps into the provenance, which lies at the beginning of the file; spaces fill it up.

    last_step  that was recorded; a recording without one has the fewest steps that there can be

    Returns the configuration with that number.
    """
    before = provenance.configuration
    configuration = replace(before, steps=max(before.stride, last_step))
    data = replace(provenance, configuration=configuration).to_json().encode()
    sink.rewrite(PROVENANCE, data.ljust(len(provenance.to_json().encode())))
    return configuration


class RecordingWriter:
    """Writes one recording; a context manager.

    The end of the block ends the recording: complete, where every state and clock that was announced is there; invalid,
    where a state was not finite or ``invalid`` was called; failed, with the reason, where something is missing or an
    error left the block, which goes on its way.

    path           final name; must not exist, and its folder must. In a run of gsb-run, a relative path lies in the
                   folder of the run
    simulator      name of what computed the states; runs of one name, version and configuration are compared
    version        of it
    scene          a description, or a name where there is none; cubes and boards are found only in a description
    n_env, dt      environments, and the step [s]
    steps          captured after the first state; None: those of which states are given until the block ends
    fields         layout of the state, as recorder.simulators.base.Description has it (schemas.fields.body_field);
                   observations, actions, rewards and flags are arrays (schemas.fields.array_field), images are
                   hashes of frames (schemas.images)
    device         "cpu", or the name of the GPU that steps
    stride         every how many steps a state is recorded; divides `steps`
    warmup         steps before the timed ones
    timed_steps    steps that ``clocks`` will tell the duration of; 0: none
    timing_covers  what lies between two clock readings
    options        whatever was set, by name: plain values
    switches       whatever decides which numbers come out
    deviations     parameters of the scene that were not honoured
    env_origins    origin of each environment [m]; empty where all are at zero
    attachments    files worth keeping: name -> (media type, bytes)
    view           environments that viewers such as Foxglove and rerun show, at most 4; where there is nothing to show,
                   because no state is a position, nothing is written for viewers

    UsageError for a configuration that cannot be.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        simulator: str,
        version: str,
        scene: Scene | str,
        n_env: int,
        dt: float,
        steps: int | None,
        fields: Sequence[StateField],
        device: str = "cpu",
        stride: int = 1,
        run_index: int = 0,
        seed: int = 0,
        warmup: int = 0,
        timed_steps: int = 0,
        timing_covers: str = "",
        options: Mapping[str, Any] | None = None,
        switches: Mapping[str, Any] | None = None,
        deviations: Sequence[Deviation] = (),
        env_origins: Sequence[tuple[float, float, float]] = (),
        compression: str = "none",
        attachments: Mapping[str, tuple[str, bytes]] | None = None,
        view: Sequence[int] = (0,),
    ) -> None:
        self.path = placed(path)
        options = dict(options or {})
        described = scene if isinstance(scene, Scene) else None
        name = scene.name if isinstance(scene, Scene) else scene
        configuration = RunConfiguration(
            simulator=simulator,
            scene=name,
            n_env=n_env,
            dt=dt,
            steps=open_end(stride) if steps is None else steps,
            stride=stride,
            warmup=warmup,
            timed_steps=timed_steps,
            phases=("timed", "capture") if timed_steps else ("capture",),
            seed=seed,
            run_index=run_index,
            compression=compression,
            view=tuple(view),
            options={name: str(value) for name, value in options.items()},
        )
        simulation = Simulation(
            version=version,
            device=device,
            options=options,
            switches=dict(switches or {}),
            deviations=tuple(deviations),
            fields=tuple(fields),
            scene={
                "name": name,
                "sha256": described.sha256() if described else "",
                "parameters": described.parameters if described else {},
            },
            env_origins=tuple(env_origins),
            timing_covers=timing_covers,
            fresh_start=LOGGED,
        )
        self._announced = Announced(
            configuration, simulation, described, dict(attachments or {}), open_end=steps is None
        )
        self._announced.check()
        self._problems: list[tuple[str, str]] = []  # cause and sentence
        self._clocked = False
        self._within = False  # the block of the recording

    def __enter__(self) -> Self:
        """Open the file and write what is known. UsageError where it cannot be made."""
        c = self._announced.configuration
        with Gpus() as gpus:
            self._provenance = Provenance(
                run_id=str(uuid.uuid4()),
                created_utc=utc_now(),
                argv=tuple(stored_text(text) for text in sys.argv),
                configuration=c,
                host=describe_host(),
                gpus=gpus.describe(),
                software=describe_software(),
                environment=numeric_environment(),
            )
        attached = self._announced.attached(self._provenance)
        self._sink = Sink(self.path, compression=c.compression, early=True)
        try:
            for name, (media_type, data) in attached.items():
                self._sink.attach(name, media_type, data)
            self._states = StateWriter(
                self._sink, self.fields, n_env=c.n_env, dt=c.dt, stride=c.stride, view=self._view(),
                n_row=None if self._announced.open_end else c.steps + 1,
            )  # fmt: skip
            self._arrays = ArrayHashWriter(self._sink)
        except BaseException as error:
            self._sink.abandon()
            if isinstance(error, UsageError):  # nothing is recorded yet, and the same path may be tried again
                self._sink.partial.unlink(missing_ok=True)
            raise
        self._within = True
        return self

    def _view(self) -> ViewWriter | None:
        a = self._announced
        if not a.configuration.view:
            return None
        try:
            return ViewWriter(
                self._sink, a.configuration, fields=self.fields, scene=a.scene, attachments=a.attachments,
                env_origins=a.simulation.env_origins,
            )  # fmt: skip
        except DamagedRecording:
            return None

    @property
    def fields(self) -> tuple[StateField, ...]:
        """Layout of the state."""
        return self._announced.simulation.fields

    def append(self, *arrays: ArrayLike) -> None:
        """The state after one step, or after several: one array a field, [env, item, width] or with a step axis first.

        An array of environments (schemas.fields.array_field) is given in its own shape, [env, ...] or [step, env, ...].
        The very first is the state at step 0. Numbers are recorded as they are, so that the dtype is the field's.
        UsageError for other shapes, another dtype, and more states than were announced; DataLost in a forked process.
        """
        self._sink.check_process()
        fields, end = self.fields, self._announced.configuration.steps
        if len(arrays) != len(fields):
            raise UsageError(f"there are {len(fields)} fields, and {len(arrays)} arrays were given")
        rows = [self._rows(field, array) for field, array in zip(fields, arrays, strict=True)]
        counts = {len(array) for array in rows}
        if len(counts) != 1:
            raise UsageError(f"the arrays have different numbers of steps: {sorted(counts)}")
        given = counts.pop()
        if not given:
            raise UsageError("the arrays have no step")
        last = self._states.last_step + given
        if last > end:
            raise UsageError(f"step {last} is given, and the recording was announced to end at step {end}")
        with postponed():
            problem = self._states.feed(rows)
        if problem and not any(cause == "NOT_FINITE" for cause, _ in self._problems):  # later ones follow from it
            self._problems.append(("NOT_FINITE", problem))

    def _rows(self, field: StateField, given: ArrayLike) -> NDArray[np.floating]:
        array = np.asarray(given)  # of which nothing is kept: rows that wait for a full block are copied
        shape = (self._announced.configuration.n_env, len(field.items), field.width)
        if array.dtype != field.dtype:
            raise UsageError(f"{field.name} is {array.dtype}, and was announced as {field.dtype}")
        if field.group == ENV and array.ndim and array.shape[-3:] != shape:
            lead = 1 if array.shape[0] == shape[0] and math.prod(array.shape[1:]) == field.width else 2
            if array.shape[lead - 1 : lead] == shape[:1] and math.prod(array.shape[lead:]) == field.width:
                array = array.reshape(*array.shape[:lead], 1, field.width)
        if array.shape[-3:] != shape or array.ndim not in (3, 4):
            raise UsageError(
                f"{field.name} has shape {array.shape}, not [env, item, width] = {shape}, or with steps first"
            )
        return array.reshape(-1, *shape)

    def clocks(self, start_ns: ArrayLike, end_ns: ArrayLike, *, steps_per_interval: int = 1) -> None:
        """When each interval of the timed steps began and ended, by one monotonic clock [ns], shape [interval].

        The last interval may have fewer steps. UsageError where they are not those of `timed_steps`.
        """
        c = self._announced.configuration
        given = np.asarray(start_ns), np.asarray(end_ns)
        if any(array.dtype.kind not in "iu" for array in given):
            raise UsageError("clocks are whole nanoseconds, such as time.perf_counter_ns() gives")
        start, end = (array.astype(np.int64) for array in given)
        if self._clocked or not c.timed_steps:
            raise UsageError("clocks are given once, and only where timed_steps says of how many steps")
        expected = -(-c.timed_steps // steps_per_interval) if steps_per_interval > 0 else 0
        if start.shape != (expected,) or end.shape != (expected,):
            raise UsageError(
                f"{c.timed_steps} steps in intervals of {steps_per_interval} have {expected} begins and ends, "
                f"not {start.shape} and {end.shape}"
            )
        if (end <= start).any() or (start[1:] < end[:-1]).any():
            raise UsageError(
                "clocks run backwards or stand still: an interval ends after it begins, and before the next one begins"
            )
        topic = topics.timing("timed")
        covers = {"clock": "monotonic [ns]", "covers": self._announced.simulation.timing_covers}
        self._sink.channel(topic, "gsb.v1.StepTiming", covers)
        message = message_class("gsb.v1.StepTiming")(
            first_step=c.warmup, steps_per_interval=steps_per_interval, start_ns=start.tolist(), end_ns=end.tolist()
        )
        with postponed():
            self._sink.write(topic, message.SerializeToString())
            self._clocked = True

    def fingerprint(self, name: str, arrays: Any, *, states: int | None = None) -> None:
        """Hash arrays that the program has at an update: a policy, an optimizer, a gradient, a batch.

        Two recordings of one program then tell which of these differed first, and whether states did before. Of each
        array, 8 bytes a call are recorded, none of its numbers.

        name    lower-case letters, digits and underscores; calls of one name are compared with each other in order
        arrays  an array, or nested dicts, tuples and lists of them; of numpy, torch, JAX and what has __array__
        states  that precede the call; None: those that were given to `append`

        UsageError for another name, for arrays of other kinds than real numbers and truth values, and outside of the
        block of the recording, where nothing would be recorded.
        """
        if not self._within:
            raise UsageError(
                "fingerprint is called within the block of the recording: 'with RecordingWriter(...) as log:'"
            )
        found = arrays if isinstance(arrays, Hashed) else hashed(arrays, checked_name(name))
        with postponed():
            self._arrays.write(name, found, states=self._states.last_step + 1 if states is None else states)

    def invalid(self, reason: str) -> None:
        """Declare that the states mean nothing, in one sentence: contacts were dropped, a solver gave up."""
        self._problems.append(("ENGINE", reason))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the recording, in the process that began it alone. DataLost where the file cannot be written."""
        self._within = False
        if self._sink.copied:
            return
        with postponed():
            try:
                if isinstance(error, DataLost) and self._sink.stopped:  # and not rows that never came to the file
                    self._sink.abandon()
                    return
                self._states.flush()
                if self._announced.open_end:
                    made = closed(self._sink, self._provenance, self._states.last_recorded_step)
                    self._announced = replace(self._announced, configuration=made)
                status, reason, cause = self._outcome(error)
                last = max(0, self._states.last_recorded_step)
                self._sink.finish(status, reason, cause=cause, last_step=last, peak_rss_bytes=peak_rss_bytes())
            except BaseException:
                self._sink.abandon()
                raise
            finally:
                self._states.workers.end()

    def _outcome(self, error: BaseException | None) -> tuple[str, str, str]:
        if error is not None:
            return "FAILED", f"{type(error).__name__}: {' '.join(str(error).split()) or 'no message'}", cause_of(error)
        c, done = self._announced.configuration, self._states.last_step
        if self._problems:
            return "INVALID", "; ".join(dict.fromkeys(text for _, text in self._problems)), self._problems[0][0]
        if done < c.steps:
            return "FAILED", f"states end at step {done} of {c.steps}" if done >= 0 else "no state was given", "ENGINE"
        if c.timed_steps and not self._clocked:
            return "FAILED", f"{c.timed_steps} timed steps were announced, and no clocks were given", "ENGINE"
        return "COMPLETE", "", ""
