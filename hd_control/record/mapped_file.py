"""A file mapped into memory for reading only, whose pages are given back while it is walked through."""

from __future__ import annotations

import mmap
import zlib
from pathlib import Path

from hd_control.core.errors import BagError
from hd_control.record.fixed_cdr import Buffer

_STEP = 16 << 20


class MappedFile:
    """`buffer` is the whole file. Raises BagError if the file cannot be opened or is empty."""

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as file:
                if file.seek(0, 2) == 0:
                    raise BagError(f"{path}: the file is empty; nothing was recorded, record again")
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise BagError(f"{path}: cannot be opened ({why}); check path and permission") from None
        self.buffer: Buffer = memoryview(self._map)

    def release(self) -> None:
        """Gives the pages that were read back to the system; they come again when they are needed."""
        if hasattr(mmap, "MADV_DONTNEED"):
            self._map.madvise(mmap.MADV_DONTNEED)

    def crc32(self, end: int) -> int:
        """CRC of the bytes before `end`."""
        crc = 0
        for start in range(0, end, _STEP):
            crc = zlib.crc32(self.buffer[start : min(end, start + _STEP)], crc)
            self.release()
        return crc
