"""Messages to plain values: a JointTrajectory becomes a Goal, or is refused with a reason."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hd_control.laws.goals import goal_from_points
from hd_control.laws.trajectory import Goal

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from trajectory_msgs.msg import JointTrajectory


def stamp_ns(stamp: Time) -> int:
    """A ROS time in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def goal_from_message(message: JointTrajectory, dt_ns: int, identifier: str) -> Goal:
    """The goal of a message. A stamp of zero means now (`start_tick` None). Raises GoalError."""
    points, stamp = message.points, stamp_ns(message.header.stamp)
    return goal_from_points(
        list(message.joint_names),
        [stamp_ns(point.time_from_start) / 1e9 for point in points],
        [point.positions for point in points],
        [point.velocities for point in points],
        [point.accelerations for point in points],
        start_tick=None if stamp == 0 else (stamp + dt_ns // 2) // dt_ns,
        identifier=message.header.frame_id or identifier,
    )


def message_from_goal(goal: Goal, dt_ns: int) -> JointTrajectory:
    """The inverse of `goal_from_message`; the identifier travels in `header.frame_id`."""
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    message = JointTrajectory(joint_names=list(goal.joint_names))
    message.header.frame_id = goal.identifier
    if goal.start_tick is not None:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(goal.start_tick * dt_ns, 1_000_000_000)
    for row, time in enumerate(goal.times):
        point = JointTrajectoryPoint(positions=goal.positions[row].tolist())
        if goal.velocities is not None:
            point.velocities = goal.velocities[row].tolist()
        if goal.accelerations is not None:
            point.accelerations = goal.accelerations[row].tolist()
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(float(time) * 1e9), 1_000_000_000)
        message.points.append(point)
    return message
