from collections.abc import Sequence

from numpy import float64
from numpy.typing import NDArray

STORED: int
COMPLETE: int
OTHER_LAYOUT: int
FOREIGN: int
STALE: int
REPEATED: int
AHEAD: int

class Join:
    def __init__(self, dt_ns: int) -> None: ...
    def add(
        self,
        fixed: bytes,
        mask: bytes,
        stamp_at: int,
        frame_at: int,
        frame_length: int,
        offsets: Sequence[int],
        targets: Sequence[NDArray[float64]],
        places: Sequence[int],
        optional: bool = ...,
        ticks: NDArray[float64] | None = ...,
        tick_place: int = ...,
    ) -> None: ...
    def offer(self, index: int, data: bytes) -> int: ...
    def last_missing(self) -> int: ...
    def seen(self, index: int) -> bool: ...
    @property
    def tick(self) -> int: ...
    @property
    def incomplete(self) -> int: ...
    @property
    def stale(self) -> int: ...
    @property
    def ahead(self) -> int: ...

class Message:
    def __init__(self, template: bytes, stamp_at: int, copies: Sequence[tuple[int, int]]) -> None: ...
    def encode(self, stamp_ns: int, source: NDArray[float64]) -> bytes: ...
