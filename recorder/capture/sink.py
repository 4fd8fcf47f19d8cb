"""The file being written: an MCAP under a name ending in .partial until it is whole.

The end record is the last message; only then is the file finished, flushed to the disk, renamed and its folder
flushed. So a file under its final name is whole and says how the run ended, and whatever a crash leaves behind keeps
its .partial name and, but for a crash in the moment before the renaming, has no end record.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.plan import partial_of, publish
from gpusimbench.recorder.probes.host import calendar_ns
from gpusimbench.schemas import FORMAT, __version__, topics
from gpusimbench.schemas.configuration import EPOCH_NS
from gpusimbench.schemas.digest import ContentDigest, content_hash
from gpusimbench.schemas.errors import DamagedRecording, DataLost, UsageError
from gpusimbench.schemas.mcap.assembly import NextMessages, Records
from gpusimbench.schemas.mcap.writer import McapWriter, Part
from gpusimbench.schemas.messages import embedded_schema, enum_values, message_class
from gpusimbench.schemas.writing import create, reopen

_WRITEBACK_BYTES = 32 << 20
_PAGE = 4096  # the last one gets more data yet


class Writeback:
    """Has the operating system begin to write a file's data, 32 MiB at a time: so os.fsync has little left at the end.

    A thread asks for it, since a slow disk makes the caller wait. Nothing depends on it: os.fsync tells whether all
    data are on the disk, and what the disk did not take.

    descriptor  of the file
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._begun = 0  # bytes
        self._thread: threading.Thread | None = None

    def wrote(self, end: int) -> None:
        """The file has so many bytes."""
        end -= end % _PAGE
        if end - self._begun < _WRITEBACK_BYTES or (self._thread is not None and self._thread.is_alive()):
            return
        thread = threading.Thread(
            target=_begin, args=(self._descriptor, self._begun, end), name="writeback", daemon=True
        )
        with suppress(RuntimeError):  # the system has no thread left
            thread.start()
            self._begun, self._thread = end, thread

    def end(self) -> None:
        """Return once the thread does not need the descriptor any more."""
        if self._thread is not None:
            self._thread.join()


def _begin(descriptor: int, begin: int, end: int) -> None:
    # Linux begins to write the pages of the range, and forgets those that are on the disk: of the newest ones, none
    if hasattr(os, "posix_fadvise"):
        with suppress(OSError):
            os.posix_fadvise(descriptor, begin, end - begin, os.POSIX_FADV_DONTNEED)


