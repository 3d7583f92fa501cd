"""Goals of the topic `joint_trajectory` and of the action `follow_joint_trajectory`, which go the same way.

They are taken in the executor thread, checked completely, answered, and handed as paths to the loop. The action exists
where `control_msgs` is installed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from hd_control.chain.motion_stage import MotionStage
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.errors import GoalError
from hd_control.laws.goals import (
    CODES,
    INVALID_GOAL,
    PATH_VIOLATED,
    GoalLimits,
    GoalWatch,
    Outcome,
    Tolerances,
    check_bytes,
    check_goal,
)
from hd_control.laws.trajectory import Goal, Path, braking_path, refusal
from hd_control.nodes.convert import goal_from_message, stamp_ns
from hd_control.nodes.fast_loop import chain_qos, latched_qos
from hd_control.nodes.shell import Shell

LEADS = (10, 40, 160, 640)
"""Ticks between the check and the start of a goal that starts now; the next one if the check took longer."""


class GoalService:
    """`joint_trajectory` in, `~/goal_status` out: `accepted ID start_tick N end_tick M`, or the refusal's text."""

    def __init__(self, node: Shell, stage: MotionStage, values: Callable[[], Mapping[str, Any]]) -> None:
        self._node, self._stage, self._values = node, stage, values
        self._status = node.create_publisher(String, "~/goal_status", latched_qos())
        self._received = self.refused = 0
        self.last_refusal = ""
        node.create_subscription(JointTrajectory, topics.GOAL, self._take, chain_qos(10), raw=True)

    def _take(self, data: bytes) -> None:
        self._received += 1
        name = f"goal_{self._received}"
        try:
            check_bytes(len(data))
            message = deserialize_message(data, JointTrajectory)
            name = message.header.frame_id or name
            text = self.offer(goal_from_message(message, self._node.dt_ns, name))
        except GoalError as error:
            text = self.last_refusal = f"refused {name} {error.code}: {error}"
            self.refused += 1
        self._status.publish(String(data=text))

    def values(self) -> dict[str, Any]:
        """For diagnostics, and so for the recording: refused goals with their reason."""
        return {"goals_refused": self.refused, "last_goal_refusal": self.last_refusal}

    def offer(self, goal: Goal) -> str:
        """The answer to an accepted goal. Raises GoalError; nothing has changed then."""
        path = self.accept(goal)
        return f"accepted {goal.identifier} start_tick {path.start_tick} end_tick {path.end_tick}"

    def accept(self, goal: Goal) -> Path:
        """The path that is now followed. Raises GoalError; nothing has changed then."""
        stage = self._stage
        if not self._node.active or stage.follower is None:
            raise refusal("not_active", "", "the motion law does not run", "Activate it and start the plant")
        stage.refuse_unless_ready(at_once=goal.start_tick is None)
        limits = GoalLimits.from_values(self._values(), self._node.robot)
        for lead in LEADS if goal.start_tick is None else (0,):
            tick = stage.tick
            dated = replace(goal, start_tick=tick + lead) if goal.start_tick is None else goal
            path = check_goal(dated, stage.follower.copy(), limits, stage.sample.joint_position.copy(), tick)
            if path.start_tick > stage.tick:
                stage.hand_over(path)
                return path
        raise refusal("start_stamp", "", "the start passed during the check", "Give a later start")

    def brake(self) -> None:
        """Brings the reference to rest within the acceleration limits; drops every goal."""
        stage, limits = self._stage, GoalLimits.from_values(self._values(), self._node.robot)
        if stage.follower is not None:
            start = stage.tick + LEADS[0]
            motion = stage.follower.at(start)
            stage.hand_over(braking_path(motion, start, stage.dt, limits.acceleration))


# ---- The action ------------------------------------------------------------------------------------
#
# Every goal is accepted by the action so that a refusal can carry its text: it is then aborted at once. The motion runs
# in the fast loop; a timer looks at it 20 times a second, so path tolerances are checked at that rate. The goal is
# executed, in the sense of rclpy, only when its outcome is known: a waiting coroutine would keep the executor busy.


NAME = "follow_joint_trajectory"
PERIOD = 0.05
UNLIMITED = -1.0


def serve_trajectory_action(node: Any, service: GoalService, stage: MotionStage) -> TrajectoryAction | None:
    """Serves the action if its messages can be imported; else None."""
    try:
        from control_msgs.action import FollowJointTrajectory
    except ImportError:
        return None
    from rclpy.action import ActionServer

    return TrajectoryAction(node, service, stage, FollowJointTrajectory, ActionServer)


