"""The plant's topics: `motor_torque_command` merged by joint name, sensors out, and what the plant says of itself."""

from __future__ import annotations

from typing import Any

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String, UInt64

from hd_control import _plane
from hd_control.core import topics
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.nodes.fast_loop import chain_qos, latched_qos, message_runs
from hd_control.nodes.shell import ERROR, OK, WARN, Shell, foreign_report
from hd_control.nodes.stage_shell import Output
from hd_control.record.cdr import ENCAPSULATION, ClockCodec, TemperatureCodec, encode_text
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.world import World, sensor_arrays


class PlantTopics:
    """Creates the plant's topics and lets the turn send and take them.

    With `commands` the command comes from `motor_torque_command`, from one torque node or several: the first publisher
    of a joint is bound by its run id, another one is foreign until the robot has stopped.
    """

    def __init__(self, node: Shell, world: World, turn: PlantTurn, lockstep: bool, commands: bool = True) -> None:
        self._node, self._names, self._plane = node, world.joint_names, turn.plane
        self._others: list[Any] = []
        self._sensors = [Output(node, topic, self._names) for topic in topics.SENSORS]
        self.sensor_publishers = [output.publisher for output in self._sensors]
        self._temperature = self._publisher(Temperature, topics.TEMPERATURE, chain_qos(2 * len(self._names)))
        self._clock = self._publisher(Clock, topics.CLOCK, chain_qos()) if lockstep else None
        progress = self._publisher(UInt64, "~/progress", latched_qos())
        self._state = self._publisher(String, topics.DRIVES, latched_qos())
        self._publisher(String, topics.DESCRIPTION, latched_qos()).publish(String(data=node.robot.urdf))
        self.commands = self._subscription(JointState, topics.COMMAND, chain_qos(4 * len(self._names)))
        self._behind = self._subscription(UInt64, topics.PROGRESS, latched_qos())
        self.send_readings(turn)
        turn.plane.report_progress(turn.plane.outbox(progress.handle, ENCAPSULATION + bytes(8), _plane.NO_STAMP, []))
        if commands:
            turn.plane.listen(self.commands.handle, list(self._names))
        turn.plane.follow_recorder(self._behind.handle)

    def _publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        self._others.append(self._node.create_publisher(kind, topic, qos))
        return self._others[-1]

    def _subscription(self, kind: Any, topic: str, qos: Any) -> Any:
        group = self._node.group
        return self._node.create_subscription(kind, topic, lambda _: None, qos, callback_group=group, raw=True)

    def send_readings(self, turn: PlantTurn) -> None:
        """Makes the lists of the turn anew: readings of a tick, its clock, and now and then one temperature each."""
        plane, arrays = turn.plane, sensor_arrays(turn.sensors)
        plane.send.clear(), plane.temperature.clear()
        for output in self._sensors:
            plane.send.send(output.outbox(plane, arrays[output.topic]))
        if self._clock is not None:
            codec = ClockCodec()
            plane.send.send(plane.outbox(self._clock.handle, codec.encode(), codec.stamp_place, []))
        texts = [encode_text(state) for state in topics.DRIVE_STATES]
        state = plane.outbox(self._state.handle, texts[0], _plane.NO_STAMP, [])
        plane.send.announce(state, turn.drives.state_capsule(), texts)
        found = turn.sensors.view("motor_temperature")
        for joint, name in enumerate(self._names):
            warm = TemperatureCodec(name)
            runs = message_runs(warm, {"temperature": found[joint : joint + 1]})
            box = plane.outbox(self._temperature.handle, warm.encode(0, name), warm.stamp_place, runs)
            plane.temperature.send(box)

    def foreign_report(self) -> dict[str, str]:
        """For diagnostics: who may have sent commands of another run id."""
        foreign = self._plane.statistics.foreign - self._plane.unreadable
        return foreign_report(self._node, {topics.COMMAND: foreign})

    def destroy(self) -> None:
        """Removes the topics; the turn is closed."""
        for publisher in (*self.sensor_publishers, *self._others):
            self._node.destroy_publisher(publisher)
        for subscription in (self.commands, self._behind):
            self._node.destroy_subscription(subscription)


def plant_status(turn: PlantTurn, world: World, seam: PlantTopics) -> tuple[bytes, str, dict[str, Any]]:
    """Level, one line and values for diagnostics."""
    stop, values = world.report()
    counts = turn.statistics.summary()
    values = {"loop": turn.kind, **counts} | values | {"tick": turn.tick, "skipped": turn.skipped}
    values |= seam.foreign_report()
    if late := world.seam.late + turn.skipped:
        values["overrun"] = Fault(FaultCode.OVERRUN, -1, late, 0.0, Action.REPORT).text()
    if stop or turn.fault:
        return ERROR, "; ".join(filter(None, [turn.fault, stop])), values
    return (WARN, "late or foreign commands", values) if world.seam.late or counts["foreign"] else (OK, "", values)
