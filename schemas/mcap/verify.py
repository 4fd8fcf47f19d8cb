"""Whether a file's bytes are those that were written: the CRC of the data section and those of all chunks."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.schemas.errors import FailedCrc
from gpusimbench.schemas.mcap.contents import MAX_INDEX_BYTES, Contents, Message
from gpusimbench.schemas.mcap.crc import combine
from gpusimbench.schemas.mcap.declarations import Declarations
from gpusimbench.schemas.mcap.records import INDEX_ENTRY, RECORD_HEAD, Attachment, Cursor, Op
from gpusimbench.schemas.mcap.walk import Head, MessageHead, Walk, data_crc

_EXPECTED = (
    Op.HEADER,
    Op.SCHEMA,
    Op.CHANNEL,
    Op.CHUNK,
    Op.MESSAGE_INDEX,
    Op.ATTACHMENT,
    Op.METADATA,
)  # of a file that has an index


def verify(contents: Contents, moved: Callable[[float], None]) -> None:
    """DamagedRecording names the first thing that is not as it was written.

    Of a file that was opened through its summary, also that nothing lies beside what the summary says.

    moved  is told the bytes of every chunk that was checked
    """
    contents.chunks.forget()
    _Verification(contents, moved).run()
    contents.source.confirm()


class _Verification:
    def __init__(self, contents: Contents, moved: Callable[[float], None]) -> None:
        self._contents = contents
        self._moved = moved
        self._walk = Walk(contents.source)
        self._attachments = {a.record: a for a in contents.attachments.values()}
        self._beside, self._inside = Declarations(contents.place), Declarations(contents.place)
        self._inside.schemas.update(contents.declared.schemas)
        self._chunks = 0  # that were visited
        self._listed: dict[int, int] = {}  # by channel, where the messages of the last of them are listed
        self._crc = self._position = 0  # CRC of the bytes up to a position

    def run(self) -> None:
        """Visit all records of the data section."""
        contents = self._contents
        end = contents.source.size if contents.data_end is None else contents.data_end
        for head in self._walk.heads():
            if head.begin >= end:
                break
            self._visit(head, end)
        self._close_chunk()
        if contents.indexed and self._walk.end < end:
            raise contents.damaged(f"what follows at byte {self._walk.end} is no record of the file's index")
        if self._chunks < len(contents.chunks):
            raise contents.damaged(f"the chunk at byte {self._expected(end)} is not where the file's index says")
        if not contents.declared.covers(self._beside):
            raise contents.damaged(
                "a channel or schema that is declared beside the chunks is not so in the file's index"
            )
        if not contents.declared.covers(self._inside):
            raise contents.damaged("a channel or schema that is declared in a chunk is not so in the rest of the file")
        self._add_crc(end)
        if contents.data_crc and self._crc != contents.data_crc:
            raise FailedCrc(f"{contents.place}: the data section fails its CRC")

    def _visit(self, head: Head, end: int) -> None:
        if head.opcode == Op.CHUNK and head.begin == self._expected(end):
            self._close_chunk()
            self._visit_chunk()
        elif self._contents.indexed:
            if head.end > self._expected(end):
                raise self._contents.damaged(f"a record at byte {head.begin} reaches into the next")
            self._visit_beside(head)

    def _expected(self, end: int) -> int:
        # where the next chunk begins, or what follows the last
        chunks = self._contents.chunks
        return chunks[self._chunks].at if self._chunks < len(chunks) else end

    def _visit_chunk(self) -> None:
        contents, number = self._contents, self._chunks
        chunk = contents.chunks[number]
        self._add_crc(chunk.begin)
        data, known = contents.chunks.open(number)
        # what a chunk declares, which nobody looks at where an index says what is in it, and other readers do
        messages: list[MessageHead] = []
        for record in self._walk.within(data, chunk.at, messages):
            if record.opcode != Op.MESSAGE:
                self._inside.take(record)
        if chunk.compression or not known:
            self._add_crc(chunk.end)
        else:
            self._crc, self._position = combine(self._crc, known, len(data)), chunk.end
        self._chunks += 1
        self._moved(chunk.end - chunk.begin)

    def _add_crc(self, end: int) -> None:
        if self._contents.data_crc:
            self._crc = data_crc(self._contents.source, self._position, end, self._crc)
        self._position = end

    # -- of a file that was opened through its summary: nothing that a walk would take for something else than that does

    def _close_chunk(self) -> None:
        if self._contents.indexed and self._chunks:
            known = self._contents.index[self._chunks - 1]
            if self._listed != dict(zip(known.channels, known.places, strict=True)):
                raise self._contents.damaged(
                    f"the index of the messages behind byte {known.chunk.end} is not what the file's index says"
                )
        self._listed = {}

    def _visit_beside(self, head: Head) -> None:
        if head.opcode == Op.MESSAGE_INDEX and self._chunks:
            channel = self._check_index(head.begin, self._chunks - 1)
            if channel in self._listed:
                raise self._contents.damaged(f"the messages of a channel are listed twice, at byte {head.begin} again")
            self._listed[channel] = head.begin
        elif head.opcode == Op.ATTACHMENT:
            self._check_attachment(self._attachments.get(head.begin + RECORD_HEAD), head)
        elif head.opcode in (Op.SCHEMA, Op.CHANNEL):
            self._beside.take(self._contents.read_record(head.begin, MAX_INDEX_BYTES))
        elif head.opcode <= Op.DATA_END and head.opcode not in _EXPECTED or head.opcode in (Op.CHUNK, Op.MESSAGE_INDEX):
            raise self._contents.damaged(
                f"a record of type {head.opcode} at byte {head.begin} is not in the file's index"
            )

    def _check_index(self, position: int, number: int) -> int:
        # An index of messages points to messages of its channel, where it is never read, too; returns the channel.
        contents = self._contents
        channel, entries = contents.read_record(position, MAX_INDEX_BYTES).message_index(contents.place)
        data, _ = contents.chunks.open(number)
        for log_time, offset in INDEX_ENTRY.iter_unpack(entries):
            contents.content(Message(channel, log_time, number, offset), contents.record_in(data, offset))
        if contents.sole(number):
            expected = INDEX_ENTRY.pack(contents.index[number].first_time, contents.sole_offset(data))
            if entries != expected:
                raise contents.damaged(
                    f"the index at byte {position} and the file's disagree on the chunk's only message"
                )
        return channel

    def _check_attachment(self, known: Attachment | None, head: Head) -> None:
        begin = head.begin + RECORD_HEAD
        if known is not None and known.end + 4 == head.end:
            fields = self._contents.source.read(begin, known.begin)
            if Attachment.read(Cursor(self._contents.place, fields, 0, len(fields), begin)) == known:
                return
        raise self._contents.damaged(f"an attachment at byte {head.begin} is not in the file's index")
