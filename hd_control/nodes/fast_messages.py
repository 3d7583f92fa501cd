"""Messages of the fast loop, made once and moved by compiled code: bytes into blocks, blocks into bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hd_control import _messages
from hd_control.core.arrays import FloatArray
from hd_control.record.cdr import JointStateCodec

Destinations = Mapping[str, Sequence[tuple[FloatArray, Sequence[int]]]]
"""By array of the message: views to write to, each with the joints (by index in the message) that it takes."""


def add_input(join: _messages.Join, codec: JointStateCodec, destinations: Destinations, optional: bool = False) -> None:
    """Adds an input whose arrays are written straight to their destinations when a message is taken."""
    offsets, targets, places = [], [], []
    for array, wanted in destinations.items():
        start, _ = codec.places[array]
        for view, joints in wanted:
            for place, joint in enumerate(joints):
                offsets.append(start + 8 * joint)
                targets.append(view)
                places.append(place)
    fixed, mask = codec.fixed_bytes, codec.mask_bytes
    join.add(fixed, mask, codec.stamp_place, *codec.frame_place, offsets, targets, places, optional)


def make_message(codec: JointStateCodec, run_id: str, places: Mapping[str, Sequence[int]]) -> _messages.Message:
    """A message whose arrays are taken from the named places of one array of numbers."""
    template = codec.encode(0, run_id, **{array: np.zeros(len(part)) for array, part in places.items()})
    copies = []
    for array, part in places.items():
        start, _ = codec.places[array]
        copies += [(start + 8 * row, number) for row, number in enumerate(part)]
    return _messages.Message(template, codec.stamp_place, copies)
