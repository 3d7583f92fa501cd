"""Messages of a recording as parallel arrays over one buffer: what every storage format hands out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hd_control.record.fixed_cdr import Buffer, IntArray

BLOCK_MESSAGES = 1 << 16
"""A block has at most so many messages, whatever the file says."""


@dataclass(frozen=True)
class Block:
    """Messages found in one buffer: parallel arrays (n,); `offset` and `length` are those of the payloads."""

    buffer: Buffer
    channel: IntArray
    sequence: IntArray
    log_time_ns: IntArray
    publish_time_ns: IntArray
    offset: IntArray
    length: IntArray

    def select(self, where: Any) -> Block:
        """The messages at an index or mask."""
        return Block(
            self.buffer,
            self.channel[where],
            self.sequence[where],
            self.log_time_ns[where],
            self.publish_time_ns[where],
            self.offset[where],
            self.length[where],
        )

    def payloads(self) -> Iterator[bytes]:
        """The bytes of each message."""
        for at, length in zip(self.offset.tolist(), self.length.tolist(), strict=True):
            yield bytes(self.buffer[at : at + length])


def scanned_block(buffer: Buffer, found: dict[str, Any]) -> Block:
    """The messages that a walk over MCAP records found."""
    return Block(
        buffer,
        found["channel"],
        found["sequence"],
        found["log_time"],
        found["publish_time"],
        found["offset"],
        found["length"],
    )
