"""The fields of one record of an MCAP file, one after another; running past its end is damage."""

from __future__ import annotations

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place

_MAX_NAME = 1024


class Cursor:
    """Reads a record.

    data      whatever holds the record
    position  in `data`, of the next field
    end       of the record in `data`
    base      byte of the file, or of its chunk, at which `data` begins
    """

    def __init__(self, place: Place, data: memoryview, position: int, end: int, base: int = 0) -> None:
        self._place = place
        self._data = data
        self.position = position
        self._end = end
        self._base = base

    def take(self, size: int) -> memoryview:
        """The next bytes."""
        if size > self._end - self.position:
            raise DamagedRecording(f"{self._place}: a record at byte {self.at} is shorter than it says")
        part = self._data[self.position : self.position + size]
        self.position += size
        return part

    @property
    def at(self) -> int:
        """Of the next field, in the file or chunk."""
        return self._base + self.position

    @property
    def left(self) -> int:
        """Bytes up to the end of the record."""
        return self._end - self.position

    def u16(self) -> int:
        """A number of 2 bytes; and so on."""
        return int.from_bytes(self.take(2), "little")

    def u32(self) -> int:
        """See u16."""
        return int.from_bytes(self.take(4), "little")

    def u64(self) -> int:
        """See u16."""
        return int.from_bytes(self.take(8), "little")

    def text(self) -> str:
        """A text, its length first."""
        try:
            return bytes(self.take(self.u32())).decode()
        except UnicodeDecodeError:
            raise DamagedRecording(f"{self._place}: a name at byte {self.at} is not UTF-8") from None

    def name(self) -> str:
        """A text that is not long."""
        text = self.text()
        if len(text) > _MAX_NAME:
            raise DamagedRecording(f"{self._place}: the name at byte {self.at} has {len(text)} characters")
        return text

    def rest(self) -> memoryview:
        """What is left of the record, which is not taken by this."""
        return self._data[self.position : self._end]

    def text_map(self, most: int) -> dict[str, str]:
        """Texts by their names; DamagedRecording where they are more."""
        end = self.u32() + self.position
        values = dict[str, str]()
        while self.position < end:
            if len(values) == most:
                raise DamagedRecording(f"{self._place}: its channels have more texts than are read, at byte {self.at}")
            key = self.text()
            values[key] = self.text()
        if self.position != end:
            raise DamagedRecording(f"{self._place}: a list of texts ends within one, at byte {self.at}")
        return values
