"""Shell of nodes that run laws: one stage or several in a row, in one turn of the fast loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sensor_msgs.msg import JointState

from hd_control import _chain, _plane
from hd_control.chain.stage import Bus, Stage
from hd_control.core import topics
from hd_control.core.arrays import FloatArray
from hd_control.core.parameters import ParameterSet
from hd_control.nodes.fast_loop import JoinedTurn, RawInput, TemperatureInput, chain_qos, message_runs, wait_matched
from hd_control.nodes.shell import OK, Introspection, Shell, foreign_report
from hd_control.record.schema import joint_state_codec


class Output:
    """A chain topic of some joints, published as bytes with the run id of the node."""

    def __init__(self, node: Shell, topic: str, joint_names: Sequence[str]) -> None:
        self.topic = topic
        self.publisher = node.create_publisher(JointState, topic, chain_qos(node.values["publisher_depth"]))
        self._codec = joint_state_codec(topic, joint_names)
        self._template = self._codec.encode(0, node.run_id)

    def outbox(self, plane: _plane.Loop, arrays: Mapping[str, FloatArray]) -> _plane.Outbox:
        """The message in a loop: its arrays are taken from where they are."""
        runs = message_runs(self._codec, arrays)
        return plane.outbox(self.publisher.handle, self._template, self._codec.stamp_place, runs)


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
    """Runs `stages` in order whenever all inputs of one tick have arrived, and publishes what each makes.

    What happens in a tick is a compiled list (`_wire`); the steps are the stages' own.
    """

    def __init__(self, name: str, own: ParameterSet, prefixes: Sequence[str] = ("",)) -> None:
        self.prefixes = tuple(prefixes)
        self.stages: list[Stage] = []
        self.inputs: list[RawInput] = []
        self.temperature: TemperatureInput | None = None
        self.outputs: list[list[Output]] = []
        self._turn: JoinedTurn | None = None
        self._wired: list[Any] = []
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

    # ---- topics -----------------------------------------------------------------------------------------------

    def build(self) -> Callable[[], None]:
        made = [topic for stage in self.stages for topic in stage.wiring.outputs]
        wanted = dict.fromkeys(topic for stage in self.stages for topic in stage.wiring.inputs if topic not in made)
        self.inputs = [RawInput(self, topic, self.robot.joint_names, self.group) for topic in wanted]
        if self.stages[0].wiring.slow:
            self.temperature = TemperatureInput(self, self.robot.joint_names, self.group)
        self.make_outputs()
        return self._wire()

    def make_outputs(self) -> None:
        """The topics of every stage, and the node's introspection."""
        self.outputs = [[Output(self, t, stage.joint_names) for t in stage.wiring.outputs] for stage in self.stages]
        self.introspection = Introspection(self, [name for stage in self.stages for name in stage.names()])

    @property
    def publishers(self) -> list[Any]:
        """Publishers of all stages."""
        return [output.publisher for outputs in self.outputs for output in outputs]

    def destroy_topics(self) -> None:
        """Destroys what `build` created; the loop is closed."""
        for raw in (*self.inputs, *filter(None, [self.temperature])):
            self.destroy_subscription(raw.subscription)
        for publisher in self.publishers:
            self.destroy_publisher(publisher)
        if self.introspection is not None:
            self.introspection.destroy(self)
            self.introspection = None

    # ---- the compiled tick ------------------------------------------------------------------------------------

    def _wire(self) -> JoinedTurn:
        """The list of a tick on the memory that the stages have now."""
        first = self.stages[0]
        optional = [index for index, raw in enumerate(self.inputs) if raw.topic in first.wiring.optional]
        destinations = [first.destinations(raw.topic) for raw in self.inputs]
        self._turn = turn = JoinedTurn(self.inputs, destinations, self.dt_ns, optional)
        for index in optional:
            for target, source in first.stand_ins(self.inputs[index].topic):
                turn.plane.substitute(index, target, source)
        if self.temperature is not None:
            turn.add_temperature(self.temperature, self._temperature_targets())
        self.add_stages(turn.plane, turn.plane.program, {}, turn.plane.again)
        self._wired = [stage.native for stage in self.stages]
        return turn

    def _temperature_targets(self) -> dict[str, list[tuple[FloatArray, int]]]:
        """By joint name: where the first stage keeps its temperature."""
        first = self.stages[0]
        views = [
            first.sample.view(name) for name, (topic, _) in first.wiring.slow.items() if topic == topics.TEMPERATURE
        ]
        return {name: [(view, place) for view in views] for place, name in enumerate(first.joint_names)}

    def add_stages(
        self, plane: _plane.Loop, program: _plane.Program, bus: Bus, again: _plane.Program | None = None
    ) -> None:
        """All stages in a row, each result sent as soon as it is there. `bus`: where the inputs of the first are.

        `again` sends the answer of the present tick to a sender that has not got it: a message may be lost while nodes
        find each other.
        """
        for stage, outputs in zip(self.stages, self.outputs, strict=True):
            for _, source, target in stage.copies(bus):
                program.copy(source, target)
            if bus and stage.input_ticks is not None:
                stamp = _chain.Sequence()
                stamp.stamp(stage.input_ticks)
                program.step(stamp.step_capsule())
            program.step(stage.step_capsule())
            made = stage.outgoing_arrays()
            for output in outputs:
                outbox = output.outbox(plane, made[output.topic])
                program.send(outbox)
                if again is not None:
                    again.send(outbox)
            bus = bus | made
        self.after_stages(plane, program)
        if self.introspection is not None:
            numbers = [part for stage in self.stages for part in stage.numbers()]
            program.send(self.introspection.outbox(plane, numbers))

    def after_stages(self, plane: _plane.Loop, program: _plane.Program) -> None:
        """What else happens in a tick."""

    # ---- lifecycle --------------------------------------------------------------------------------------------

    def begin(self) -> None:
        for stage in self.stages:
            stage.start()
        if self._wired != [stage.native for stage in self.stages]:  # another law in the same place has other memory
            self._rewire()
        assert self._turn is not None
        wait_matched([raw.subscription for raw in self.inputs], self.publishers)
        self._turn.restart()
        if self.temperature is not None:
            self.stages[0].read_slow({topics.TEMPERATURE: self.temperature.values})
        self._turn.active = True

    def _rewire(self) -> None:
        self.loop.remove()
        if self._turn is not None:
            self._turn.close()
        self.loop.install(self._wire())

    def end(self) -> None:
        if self._turn is not None:
            self._turn.active = False

    def dismantle(self) -> None:
        if self._turn is not None:
            self._turn.close()
            self._turn = None
        self.destroy_topics()

    def emergency(self, error: BaseException | None = None) -> None:
        for stage in self.stages:
            stage.emergency(error)

    def status(self) -> tuple[bytes, str, dict[str, Any]]:
        values: dict[str, Any] = {}
        if self._turn is not None:
            plane = self._turn.plane
            values |= {"loop": self._turn.kind, **plane.statistics.summary()}
            values |= foreign_report(self, {raw.topic: plane.dropped(i)[0] for i, raw in enumerate(self.inputs)})
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
