"""Shell of nodes that run laws: one stage or several in a row, in one turn of the fast loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from hd_control.chain.stage import Bus, Stage
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.parameters import ParameterSet
from hd_control.nodes.fast_loop import JoinedTurn, RawInput, TemperatureInput, chain_qos, make_message, wait_matched
from hd_control.nodes.shell import OK, Introspection, Shell, foreign_report
from hd_control.record.schema import joint_state_codec


class Output:
    """A chain topic of some joints, published as bytes with the run id of the node.

    `places` says where its arrays lie in the array of numbers that `publish` is given.
    """

    def __init__(
        self, node: Shell, topic: str, joint_names: Sequence[str], places: Mapping[str, Sequence[int]]
    ) -> None:
        self.publisher = node.create_publisher(JointState, topic, chain_qos(node.values["publisher_depth"]))
        self._publish = self.publisher.handle.publish_raw
        codec = joint_state_codec(topic, joint_names)
        self._encode = make_message(codec, node.run_id, places).encode

    def publish(self, stamp_ns: int, numbers: FloatArray) -> None:
        """One message."""
        self._publish(self._encode(stamp_ns, numbers))


def prefixed(parameters: ParameterSet, prefix: str) -> ParameterSet:
    """The same parameters and rules under `prefix.name`, for several laws in one node."""
    from dataclasses import replace

    head = f"{prefix}."
    renamed = tuple(replace(p, name=head + p.name) for p in parameters.parameters)

    def rule(values: Mapping[str, Any]) -> list[str]:
        own = {name.removeprefix(head): value for name, value in values.items() if name.startswith(head)}
        return [text for each in parameters.rules for text in each(own)]

    return ParameterSet(parameters.owner, renamed, (rule,))


class StageShell(Shell):
    """Runs `stages` in order whenever all inputs of one tick have arrived, and publishes what each makes."""

    def __init__(self, name: str, own: ParameterSet, prefixes: Sequence[str] = ("",)) -> None:
        self.prefixes = tuple(prefixes)
        self.stages: list[Stage] = []
        self._turn: JoinedTurn | None = None
        self.outputs: list[list[Output]] = []
        self._optional: list[tuple[int, str]] = []
        self._waived: list[tuple[int, str]] = []
        self._answer_stamp_ns = 0
        super().__init__(name, own)

    def make_stages(self, values: Mapping[str, Any]) -> list[Stage]:
        """The stages of this node; the robot and the period are known."""
        raise NotImplementedError

    def prepare(self, values: Mapping[str, Any]) -> list[Any]:
        if not self.stages:
            self.stages = self.make_stages(values)
        return [
            stage.prepare(own_values(values, prefix)) for stage, prefix in zip(self.stages, self.prefixes, strict=True)
        ]

    def adopt(self, prepared: list[Any]) -> None:
        for stage, params in zip(self.stages, prepared, strict=True):
            stage.adopt(params)

    def build(self) -> Callable[[], None]:
        made = [topic for stage in self.stages for topic in stage.wiring.outputs]
        wanted = list(
            dict.fromkeys(topic for stage in self.stages for topic in stage.wiring.inputs if topic not in made)
        )
        self.inputs = [RawInput(self, topic, self.robot.joint_names, self.group) for topic in wanted]
        self.introspection = Introspection(self, [name for stage in self.stages for name in stage.names()])
        self.outputs = self.make_outputs()
        first = self.stages[0]
        slow = bool(first.wiring.slow)
        self.temperature = TemperatureInput(self, self.robot.joint_names, self.group) if slow else None
        optional = [index for index, topic in enumerate(wanted) if topic in first.wiring.optional]
        self._optional = [(index, wanted[index]) for index in optional]
        destinations = [first.destinations(topic) for topic in wanted]
        self._turn = JoinedTurn(self.loop, self.inputs, destinations, self._tick, self.dt_ns, optional=optional)
        self._turn.on_repeat = self._answer_again
        return self._turn

    def begin(self) -> None:
        assert self._turn is not None
        wait_matched([raw.subscription for raw in self.inputs], self.publishers)
        self._turn.restart()
        self._waived = list(self._optional)
        if self.temperature is not None:
            self.stages[0].read_slow({topics.TEMPERATURE: self.temperature.values})
        for stage in self.stages:
            stage.start()
        self._turn.active = True

    def end(self) -> None:
        if self._turn is not None:
            self._turn.active = False

    def dismantle(self) -> None:
        for raw in (*self.inputs, *filter(None, [self.temperature])):
            self.destroy_subscription(raw.subscription)
        for publisher in self.publishers:
            self.destroy_publisher(publisher)
        if self.introspection is not None:
            self.introspection.destroy(self)
            self.introspection = None

    def emergency(self, error: BaseException | None = None) -> None:
        for stage in self.stages:
            stage.emergency(error)

    def make_outputs(self) -> list[list[Output]]:
        """The topics of every stage; after its `names`."""
        return [
            [Output(self, topic, stage.joint_names, stage.outgoing_places(topic)) for topic in stage.wiring.outputs]
            for stage in self.stages
        ]

    @property
    def publishers(self) -> list[Any]:
        """Publishers of all stages."""
        return [output.publisher for outputs in self.outputs for output in outputs]

    def _answer_again(self) -> None:
        """The sender of the present tick has no answer yet: a message was lost while nodes were finding each other."""
        for stage, outputs in zip(self.stages, self.outputs, strict=True):
            for output in outputs:
                output.publish(self._answer_stamp_ns, stage.outgoing)

    def run_stages(self, tick: int, stamp_ns: int, bus: Bus) -> None:
        """All stages in a row, each result published as soon as it is there. The first stage has its inputs already."""
        last = len(self.stages) - 1
        for index, stage in enumerate(self.stages):
            if index > 0:
                stage.read(bus, tick)
            stage.act(tick)
            numbers = stage.outgoing
            for output in self.outputs[index]:
                output.publish(stamp_ns, numbers)
            if index < last:
                bus.update(stage.results())
        self._answer_stamp_ns = stamp_ns
        introspection = self.introspection
        if introspection is not None and introspection.on:
            introspection.publish(np.concatenate([part for stage in self.stages for part in stage.numbers()]))

    def _tick(self, tick: int, stamp_ns: int) -> None:
        first, turn = self.stages[0], self._turn
        if self.temperature is not None and self.temperature.drain():
            first.read_slow({topics.TEMPERATURE: self.temperature.values})
        if self._waived and turn is not None:
            self._waived = [(index, topic) for index, topic in self._waived if not turn.join.seen(index)]
            for _, topic in self._waived:
                first.absent(topic)
        self.run_stages(tick, stamp_ns, {})

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        values: dict[str, Any] = {}
        if self._turn is not None:
            self._turn.statistics.foreign = sum(raw.foreign for raw in self.inputs)
            values |= self._turn.statistics.summary()
            values |= foreign_report(self, {raw.topic: raw.foreign - raw.unreadable for raw in self.inputs})
        level, texts = OK, []
        for stage in self.stages:
            stage_level, text, found = stage.report()
            level = max(level, bytes([stage_level]))
            values |= found
            texts += [text] if text else []
        return level, "; ".join(texts), values


def own_values(values: Mapping[str, Any], prefix: str) -> Mapping[str, Any]:
    """The values of one law: those under its prefix, without it, and the robot."""
    if not prefix:
        return values
    head = f"{prefix}."
    found = {name.removeprefix(head): value for name, value in values.items() if name.startswith(head)}
    return found | {"robot": values["robot"]}
