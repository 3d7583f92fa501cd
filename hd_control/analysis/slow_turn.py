"""Joint torque that the links need along a recording, with the motion that belongs to it, for calibrations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hd_control.analysis.bands import Spectral, band_for
from hd_control.analysis.joint_states import JOINT_TAPER, fill_gaps
from hd_control.analysis.link_function import LinkSide
from hd_control.analysis.signals import JointSignals
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import BagError
from hd_control.drive.effects.payload import NAMES
from hd_control.drive.model import Model


def link_torque(model: Model, joints: Mapping[str, JointSignals], joint: str) -> tuple[FloatArray, FloatArray]:
    """Torque N m that the link of `joint` needs and the joint's velocity rad/s, (n,) each; smoothed, without delay.

    The payload that the model knows is in the torque, friction of the link is not. Raises BagError if the recording or
    the model does not allow it.
    """
    signals, side = joints[joint], LinkSide(model, joints)
    why = side.why_not(joint)
    if why:
        raise BagError(f"{why}; the joint torque cannot be computed")
    if signals.joint_position is None:
        raise BagError(f"{joint}: its joint position is not recorded")
    spectral = Spectral(signals.time.size, signals.period)
    taper = band_for(signals.period, *JOINT_TAPER)
    band = type(taper)(taper.flat, taper.zero)
    function = side.function(joint)
    assert function is not None  # why_not is empty
    inertia, bias, own, tool = function(band, spectral)
    known = model.joint(joint).numbers("payload")
    torque = inertia + bias
    for rows, body in ((own, "link"), (tool, "tool")):
        if rows is not None:
            torque = torque + rows @ np.array([known.get(f"{body}_{name}", 0.0) for name in NAMES])
    return torque, spectral.filter(fill_gaps(signals.joint_position), band, 1)
