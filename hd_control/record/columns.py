"""Columns of a topic: many messages as numpy arrays, straight from CDR bytes.

Messages of one layout are recognised and taken together. A topic whose layout changes (foreign bags: other joints,
another frame_id length) is taken layout by layout, and a value that a message does not have is NaN.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hd_control import _records
from hd_control.core.arrays import FloatArray, IntArray
from hd_control.core.topics import VALUES_TYPE
from hd_control.record.block import Block
from hd_control.record.cdr import SURPLUS, FixedCodec, JointStateCodec, MessageColumns, TemperatureCodec, codec_of

MAX_LAYOUTS = 64


@dataclass(frozen=True)
class Columns:
    """n messages of one topic in recorded order.

    `stamps_ns` and `log_times_ns` are (n,), int64; each of `values` is (n, names), float64, NaN where a message has no
    such value. `frame_ids` is (n,) bytes: the run ids. `undecodable` counts messages left out.
    """

    topic: str
    names: tuple[str, ...]
    stamps_ns: IntArray
    log_times_ns: IntArray
    values: dict[str, FloatArray] = field(default_factory=dict)
    frame_ids: NDArray[np.bytes_] | None = None
    undecodable: int = 0

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def position(self) -> FloatArray | None:
        """(n, names) or None if no message has it."""
        return self.values.get("position")

    @property
    def velocity(self) -> FloatArray | None:
        """(n, names) or None if no message has it."""
        return self.values.get("velocity")

    @property
    def effort(self) -> FloatArray | None:
        """(n, names) or None if no message has it."""
        return self.values.get("effort")


@dataclass(frozen=True)
class _Piece:
    """Messages of one layout: their rows in the topic and what they hold."""

    rows: IntArray
    names: tuple[str, ...]
    message: MessageColumns


def decode(topic: str, type_name: str, blocks: Iterable[Block]) -> Columns | None:
    """The columns of a topic from its message blocks; None if the type has no fixed layout."""
    pieces: list[_Piece] = []
    logs: list[IntArray] = []
    start = 0
    last: FixedCodec | None = None
    for block in blocks:
        logs.append(block.log_time_ns)
        for codec, rows in _layouts(type_name, block, last):
            part = block if len(rows) == len(block.offset) else block.select(rows)
            message = codec.columns_from(partial(_records.take, part.buffer, part.offset))
            pieces.append(_Piece(rows + start, _names(codec), message))
            last = codec
        start += len(block.offset)
    log_times = np.concatenate(logs) if logs else np.zeros(0, np.int64)
    if start and not pieces and not has_fixed_layout(type_name):
        return None
    return _assemble(topic, log_times, pieces)


def has_fixed_layout(type_name: str) -> bool:
    """True if messages of this type can be decoded as columns."""
    from hd_control.core.topics import JOINT_STATE_TYPE, TEMPERATURE_TYPE
    from hd_control.record.cdr import CLOCK, NUMBER

    return type_name in (JOINT_STATE_TYPE, TEMPERATURE_TYPE, VALUES_TYPE, NUMBER, CLOCK)


def _layouts(type_name: str, block: Block, codec: FixedCodec | None) -> Iterator[tuple[FixedCodec, IntArray]]:
    """Splits a block by layout: codec and message indexes; begins with the codec that fitted last."""
    left, tries = np.arange(len(block.offset)), 0
    while len(left):
        if codec is None:
            at, length = int(block.offset[left[0]]), int(block.length[left[0]])
            codec = codec_of(type_name, bytes(block.buffer[at : at + length]))
            if codec is None:
                left = left[1:]
                continue
        tries += 1
        looked_at = left if tries <= MAX_LAYOUTS else left[:1]
        fits = _records.match(
            block.buffer, block.offset[looked_at], block.length[looked_at], codec.fixed_bytes, codec.mask_bytes, SURPLUS
        )
        if fits.any():
            yield codec, looked_at[fits]
            left = np.concatenate([looked_at[~fits], left[len(looked_at) :]])
        codec = None


def _names(codec: FixedCodec) -> tuple[str, ...]:
    if isinstance(codec, JointStateCodec):
        return codec.joint_names
    if isinstance(codec, TemperatureCodec):
        return (codec.joint_name,)
    return tuple(str(i) for i in range(codec.fields.get("data", 0)))


def _assemble(topic: str, logs: IntArray, pieces: list[_Piece]) -> Columns:
    names = tuple(dict.fromkeys(name for piece in pieces for name in piece.names))
    fields = dict.fromkeys(name for piece in pieces for name in piece.message.values)
    count = sum(len(piece.rows) for piece in pieces)
    undecodable = len(logs) - count
    rows = np.concatenate([piece.rows for piece in pieces]) if pieces else np.zeros(0, np.int64)
    if undecodable:  # close the holes that undecodable messages leave
        order = np.sort(rows)
        logs, rows = logs[order], np.searchsorted(order, rows)
    one_layout = all(p.names == names and p.message.values.keys() == fields.keys() for p in pieces)
    in_order = bool((np.diff(rows) > 0).all())
    values = {name: _gather(pieces, rows, names, name, one_layout and in_order) for name in fields}
    stamps = logs.copy()
    if pieces and pieces[0].message.stamps_ns is not None:
        stamps[rows] = np.concatenate([p.message.stamps_ns for p in pieces if p.message.stamps_ns is not None])
    return Columns(topic, names, stamps, logs, values, _frames(pieces, rows), undecodable)


def _gather(pieces: list[_Piece], rows: IntArray, names: tuple[str, ...], name: str, straight: bool) -> FloatArray:
    if straight:
        return np.concatenate([piece.message.values[name] for piece in pieces])
    table, start = np.full((len(rows), len(names)), np.nan), 0
    for piece in pieces:
        here = rows[start : start + len(piece.rows)]
        start += len(piece.rows)
        if name in piece.message.values:
            places = [names.index(joint) for joint in piece.names]
            table[here[:, None], places] = piece.message.values[name]
    return table


def _frames(pieces: list[_Piece], rows: IntArray) -> NDArray[np.bytes_] | None:
    parts = [p.message.frame_ids if p.message.frame_ids is not None else np.zeros(len(p.rows), "S1") for p in pieces]
    if not parts:
        return None
    joined = np.concatenate(parts)
    frames = np.zeros(len(rows), joined.dtype)
    frames[rows] = joined
    return frames
