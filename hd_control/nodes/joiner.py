"""Joins inputs of one tick: nothing is computed from samples of different ticks."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any


class Joiner:
    """Collects one value per input until all inputs of one tick are there.

    A newer tick abandons an incomplete older one, which is counted in `incomplete`; a value of a tick that is past or
    already there is dropped and counted in `stale`. A stamp that stands still therefore never makes a new tick.
    `repeated` tells that the last input came again for the finished tick: in lock-step the sender asks again.
    An input in `optional` is waited for only after it has been seen once; until then its value is None.
    """

    __slots__ = ("_filled", "_joined_once", "_open", "_unseen", "_values", "incomplete", "repeated", "stale", "tick")

    def __init__(self, inputs: int, optional: Collection[int] = ()) -> None:
        self._values: list[Any] = [None] * inputs
        self._filled = [False] * inputs
        self._unseen = set(optional)
        self._open = False
        self._joined_once = False
        self.tick = -1
        self.incomplete = self.stale = 0
        self.repeated = False

    def offer(self, index: int, tick: int, value: Any) -> bool:
        """Takes one value; True if it completes its tick, whose number is then `tick`."""
        if index in self._unseen:
            self._unseen.discard(index)
            self._filled[index] = False
        if tick > self.tick:
            if self._open and self._joined_once:
                self.incomplete += 1
            self.tick, self._open = tick, True
            self._filled = [index in self._unseen for index in range(len(self._filled))]
        elif tick < self.tick or self._filled[index]:
            self.stale += 1
            self.repeated = tick == self.tick and not self._open and index == len(self._filled) - 1
            return False
        self._values[index], self._filled[index] = value, True
        if all(self._filled):
            self._open, self._joined_once = False, True
            return True
        return False

    def values(self) -> list[Any]:
        """The values of the tick that was completed last, in the order of the inputs."""
        return list(self._values)

    def last_missing(self) -> int:
        """The highest input that the present tick still needs: the one worth waiting for."""
        if not self._open:
            return len(self._filled) - 1
        return max(index for index, filled in enumerate(self._filled) if not filled)
