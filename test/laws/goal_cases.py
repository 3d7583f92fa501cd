"""Arm A, its limits and a follower at rest, for the tests of goals."""

import copy

import numpy as np
import pytest
from chains import shipped_values

from hd_control.core.errors import GoalError
from hd_control.core.robot import Robot
from hd_control.laws.goals import GoalLimits, check_goal
from hd_control.laws.trajectory import TrajectoryFollower

ARM = Robot.from_file("arm_a")
NAMES, DT = ARM.joint_names, 1e-3
Q0 = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])
LIMITS = GoalLimits.from_values(shipped_values(), ARM)


def follower_at(position=Q0):
    return TrajectoryFollower(NAMES, DT, position)


def refused(goal, limits=LIMITS, measured=Q0, tick=0, follower=None):
    """The error of a refusal; the follower must be as it was."""
    follower = follower or follower_at()
    before = copy.deepcopy(follower.__dict__)
    with pytest.raises(GoalError) as refusal:
        check_goal(goal, follower, limits, measured, tick)
    for name, value in follower.__dict__.items():
        assert repr(value) == repr(before[name])
    assert str(refusal.value).startswith("HD-F22 goal_bad")
    return refusal.value
