"""The recording of environments on a device: rows are kept there, and blocks of them written in the background."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.array_hashes import Hashed
from gpusimbench.recorder.capture.workers import alone
from gpusimbench.recorder.capture.writing import Writing
from gpusimbench.recorder.interruption import postponed
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.vector.device.history import History, Reset, Which
from gpusimbench.recorder.vector.device.rows import OBSERVATION, Arrays, Columns, Rows, check_envs
from gpusimbench.recorder.vector.ending import Hashes
from gpusimbench.recorder.vector.fields import GIVEN, NO_STEP, NOT_GIVEN, Images, fields_of, recorded_dtype
from gpusimbench.recorder.vector.modes import FINAL, Mode
from gpusimbench.schemas.errors import DataLost

_HIDDEN = (
    "in the last step of an episode, the observation before that step stands for it: the environment returns the first "
    "observation of the next episode instead"
)


@dataclass(frozen=True)
class About:
    """What a recording says of the environments, see RecordingWriter.

    hidden       whether a reset within step hides the last observation of an episode
    attachments  of the recording
    """

    simulator: str
    version: str
    scene: str
    device: str
    mode: Mode
    hidden: bool
    options: Mapping[str, str]
    seed: int = 0
    images: Images = Images.HASH
    attachments: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)


class HostLog:
    """A recording of rows that a device kept, as they come to the host.

    path, steps, dt  as of gpusimbench.wrap
    """

    def __init__(self, path: str | Path, *, steps: int | None, dt: float, about: About) -> None:
        self._path, self._steps, self._dt, self._about = path, steps, dt, about
        self._history: History | None = None
        self._writer: RecordingWriter | None = None
        self._states = 0

    def append(self, rows: Columns, resets: Mapping[int, Reset]) -> None:
        """Write rows that follow those of the last call; see History. The first call begins the recording."""
        about = self._about
        if not len(rows["reward"]):  # all rows of a block were lost
            return
        if self._history is None:
            self._history = History(rows["reward"].shape[1], about.mode, hidden=about.hidden)
        of_images: dict[str, str] = {}
        found = about.images.recorded(self._history.completed(rows, resets), of_images, lead=2)
        if self._writer is None:
            self._writer = self._open_log({name: array[0] for name, array in found.items()}, of_images)
        self._writer.append(*(array.astype(recorded_dtype(array.dtype), copy=False) for array in found.values()))
        self._states += len(rows["reward"])

    def fingerprint(self, name: str, found: Hashed, states: int) -> None:
        """See RecordingWriter.fingerprint. What follows rows that were lost is left out."""
        assert self._writer is not None
        if states <= self._states:
            self._writer.fingerprint(name, found, states=states)

    def end(self, error: BaseException | None) -> None:
        """End the recording; an error is its reason."""
        if self._writer is not None:
            self._writer.__exit__(type(error) if error else None, error, None)

    def _open_log(self, row: Columns, of_images: Mapping[str, str]) -> RecordingWriter:
        about = self._about
        notes = {name: NO_STEP for name in row if name == "reward" or name.startswith("action")}
        notes |= {name: NOT_GIVEN for name in row if name.startswith("info/") and not name.endswith(GIVEN)}
        if about.hidden:
            notes |= {name: _HIDDEN for name in row if name.startswith(FINAL) and not name.endswith(GIVEN)}
        notes = {
            name: "; ".join(filter(None, (notes.get(name), of_images.get(name)))) for name in {**notes, **of_images}
        }
        images = {"images": about.images.value} if of_images else {}
        writer = RecordingWriter(
            self._path, simulator=about.simulator, version=about.version, scene=about.scene, device=about.device,
            n_env=len(row["reward"]), dt=self._dt, steps=self._steps, fields=fields_of(row, notes), seed=about.seed,
            options={"autoreset_mode": about.mode.value, **images, **about.options}, view=(),
            attachments=about.attachments,
        )  # fmt: skip
        return writer.__enter__()


@dataclass(frozen=True)
class _Job:
    """What the thread that writes does next."""

    work: Callable[[], None]

    def release(self) -> None:
        """Nothing is given back: arrays end with the job."""


class DeviceLog:
    """Rows of a device on their way to a recording.

    made   calls of step whose rows were given
    ended  whether the recording has ended
    """

    def __init__(self, rows: Rows, steps: int | None) -> None:
        self._rows, self._steps = rows, steps
        self._log: HostLog | None = None
        self._writing: Writing[_Job] | None = None
        self._resets: dict[int, Reset] = {}
        self._hashes = Hashes()
        self._hashed: list[tuple[str, Hashed, int]] = []  # what goes to the recording behind the rows that are there
        self._process = os.getpid()
        self.made = 0
        self.ended = False

    @property
    def begun(self) -> bool:
        """Whether there is a row."""
        return self._log is not None

    def begin(self, row: Arrays, log: HostLog) -> None:
        """Begin the recording with the observations of a reset, and 0 for what only steps give.

        UsageError where arrays are none, or not of all environments.
        """
        check_envs(row)
        self._rows.keep(row)
        try:
            # as the thread that writes the other rows: another process does the work, or this thread alone
            with alone():
                log.append(self._rows.take()(), {})
        except BaseException as error:
            log.end(error)
            raise
        self._log, self._writing = log, Writing(lambda job: job.work(), alone=True)
        self._process = os.getpid()
        self._hashes.begin(log.fingerprint)

    def make_room(self) -> None:
        """Have a full block written; called before the environment makes the step of the next row."""
        if self._rows.full:
            self._write()

    def keep(self, row: Arrays) -> None:
        """The row of a step. The last one ends the recording, unless arrays may still be hashed."""
        self._rows.keep(row)
        self.made += 1
        if self.made == self._steps and not self._hashes.given:
            self.end(None)

    def replace(self, row: Arrays, which: Which | NDArray[np.bool_]) -> None:
        """The last row's observations are others, since the user reset environments. UsageError as of Rows.check."""
        self._rows.check(row)
        at = self._rows.filled - 1
        former = self._resets.get(at)  # of other environments, or of the same ones
        before = former.before if former else self._rows.last([n for n in row if n.startswith(OBSERVATION)])
        self._rows.replace(row)
        self._resets[at] = Reset((*(former.which if former else ()), which), before)

    def fingerprint(self, name: str, arrays: Any, *, reset: bool) -> None:
        """See Ending.fingerprint.

        reset  whether environments were reset before the first step
        """
        if self.begun and not self.ended:
            self._check_process()
        states = self.made + 1 if self.begun or reset else 0
        write = (lambda *found: self._hashed.append(found)) if self.begun else None
        self._hashes.take(name, arrays, states=states, ended=self.ended, write=write)

    def past_the_end(self) -> None:
        """A step is called; the recording ends where it has all of its steps."""
        if self.made == self._steps:
            self.end(None)

    def end(self, error: BaseException | None) -> None:
        """Write what is there, and end the recording; an error is its reason. An interruption waits until then."""
        with postponed():
            self._end(error)

    def _end(self, error: BaseException | None) -> None:
        if self.ended or self._log is None or self._writing is None:
            return
        self.ended = True
        if self._copied:
            return
        try:
            self._write()
        except BaseException as second:  # also one that a handler of a signal raises: rows are missing then
            error = error or second
            raise
        finally:
            try:
                self._writing.finish()
            except BaseException as second:
                error = error or second
                raise
            finally:
                self._log.end(error)

    def _write(self) -> None:
        with postponed():  # rows that were taken and not put would be missing
            log, resets, self._resets = self._log, self._resets, {}
            found, self._hashed = self._hashed, []
            if log is None or not (self._rows.filled or found):
                return
            rows = self._rows.take() if self._rows.filled else dict

            def write() -> None:
                if taken := rows():
                    log.append(taken, resets)
                for hashes in found:
                    log.fingerprint(*hashes)

            self._put(write)
            if self._rows.lost is not None:
                raise self._rows.lost

    @property
    def _copied(self) -> bool:
        # a copy of the process that records (os.fork) lacks the thread that writes
        return os.getpid() != self._process

    def _check_process(self) -> None:
        if self._copied:
            raise DataLost("this process is a copy (os.fork) of the one that records: it writes nothing")

    def _put(self, work: Callable[[], None]) -> None:
        assert self._writing is not None
        self._check_process()
        self._writing.wait(1)
        self._writing.put(_Job(work))