class TrajectoryAction:
    """One goal at a time; a newer one, from the action or from the topic, ends the older."""

    def __init__(
        self, node: Any, service: GoalService, stage: MotionStage, kind: Any, make_server: Callable[..., Any]
    ) -> None:
        self._node, self._service, self._stage, self._kind = node, service, stage, kind
        self._handle: Any = None
        self._path: Path | None = None
        self._watch: GoalWatch | None = None
        self._aborted = self._count = 0
        callbacks = {
            "execute_callback": lambda handle: None,
            "handle_accepted_callback": self._accepted,
            "cancel_callback": lambda handle: _cancel_response(),
        }
        self.server = make_server(node, kind, NAME, **callbacks)
        node.create_timer(PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _accepted(self, handle: Any) -> None:
        """Offers the goal to the motion stage, or aborts it with the reason."""
        request = handle.request
        self._count += 1
        try:
            goal = goal_from_message(request.trajectory, self._node.dt_ns, f"action_{self._count}")
            watch = self._tolerances(request)
            path = self._service.accept(goal)
        except GoalError as error:
            self._finish(handle, "abort", Outcome(CODES.get(error.code, INVALID_GOAL), str(error)))
            return
        if self._handle is not None:
            self._end("abort", Outcome(INVALID_GOAL, f"replaced by {path.identifier}"))
        patience = round(stamp_ns(request.goal_time_tolerance) / self._node.dt_ns)
        self._watch = GoalWatch(self._names, path.start_tick, path.end_tick, *watch, patience)
        self._handle, self._path, self._aborted = handle, path, self._stage.aborted_goals

    @property
    def _names(self) -> tuple[str, ...]:
        return self._stage.joint_names

    def _tolerances(self, request: Any) -> tuple[Tolerances, Tolerances]:
        return (_tolerances(request.path_tolerance, self._names), _tolerances(request.goal_tolerance, self._names))

    def _look(self) -> None:
        """The timer: feedback, and the end of the goal when it is there."""
        if self._handle is None or self._watch is None:
            return
        stage, follower = self._stage, self._stage.follower
        if not self._node.active or follower is None:
            self._end("abort", Outcome(INVALID_GOAL, "the motion law was deactivated"))
        elif self._handle.is_cancel_requested:
            self._service.brake()
            self._end("canceled", Outcome(INVALID_GOAL, "canceled; the robot brakes"))
        elif stage.aborted_goals > self._aborted:
            text = "the goal was dropped: a joint left its reference by more than 0.05 rad, or a reset was asked for"
            self._end("abort", Outcome(PATH_VIOLATED, text))
        elif not stage.has(self._path):
            self._end("abort", Outcome(INVALID_GOAL, "replaced by another goal"))
        else:
            self._follow(follower.at(stage.tick))

    def _follow(self, wanted: Any) -> None:
        sample = self._stage.sample
        actual = (sample.joint_position.copy(), sample.joint_velocity.copy())
        error = (wanted.position - actual[0], wanted.velocity - actual[1])
        self._handle.publish_feedback(self._feedback((wanted.position, wanted.velocity), actual, error))
        outcome = self._watch.judge(self._stage.tick, *error) if self._watch is not None else None
        if outcome is not None:
            if outcome.code == PATH_VIOLATED:
                self._service.brake()
            self._end("succeed" if outcome.code == 0 else "abort", outcome)

    def _feedback(self, *points: Sequence[FloatArray]) -> Any:
        feedback = self._kind.Feedback()
        feedback.joint_names = list(self._names)
        nanoseconds = self._stage.tick * self._node.dt_ns
        feedback.header.stamp.sec, feedback.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
        for name, (position, velocity) in zip(("desired", "actual", "error"), points, strict=True):
            point = getattr(feedback, name)
            point.positions, point.velocities = position.tolist(), velocity.tolist()
        return feedback

    def _end(self, method: str, outcome: Outcome) -> None:
        handle, self._handle, self._watch = self._handle, None, None
        self._finish(handle, method, outcome)

    def _finish(self, handle: Any, method: str, outcome: Outcome) -> None:
        """Runs the goal's callback with an outcome that is known."""
        result = self._kind.Result()
        result.error_code, result.error_string = outcome.code, outcome.text

        def execute(goal: Any) -> Any:
            getattr(goal, method)()
            return result

        handle.execute(execute)


def _cancel_response() -> Any:
    from rclpy.action import CancelResponse

    return CancelResponse.ACCEPT


def _tolerances(given: Sequence[Any], names: Sequence[str]) -> Tolerances:
    """Of `control_msgs/JointTolerance`: 0 and -1 demand nothing. Raises GoalError for an unknown joint."""
    found = Tolerances.none(len(names))
    for one in given:
        if one.name not in names:
            raise refusal("joint_unknown", one.name, "tolerance of an unknown joint", f"Use {names}")
        row = list(names).index(one.name)
        for values, value in ((found.position, one.position), (found.velocity, one.velocity)):
            if not np.isfinite(value) or (value < 0.0 and value != UNLIMITED):
                raise refusal("tolerance", one.name, f"tolerance {value}", "Give a positive number")
            values[row] = value if value > 0.0 else np.inf
    return found
