"""Torque of the links along a recording, with the measured motion of all joints: columns of a balance, or one series.

The regressors of added bodies are taken without accelerations: an acceleration on the right side is a noisy regressor,
and beside the inertia on the left it is an identity. Inertia that a payload adds shows in the scale b of the balance.
`link_torque` is the joint torque that the links need, for calibrations.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import BagError, ConfigError
from hd_control.core.robot import Robot
from hd_control.drive.link import OwnLink, added_bodies, arm_terms, link_terms, own_link, single_inertia
from hd_control.drive.model import Model
from hd_control.lab.balances.channels import LinkFunction, LinkTerms
from hd_control.lab.balances.states import JOINT_TAPER
from hd_control.lab.signals.filters import Band, Spectral, band_for, fill_gaps
from hd_control.lab.signals.joint_signals import JointSignals


class LinkSide:
    """Link terms of the joints of one recording under one model; what all joints share is computed once."""

    def __init__(self, model: Model, joints: Mapping[str, JointSignals]) -> None:
        self.model, self.joints = model, joints
        self.robot = model.robot_description()
        self._terms: dict[tuple[float, float, int], dict[str, LinkTerms]] = {}

    def function(self, joint: str) -> LinkFunction | None:
        """The link terms of one joint as the balances ask for them; None if the model and signals do not allow any."""
        return None if self.why_not(joint) else lambda band, spectral: self._of(band, spectral, joint)

    def why_not(self, joint: str) -> str:
        """Why there are no link terms, one sentence; empty if there are."""
        if self.robot is None:
            known = single_inertia(self.model.joint(joint)) > 0.0
            return "" if known else f"{joint}: the model knows neither robot description nor link inertia"
        if joint not in self.robot.joint_names:
            return f"{joint}: the robot description has no such joint"
        missing = [name for name in self.robot.joint_names if _position(self.joints.get(name), 1.0) is None]
        if missing:
            return f"link dynamics needs the motion of all joints; {', '.join(missing)} is not recorded"
        return ""

    def own_link(self, joint: str, spectral: Spectral) -> OwnLink | None:
        """The own link along the recording for a prediction, at the rate of the recording."""
        if self.why_not(joint):
            return None
        band = band_for(spectral.period, *JOINT_TAPER)
        fine = Band(band.flat, band.zero)
        names = [joint] if self.robot is None else list(self.robot.joint_names)
        q, v, a = (np.column_stack([self._motion(n, fine, spectral, d) for n in names]) for d in range(3))
        return own_link(self.model, joint, q, v, a, robot=self.robot)

    def _of(self, band: Band, spectral: Spectral, joint: str) -> LinkTerms:
        key = (band.flat, band.zero, band.step)
        if self.robot is None:
            q, v, a = self._rows(joint, band, spectral)
            return link_terms(self.model, joint, q, v, a)
        if key not in self._terms:
            self._terms[key] = self._all(band, spectral, self.robot)
        return self._terms[key][joint]

    def _all(self, band: Band, spectral: Spectral, robot: Robot) -> dict[str, LinkTerms]:
        motion = [self._rows(name, band, spectral) for name in robot.joint_names]
        q, v, a = (np.column_stack([m[i] for m in motion]) for i in range(3))
        names = [name for name in robot.joint_names if name in self.model.joints]
        moving = arm_terms(self.model, q, v, a, names, robot)
        still = arm_terms(self.model, q, v, np.zeros_like(a), names, robot)
        return {name: self._joined(name, moving[name], still[name]) for name in names}

    def _joined(self, joint: str, moving: LinkTerms, still: LinkTerms) -> LinkTerms:
        """Nominal terms with the inertia of a payload that the model knows; regressors without accelerations."""
        inertia, bias, _, _ = moving
        for i, added in zip((2, 3), added_bodies(self.model.joint(joint)), strict=True):
            full, rest = moving[i], still[i]
            if full is not None and rest is not None:
                inertia = inertia + (full - rest) @ added
        return inertia, bias, still[2], still[3]

    def _rows(self, joint: str, band: Band, spectral: Spectral) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position and velocity (lightly filtered) and acceleration (in the band) at the rows of the band."""
        taper = band_for(spectral.period, *JOINT_TAPER)
        light = Band(min(taper.flat, band.flat), min(taper.zero, band.zero), band.step)
        q, v = (self._motion(joint, light, spectral, d) for d in (0, 1))
        return q, v, self._motion(joint, band, spectral, 2)

    def _motion(self, joint: str, band: Band, spectral: Spectral, derivative: int) -> FloatArray:
        position = _position(
            self.joints.get(joint), self.model.joint(joint).gear_ratio if joint in self.model.joints else 1.0
        )
        if position is None:
            raise ConfigError(f"the position of {joint} is not recorded")
        return spectral.filter(position, band, derivative)


def _position(signals: JointSignals | None, gear_ratio: float) -> FloatArray | None:
    """The joint angle, or the motor's where only that is recorded."""
    if signals is None:
        return None
    if signals.joint_position is not None:
        return fill_gaps(signals.joint_position)
    shaft = signals.motor_shaft_position
    return None if shaft is None else fill_gaps(shaft) / gear_ratio


# ---- The joint torque as one series ----------------------------------------------------------------


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
    torque = inertia + bias
    for rows, added in zip((own, tool), added_bodies(model.joint(joint)), strict=True):
        if rows is not None:
            torque = torque + rows @ added
    return torque, spectral.filter(fill_gaps(signals.joint_position), band, 1)