class Sink:
    """Writes one recording.

    profile      of the file, one of PROFILES; may be set before the first record is written

    path         final name; the file must not exist
    compression  a key of COMPRESSIONS
    reserved     the .partial file is there already, empty, made for this recording (see recorder.plan.reserve)
    early        data begin their way to the disk while the file is written: `finish` waits less for the disk, and
                 writing at full speed takes up to 5 % longer
    """

    def __init__(self, path: Path, *, compression: str, reserved: bool = False, early: bool = False) -> None:
        self.path = path
        self.partial = partial_of(path)
        if path.exists():
            raise UsageError(f"{path} exists already; recordings are never overwritten")
        try:
            # closed by finish or abandon
            self._stream = reopen(self.partial) if reserved else create(self.partial)
        except FileExistsError:
            raise UsageError(f"{self.partial} exists already; another recorder may be writing it") from None
        except OSError as error:
            raise UsageError(f"cannot write to {path.parent}: {error.strerror}") from None
        if os.fstat(self._stream.fileno()).st_size:
            self._stream.close()
            raise UsageError(f"{self.partial} is not empty; another recorder may be writing it")
        self._writeback = Writeback(self._stream.fileno()) if early else None
        self._digest = ContentDigest()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self._began_ns = time.perf_counter_ns()
        self._compression = compression
        self._lost = ""  # why nothing is written any more
        self._process = os.getpid()
        self._at_end: list[Callable[[], None]] = []
        self.profile = FORMAT

    @cached_property
    def _writer(self) -> McapWriter:
        library = f"gpusimbench {__version__}"
        return McapWriter(self._stream, profile=self.profile, library=library, compression=self._compression)

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """A short list of texts for tools that show no more; never read back by the evaluator."""
        with self._disk():
            self._writer.metadata(name, values)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """An attachment, part of the recording's identity."""
        now = calendar_ns()
        with self._disk():
            self._digest.attachment(name, data)
            self._writer.attachment(name, media_type, data, log_time=now, create_time=now)

    def rewrite(self, name: str, data: bytes) -> None:
        """Other data of the same size in place of those of an attachment, such as what is known only at the end."""
        with self._disk():
            self._digest.attachment(name, data)
            self._writer.rewrite_attachment(name, data)

    def channel(self, topic: str, message: str, metadata: dict[str, str] | None = None) -> None:
        """Declare a topic and the message type that it carries. UsageError where no reader would take it."""
        with self._disk():
            if message not in self._schemas:
                self._schemas[message] = self._writer.schema(message, "protobuf", embedded_schema(message))
            try:
                self._channels[topic] = self._writer.channel(topic, self._schemas[message], metadata or {})
            except DamagedRecording as error:
                raise UsageError(f"{topic[:60]} has too long a name, or too many numbers: {error}") from None

    def write(self, topic: str, data: bytes, *, sim_ns: int | None = None) -> None:
        """A serialised message on a declared topic.

        sim_ns  simulated time [ns]; None for messages about the run itself, which are placed by the time since its
                beginning
        """
        elapsed = time.perf_counter_ns() - self._began_ns if sim_ns is None else sim_ns
        # Digest, sequence and bytes go together: an interruption between them would make a good file look damaged.
        with self._disk():
            if topic != topics.RUN_END:
                self._digest.message(topic, data)
            self._message(topic, data, EPOCH_NS + elapsed)

    def write_parts(self, topic: str, parts: Sequence[Part], *, sim_ns: int) -> None:
        """A serialised message in parts, whose content is digested by the caller (`digest`): states and actions.

        The parts must not change before `flush`.
        """
        with self._disk():
            self._message(topic, parts, EPOCH_NS + sim_ns)

    def write_together(self, topic_names: Iterable[str], messages: Iterable[Sequence[Part]], *, sim_ns: int) -> None:
        """The same of one message of each topic, in this order, as each comes."""
        with self._disk():
            for topic, parts in zip(topic_names, messages, strict=True):
                self._message(topic, parts, EPOCH_NS + sim_ns)

    def place(self, topic_names: Sequence[str], size: int) -> NextMessages | None:
        """Where records of one message of each topic, in this order, would begin; None where they cannot be appended.

        size  bytes that the first message has at least
        """
        if self._compression != "none":
            return None
        with self._disk():
            if not self._writer.make_room(size):
                return None
            return NextMessages(
                self._writer.offset,
                [self._channels[topic] for topic in topic_names],
                [self._sequence.get(topic, 0) for topic in topic_names],
                calendar_ns(),
            )

    def append(self, topic_names: Sequence[str], records: Records) -> None:
        """Write messages whose records were made for a `place`; nothing was written since. Otherwise as write_parts."""
        with self._disk():
            for topic in topic_names:
                self._sequence[topic] = self._sequence.get(topic, 0) + 1
            self._writer.append(records)

    def view(self, topic: str, data: bytes, *, log_time: int | None = None) -> None:
        """A serialised message of the view; no digest covers it, since it follows from what others cover.

        log_time  [ns]; None for lines of the log, which are placed by the time since the recording's beginning
        """
        now = EPOCH_NS + time.perf_counter_ns() - self._began_ns
        with self._disk():
            self._message(topic, data, now if log_time is None else log_time)

    def flush(self) -> None:
        """Hand all that was written to the operating system: only a crash of the machine can lose it now."""
        with self._disk():
            self._writer.flush()
            if self._writeback is not None:
                self._writeback.wrote(self._stream.tell())

    def _message(self, topic: str, data: bytes | Sequence[Part], log_time: int) -> None:
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + 1
        channel = self._channels[topic]
        self._writer.message(channel, data, log_time=log_time, publish_time=calendar_ns(), sequence=sequence)

    @property
    def copied(self) -> bool:
        """Whether this process is a copy (os.fork) of the one that records, without its threads."""
        return os.getpid() != self._process

    def check_process(self) -> None:
        """DataLost in a copy of the process that records: what it wrote would end up among what that one writes."""
        if self.copied:
            raise DataLost(f"this process is a copy (os.fork) of the one that records {self.path}: it writes nothing")

    @property
    def digest(self) -> ContentDigest:
        """Digests of what was written so far."""
        return self._digest

    def finish(self, status: str, reason: str, *, last_step: int, peak_rss_bytes: int, cause: str = "") -> Path:
        """Write the end record, make the file durable and give it its final name.

        status  COMPLETE, FAILED or INVALID
        cause   a name of gsb.v1.Cause; empty when complete
        """
        with self.parting():
            digests = self._digest.digests()
        end: Any = message_class("gsb.v1.RunEnd")(
            status=enum_values("gsb.v1.RunStatus")[f"RUN_STATUS_{status}"],
            reason=reason,
            last_step=last_step,
            digests=digests,
            content_hash=content_hash(digests, status.lower(), reason),
            peak_rss_bytes=peak_rss_bytes,
            cause=enum_values("gsb.v1.Cause")[f"CAUSE_{cause or 'UNSPECIFIED'}"],
        )
        self.channel(topics.RUN_END, "gsb.v1.RunEnd")
        self.write(topics.RUN_END, end.SerializeToString(deterministic=True))
        with self._disk():
            self._writer.finish()
            self._end_writeback()
            os.fsync(self._stream.fileno())
            self._stream.close()
            publish(self.path)
        self._end_helpers()
        return self.path

    def lost(self, error: BaseException) -> DataLost:
        """The error by which the recording stops, here and wherever more is written: a file that lacks something gets
        no good end, even if the caller goes on."""
        unnamed = "out of host memory" if isinstance(error, MemoryError) else type(error).__name__
        what = getattr(error, "strerror", None) or str(error) or unnamed
        try:
            written = self.partial.stat().st_size
            left = f"what was written is in {self.partial}" if written else "nothing was written"
        except OSError:
            left = f"{self.partial} is there no more"
        self._lost = f"writing stopped: {what}; {left}"
        return DataLost(self._lost)

    @contextmanager
    def parting(self) -> Iterator[None]:
        """Where digests are fed before the bytes that they are of are written: an error in between is one of `lost`.

        What is no error, such as what a handler of a signal raises, leaves the file without a good end, too.
        """
        try:
            yield
        except DataLost:
            raise
        except BaseException as error:
            lost = self.lost(error)
            if isinstance(error, Exception):
                raise lost from error
            raise

    @property
    def stopped(self) -> bool:
        """Whether the file takes no more."""
        return bool(self._lost)

    def abandon(self) -> None:
        """Close the file as it is: without an end record and under its .partial name."""
        self._end_writeback()
        with suppress(OSError):  # the error that led here is the one to report
            self._stream.close()
        self._end_helpers()

    def at_end(self, call: Callable[[], None]) -> None:
        """Have this called once nothing more is written: it ends what helps to write."""
        self._at_end.append(call)

    def _end_helpers(self) -> None:
        while self._at_end:
            self._at_end.pop()()

    def _end_writeback(self) -> None:
        if self._writeback is not None:
            self._writeback.end()

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Whole writes only, and one clear message where the disk takes no more."""
        if self._lost:
            raise DataLost(self._lost)
        self.check_process()
        try:
            with shielded():
                yield
        except OSError as error:
            raise self.lost(error) from None
