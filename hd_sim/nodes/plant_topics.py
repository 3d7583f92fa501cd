"""The plant's topics: `motor_torque_command` merged by joint name, sensors out, and what the plant says of itself."""

from __future__ import annotations

from typing import Any

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String, UInt64

from hd_control import _plane
from hd_control.core import topics
from hd_control.core.faults import Action, Fault, FaultCode
from hd_control.nodes.fast_loop import chain_qos, latched_qos
from hd_control.nodes.shell import ERROR, OK, WARN, Shell, foreign_report
from hd_control.nodes.stage_shell import Output
from hd_control.record.cdr import ENCAPSULATION, ClockCodec, TemperatureCodec
from hd_sim.nodes.plant_turn import PlantTurn
from hd_sim.world import World, sensor_places


class PlantTopics:
    """Creates the plant's topics and lets the turn send and take them.

    With `commands` the command comes from `motor_torque_command`, from one torque node or several: the first publisher
    of a joint is bound by its run id, another one is foreign until the robot has stopped.
    """

    def __init__(self, node: Shell, world: World, turn: PlantTurn, lockstep: bool, commands: bool = True) -> None:
        self._node, self._names, self._plane = node, world.joint_names, turn.plane
        self._add_sensors(turn)
        self._add_temperatures(turn)
        self._others: list[Any] = []
        if lockstep:
            codec, clock = ClockCodec(), self._publisher(Clock, topics.CLOCK, chain_qos())
            turn.plane.send.send(turn.plane.outbox(clock.handle, codec.encode(), codec.stamp_place, []))
        progress = self._publisher(UInt64, "~/progress", latched_qos())
        number = ENCAPSULATION + bytes(8)
        turn.plane.report_progress(turn.plane.outbox(progress.handle, number, _plane.NO_STAMP, []))
        self._publisher(String, topics.DESCRIPTION, latched_qos()).publish(String(data=node.robot.urdf))
        self.commands = self._subscription(JointState, topics.COMMAND, chain_qos(4 * len(self._names)))
        self._behind = self._subscription(UInt64, topics.PROGRESS, latched_qos())
        if commands:
            turn.plane.listen(self.commands.handle, list(self._names))
        turn.plane.follow_recorder(self._behind.handle)

    def _publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        self._others.append(self._node.create_publisher(kind, topic, qos))
        return self._others[-1]

    def _subscription(self, kind: Any, topic: str, qos: Any) -> Any:
        group = self._node.group
        return self._node.create_subscription(kind, topic, lambda _: None, qos, callback_group=group, raw=True)

    def _add_sensors(self, turn: PlantTurn) -> None:
        places, numbers = sensor_places(turn.sensors), turn.sensors.array
        outputs = [
            Output(self._node, turn.plane, topic, self._names, places[topic], numbers) for topic in topics.SENSORS
        ]
        for output in outputs:
            turn.plane.send.send(output.outbox)
        self.sensor_publishers = [output.publisher for output in outputs]

    def _add_temperatures(self, turn: PlantTurn) -> None:
        """One message per joint, from the readings of the same tick."""
        self._temperature = self._node.create_publisher(
            Temperature, topics.TEMPERATURE, chain_qos(2 * len(self._names))
        )
        found = turn.sensors.view("motor_temperature")
        for joint, name in enumerate(self._names):
            codec = TemperatureCodec(name)
            runs = [(codec.places["temperature"][0], found[joint : joint + 1])]
            box = turn.plane.outbox(self._temperature.handle, codec.encode(0, name), codec.stamp_place, runs)
            turn.plane.temperature.send(box)

    def foreign_report(self) -> dict[str, str]:
        """For diagnostics: who may have sent commands of another run id."""
        foreign = self._plane.statistics.foreign - self._plane.unreadable
        return foreign_report(self._node, {topics.COMMAND: foreign})

    def destroy(self) -> None:
        """Removes the topics; the turn is closed."""
        for publisher in (*self.sensor_publishers, self._temperature, *self._others):
            self._node.destroy_publisher(publisher)
        for subscription in (self.commands, self._behind):
            self._node.destroy_subscription(subscription)


def plant_status(turn: PlantTurn, world: World, seam: PlantTopics) -> tuple[bytes, str, dict[str, Any]]:
    """Level, one line and values for diagnostics."""
    stop, values = world.report()
    values["stale"] += turn.table.stale
    counts = turn.statistics.summary()
    values = {"loop": turn.kind, **counts} | values | {"tick": turn.tick, "skipped": turn.skipped}
    values |= seam.foreign_report()
    if late := world.seam.late + turn.skipped:
        values["overrun"] = Fault(FaultCode.OVERRUN, -1, late, 0.0, Action.REPORT).text()
    if stop or turn.fault:
        return ERROR, "; ".join(filter(None, [turn.fault, stop])), values
    return (WARN, "late or foreign commands", values) if world.seam.late or counts["foreign"] else (OK, "", values)
