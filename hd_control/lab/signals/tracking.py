"""How well a recorded robot followed its reference, joint by joint, from measured signals only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import BagError
from hd_control.core.topics import JOINT_STATES, REFERENCE
from hd_control.record.reader import BagReader


@dataclass(frozen=True)
class Tracking:
    """Reference minus measured joint position: `error` and `reference` (k, n) rad at the stamps `stamps_ns` (k,)."""

    joint_names: tuple[str, ...]
    stamps_ns: NDArray[np.int64]
    reference: FloatArray
    error: FloatArray

    def within(self, start_ns: int, end_ns: int) -> Tracking:
        """The part between two stamps, both included."""
        keep = (self.stamps_ns >= start_ns) & (self.stamps_ns <= end_ns)
        return Tracking(self.joint_names, self.stamps_ns[keep], self.reference[keep], self.error[keep])

    def maximum(self) -> dict[str, float]:
        """Largest absolute error of each joint, rad."""
        return dict(zip(self.joint_names, np.abs(self.error).max(axis=0, initial=0.0).tolist(), strict=True))

    def rms(self) -> dict[str, float]:
        """Root mean square error of each joint, rad."""
        square = (self.error**2).mean(axis=0) if self.stamps_ns.size else np.zeros(len(self.joint_names))
        return dict(zip(self.joint_names, np.sqrt(square).tolist(), strict=True))


def tracking_of(bag: BagReader) -> Tracking:
    """The tracking of a recording. Ticks without both a reference and a measurement are left out.

    Raises BagError if `joint_reference` or `joint_states` is missing or they name no common joint.
    """
    for topic in (REFERENCE, JOINT_STATES):
        if not bag.has(topic):
            raise BagError(f"{bag.path}: no {topic}; record the chain's topics to see the tracking")
    wanted, measured = bag.columns(REFERENCE), bag.columns(JOINT_STATES)
    names = tuple(name for name in wanted.names if name in measured.names)
    if not names or wanted.position is None or measured.position is None:
        raise BagError(f"{bag.path}: joint_reference and joint_states share no joint position")
    stamps, left, right = np.intersect1d(wanted.stamps_ns, measured.stamps_ns, return_indices=True)
    reference = wanted.position[left][:, [wanted.names.index(name) for name in names]]
    position = measured.position[right][:, [measured.names.index(name) for name in names]]
    return Tracking(names, stamps, reference, reference - position)
