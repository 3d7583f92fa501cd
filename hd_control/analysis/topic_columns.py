"""The columns of a topic for the analysis: a short topic is read once, a long one a few columns at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hd_control.analysis.decimate import LONGEST_ROWS
from hd_control.core.arrays import BoolArray, FloatArray, IntArray
from hd_control.record.columns import Columns
from hd_control.record.reader import BagReader

MOST_VALUES = 8_000_000
"""Numbers of a long topic in memory at once."""


class TopicColumns(Protocol):
    """What the analysis asks of a topic: `names` of the joints, `stamps_ns` (n,), and columns by field and joint."""

    names: tuple[str, ...]
    stamps_ns: IntArray

    def log_times_ns(self) -> IntArray:
        """Times of recording, (n,)."""

    def has(self, field: str) -> bool:
        """True if any message has the field."""

    def column(self, field: str, name: str) -> FloatArray:
        """The numbers of one joint, (n,), NaN where a message lacks them."""

    def present(self, field: str, names: Sequence[str]) -> BoolArray:
        """(n, names): where a number is finite."""


def open_topic(bag: BagReader, topic: str) -> TopicColumns:
    """The columns of a topic; those of more than `LONGEST_ROWS` messages are read from the bag when they are needed."""
    if bag.counts[bag.resolve(topic)] > LONGEST_ROWS:
        return LongTopic(bag, topic)
    return ShortTopic(bag.columns(topic))


class ShortTopic:
    """Everything in memory."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self.names, self.stamps_ns = columns.names, columns.stamps_ns

    def log_times_ns(self) -> IntArray:
        """See `TopicColumns`."""
        return self._columns.log_times_ns

    def has(self, field: str) -> bool:
        """See `TopicColumns`."""
        return field in self._columns.values

    def column(self, field: str, name: str) -> FloatArray:
        """See `TopicColumns`."""
        return self._columns.values[field][:, self.names.index(name)]

    def present(self, field: str, names: Sequence[str]) -> BoolArray:
        """See `TopicColumns`."""
        table = self._columns.values[field][:, [self.names.index(name) for name in names]]
        return np.asarray(np.isfinite(table))


class LongTopic:
    """The stamps in memory; columns of some joints at a time, each group with one pass over the topic."""

    def __init__(self, bag: BagReader, topic: str) -> None:
        self._bag, self._topic = bag, topic
        stamps = np.empty(bag.counts[bag.resolve(topic)], np.int64)
        names: dict[str, None] = {}
        self._fields: set[str] = set()
        count = 0
        for block in bag.column_blocks(topic):
            stamps[count : count + len(block)] = block.stamps_ns
            count += len(block)
            names.update(dict.fromkeys(block.names))
            self._fields.update(block.values)
        self.names, self.stamps_ns = tuple(names), stamps[:count]
        self._group: tuple[str, tuple[str, ...], FloatArray] = ("", (), np.empty((0, 0)))

    def log_times_ns(self) -> IntArray:
        """See `TopicColumns`."""
        return np.concatenate([block.log_times_ns for block in self._bag.column_blocks(self._topic)])

    def has(self, field: str) -> bool:
        """See `TopicColumns`."""
        return field in self._fields

    def column(self, field: str, name: str) -> FloatArray:
        """See `TopicColumns`."""
        if self._group[0] != field or name not in self._group[1]:
            width = max(1, MOST_VALUES // max(1, len(self.stamps_ns)))
            first = self.names.index(name)
            group = self.names[first : first + width]
            self._group = ("", (), np.empty((0, 0)))  # the old one goes before the new one comes
            self._group = (field, group, self._table(field, group))
        values: FloatArray = self._group[2][self._group[1].index(name)]
        return values

    def present(self, field: str, names: Sequence[str]) -> BoolArray:
        """See `TopicColumns`."""
        return np.concatenate(
            [np.isfinite(_values(block, field, names)).T for block in self._bag.column_blocks(self._topic)]
        )

    def _table(self, field: str, names: Sequence[str]) -> FloatArray:
        """(names, n)."""
        table, count = np.empty((len(names), len(self.stamps_ns))), 0
        for block in self._bag.column_blocks(self._topic):
            table[:, count : count + len(block)] = _values(block, field, names)
            count += len(block)
        return table


def _values(block: Columns, field: str, names: Sequence[str]) -> FloatArray:
    """(names, n), NaN where the block has no such column."""
    found = np.full((len(names), len(block)), np.nan)
    for row, name in enumerate(names):
        if field in block.values and name in block.names:
            found[row] = block.values[field][:, block.names.index(name)]
    return found
