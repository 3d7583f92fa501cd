"""A run of the runner as a bag: the same topics, types and stamps that the nodes would publish in lock-step."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hd_control.chain.stage import Bus
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.robot import Robot
from hd_control.core.topics import TRAJECTORY_TYPE
from hd_control.laws.trajectory import Goal
from hd_control.record.cdr import TemperatureCodec, encode_message, encode_text, message_class
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

RUN_ID = "simulation_00000"
"""Run id in the frame_id of simulated messages: fixed, so that equal runs make equal bags."""
JOINT_TOPICS = (
    *topics.SENSORS,
    topics.MOTOR_STATES,
    topics.JOINT_STATES,
    topics.REFERENCE,
    topics.REQUIRED,
    topics.COMMAND,
)
BLOCK = 4096
"""Ticks collected before they are written."""


class RunRecording:
    """Observes a run and writes it, block by block. Use as a context manager around the run."""

    def __init__(self, path: str | Path, robot: Robot, period: float, metadata: Mapping[str, str], force: bool = False):
        self.writer = BagWriter(path, live=False, force=force, metadata=metadata)
        self.period_ns = round(period * 1e9)
        self.joint_names = robot.joint_names
        self._codecs = {topic: joint_state_codec(topic, robot.joint_names) for topic in JOINT_TOPICS}
        shape = (BLOCK, robot.joints)
        self._columns: dict[str, dict[str, FloatArray]] = {
            topic: {name: np.empty(shape) for name in topics.fields(topic)} for topic in JOINT_TOPICS
        }
        self._ticks = np.empty(BLOCK, dtype=np.int64)
        self._rows = 0
        self._temperatures: list[tuple[int, FloatArray]] = []
        self.writer.write(topics.DESCRIPTION, None, 0, encode_text(robot.urdf))
        self.writer.attach("robot.urdf", robot.urdf, "application/xml")

    def observe(self, tick: int, bus: Bus) -> None:
        """Keeps one tick; an observer for `Runner.run`."""
        row = self._rows
        self._ticks[row] = tick
        for topic, arrays in self._columns.items():
            values = bus[topic]
            for name, column in arrays.items():
                column[row] = values[name]
        if topics.TEMPERATURE in bus:
            self._temperatures.append((tick, bus[topics.TEMPERATURE]["temperature"].copy()))
        self._rows += 1
        if self._rows == BLOCK:
            self._flush()

    def goal(self, tick: int, goal: Goal) -> None:
        """Writes a goal, received at `tick`, as the message that would carry it."""
        stamp_ns = (goal.start_tick or 0) * self.period_ns
        header = message_class("std_msgs/msg/Header")(_time(stamp_ns), goal.identifier)
        point = message_class("trajectory_msgs/msg/JointTrajectoryPoint")
        duration = message_class("builtin_interfaces/msg/Duration")
        none = np.zeros(0)
        points = [
            point(
                positions=goal.positions[row],
                velocities=none if goal.velocities is None else goal.velocities[row],
                accelerations=none if goal.accelerations is None else goal.accelerations[row],
                effort=none,
                time_from_start=duration(*divmod(round(float(time) * 1e9), 1_000_000_000)),
            )
            for row, time in enumerate(goal.times)
        ]
        message = message_class(TRAJECTORY_TYPE)(header, list(goal.joint_names), points)
        self.writer.write(topics.GOAL, stamp_ns, tick * self.period_ns, encode_message(TRAJECTORY_TYPE, message))

    def close(self, reason: str = "") -> Path:
        """Writes what is left, the accounts and the index."""
        self._flush()
        return self.writer.close(reason)

    def _flush(self) -> None:
        stamps = self._ticks[: self._rows] * self.period_ns
        for topic, arrays in self._columns.items():
            values = {name: column[: self._rows] for name, column in arrays.items()}
            self.writer.write_columns(topic, self._codecs[topic], stamps, frame_id=RUN_ID, **values)
        for index, name in enumerate(self.joint_names):
            codec = TemperatureCodec(name)
            for tick, temperature in self._temperatures:
                stamp_ns = tick * self.period_ns
                payload = codec.encode(stamp_ns, name, temperature=temperature[index])
                self.writer.write(topics.TEMPERATURE, stamp_ns, stamp_ns, payload)
        self._rows = 0
        self._temperatures.clear()

    def __enter__(self) -> RunRecording:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if not self.writer.closed and not self.writer.failed:
            self.close("error" if kind else "")


def _time(stamp_ns: int) -> object:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return message_class("builtin_interfaces/msg/Time")(seconds, nanoseconds)
