"""Messages of a block as the bytes of MCAP records, for copying a recording."""

from __future__ import annotations

import numpy as np

from hd_control import _records
from hd_control.core.arrays import IntArray
from hd_control.record.block import Block
from hd_control.record.mcap_file import MESSAGE, message_record, message_records


def block_records(block: Block, channel: int) -> tuple[bytes, IntArray]:
    """The messages under a channel number, in order, and where each record begins, (n,)."""
    if len(block.length) and bool((block.length == block.length[0]).all()):
        rows = _records.take(block.buffer, block.offset, 0, int(block.length[0]))
        return message_records(channel, block.sequence, block.log_time_ns, block.publish_time_ns, rows)
    heads = (block.sequence.tolist(), block.log_time_ns.tolist(), block.publish_time_ns.tolist())
    data = b"".join(
        message_record(channel, sequence, log, publish, payload)
        for sequence, log, publish, payload in zip(*heads, block.payloads(), strict=True)
    )
    places = np.concatenate([[0], np.cumsum(block.length + MESSAGE.size)[:-1]]).astype(np.int64)
    return data, places
