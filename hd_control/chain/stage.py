"""A law at its place in the chain: arrays of topics in, arrays of topics out. Knows no ROS and reads no clock.

A stage is the face of a compiled tick (`cpp/chain.hpp`): its blocks are views of the tick's memory, `act` is one call.
Nodes, the process `chain`, the runner without ROS and replay all run these objects. Parameters may change while the law
runs: the tick goes over to them without a jump, a model within `RAMP_TIME`, gains and bounds within `GAIN_TIME`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hd_control.chain.wiring import Wiring
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout
from hd_control.core.robot import Robot
from hd_control.core.topics import Place

RAMP_TIME = 0.5
"""s from the old model to the new one."""
Bus = dict[str, dict[str, FloatArray]]
"""Arrays of the present tick by topic and name (`position`, `velocity`, `effort`), for all joints of the robot."""

TICK = "tick"
"""In destinations of a message: its tick, beside its arrays."""

OK, WARN, ERROR = 0, 1, 2
"""Levels of a report, as in diagnostics."""


def ramp_kinds(law: Any, params: Layout) -> list[int]:
    """How each number of a parameter block changes while the law runs: 0 at once, 1 as a gain, 2 as a model.

    A law module says with `MODEL_FIELDS` which fields are a model of the drive; every other field that has values per
    joint is a gain or a bound; switches and numbers of the whole law act at the next tick.
    """
    kinds, model = np.zeros(params.size, dtype=int), set(getattr(law, "MODEL_FIELDS", ()))
    for field in params.fields:
        kinds[params.slices[field.name]] = 2 if field.name in model else int(field.per_joint > 0)
    found: list[int] = kinds.tolist()
    return found


def start_places(law: Any, params: Layout, state: Layout) -> list[tuple[int, int]]:
    """Numbers of the state, each with the number of the parameters that it starts at (`START_VALUES` of the law)."""
    starts: Mapping[str, str] = getattr(law, "START_VALUES", {})
    found: list[tuple[int, int]] = []
    for name, source in starts.items():
        if name in state.slices and source in params.slices:
            own, given = state.slices[name], params.slices[source]
            found += zip(range(own.start, own.stop), range(given.start, given.stop), strict=True)
    return found


class Stage:
    """One law with its wiring around a compiled tick. `adopt` may be called by any thread.

    `law` is a law module (docs/architecture.md). `joint_names` are the joints that it runs, all if empty. A subclass
    makes the tick with `_use` before anything else.
    """

    native: Any
    sample: Block
    reference: Block | None

    def __init__(self, wiring: Wiring, law: Any, robot: Robot, dt: float, joint_names: Sequence[str] = ()) -> None:
        self.wiring, self.law, self.robot, self.dt = wiring, law, robot, dt
        self.joint_names = tuple(joint_names) or robot.joint_names
        indices = robot.indices(self.joint_names)
        self._pick: Any = slice(None) if self.joint_names == robot.joint_names else np.array(indices)
        self.reference = None
        self._offered: Block | None = None

    def _use(self, native: Any, blocks: Mapping[str, Layout]) -> None:
        """The compiled tick and the layouts of its blocks: params, sample, reference, output, state."""
        self.native, self._layouts = native, blocks
        self.sample = Block(blocks["sample"], native.sample)
        if "reference" in blocks:
            self.reference = Block(blocks["reference"], native.reference)
        self._output = Block(blocks["output"], native.output)
        self._state = Block(blocks["state"], native.state)
        rows = [*self.wiring.sample.items(), *self.wiring.slow.items()]
        self.inputs = [(self.sample.view(name), *source) for name, source in rows]
        if self.reference is not None:
            self.inputs += [(self.reference.view(name), *source) for name, source in self.wiring.reference.items()]
        self._results = self.outgoing_arrays()
        self.input_ticks: FloatArray | None = getattr(native, "input_ticks", None)

    # ---- parameters and state ---------------------------------------------------------------------------------

    @property
    def tick(self) -> int:
        """The tick of the last step, -1 before the first."""
        return int(self.native.tick)

    @property
    def params(self) -> Block:
        """The numbers that the law runs with now, on the way to those that were adopted. A view."""
        return Block(self._layouts["params"], self.native.params)

    @property
    def state(self) -> Block | None:
        """The law's memory, a view; None before the first tick."""
        return self._state if self.native.has_state else None

    @property
    def output(self) -> Block | None:
        """Every term of the last step, a view; None before the first tick."""
        return self._output if self.native.has_state else None

    def prepare(self, values: Mapping[str, Any]) -> Block:
        """The parameter block of a complete set of values. Raises ConfigError."""
        return self.law.configure(values, self.robot, self.dt)  # type: ignore[no-any-return]

    def adopt(self, params: Block) -> None:
        """Takes a new parameter block, from any thread; the next tick uses it, a changed model ramps from there."""
        self._offered = params
        self.native.offer(params.array)
        if not self.native.has_state and self.native.tick < 0:
            self.native.arrive()

    def start(self) -> None:
        """A new activation; what survives is said by the tick."""
        self.native.start()

    # ---- one tick ---------------------------------------------------------------------------------------------

    def step(self, tick: int, bus: Bus) -> Bus:
        """One tick: reads its inputs from the bus, returns the arrays of each topic that it makes."""
        self.read(bus, tick)
        self.act(tick)
        return self.results()

    def act(self, tick: int) -> None:
        """The law on what sample and reference hold now; `outgoing` has the numbers to publish then."""
        self.native.act(tick)

    def step_capsule(self) -> Any:
        """`act` for a loop without the interpreter."""
        return self.native.step_capsule()

    def read(self, bus: Bus, tick: int) -> None:
        """Fills sample and reference from the bus of a tick; a topic that is absent leaves its fields as they were."""
        pick, ticks = self._pick, self.input_ticks
        for view, topic, array in self.inputs:
            arrays = bus.get(topic)
            if arrays is not None:
                view[:] = arrays[array][pick]
        for place, topic in enumerate(self.wiring.inputs if ticks is not None else ()):
            if topic in bus:
                ticks[place] = tick  # type: ignore[index]

    def read_slow(self, bus: Bus) -> None:
        """Fills the fields that are updated now and then; a topic that is absent leaves them as they were."""
        for name, (topic, array) in self.wiring.slow.items():
            if topic in bus:
                self.sample.view(name)[:] = bus[topic][array][self._pick]

    def absent(self, topic: str) -> None:
        """An optional input is not there in this tick."""
        for target, source in self.stand_ins(topic):
            target[:] = 0.0 if source is None else source

    def stand_ins(self, topic: str) -> list[tuple[FloatArray, FloatArray | None]]:
        """What an optional input is replaced by while it was never seen: fields with their sources, None for zero."""
        return []

    def copies(self, bus: Bus) -> list[tuple[str, FloatArray, FloatArray]]:
        """What `read` does with this bus, as pieces of memory: topic, from, to. For a compiled list of what happens."""
        found, pick = [], self._pick
        for view, topic, array in self.inputs:
            if topic in bus and isinstance(pick, slice):
                found.append((topic, bus[topic][array], view))
            elif topic in bus:
                numbers = bus[topic][array]
                found += [(topic, numbers[row : row + 1], view[i : i + 1]) for i, row in enumerate(pick.tolist())]
        return found

    def outgoing_arrays(self) -> Bus:
        """Where the numbers of each topic are after `act`: views, by topic and array."""
        return {
            topic: {a: self.outgoing[part.start : part.stop] for a, part in self.outgoing_places(topic).items()}
            for topic in self.wiring.outputs
        }

    def results(self) -> Bus:
        """Output fields as the arrays of each topic, copies."""
        return {topic: {a: view.copy() for a, view in arrays.items()} for topic, arrays in self._results.items()}

    @property
    def outgoing(self) -> FloatArray:
        """All numbers that the outputs are taken from, as one array; `outgoing_places` says where each lies."""
        return self._output.array

    def outgoing_places(self, topic: str) -> dict[str, range]:
        """Where the numbers of each array of a topic lie in `outgoing`."""
        parts = {array: self._output.layout.slices[name] for array, name in self.wiring.outputs[topic].items()}
        return {array: range(part.start, part.stop) for array, part in parts.items()}

    def destinations(self, topic: str) -> dict[str, list[tuple[FloatArray, list[int]]]]:
        """By array of the topic: the views of sample and reference that take it, with the robot's joints they take.

        Under `TICK`: the number that takes the tick of the message.
        """
        joints = self.robot.indices(self.joint_names)
        found: dict[str, list[tuple[FloatArray, list[int]]]] = {}
        for block, fields in ((self.sample, self.wiring.sample), (self.reference, self.wiring.reference)):
            for name, (source, array) in fields.items():
                if source == topic and block is not None:
                    found.setdefault(array, []).append((block.view(name), joints))
        if self.input_ticks is not None:
            found[TICK] = [(self.input_ticks, [self.wiring.inputs.index(topic)])]
        return found

    # ---- for those who look on --------------------------------------------------------------------------------

    def signals(self) -> list[tuple[FloatArray, dict[tuple[str, str], slice]]]:
        """What the stage receives, for a black box: arrays of numbers, and where each array of a topic lies in them."""
        found = [_columns(self.sample, self.wiring.sample)]
        return found if self.reference is None else [*found, _columns(self.reference, self.wiring.reference)]

    def names(self) -> list[str]:
        """Names of the introspection numbers, `fusion/output/joint_position/joint_1` and so on."""
        return [
            f"{self.wiring.name}/{kind}/{name}"
            for kind, block in (("output", self._output), ("state", self._state))
            for name in block.layout.element_names(self.joint_names)
        ]

    def numbers(self) -> list[FloatArray]:
        """The introspection numbers in the order of `names`; views."""
        return [self._output.array, self._state.array]

    def report(self) -> tuple[int, str, dict[str, Any]]:
        """Level, one line and values for diagnostics."""
        return OK, "", {}

    def emergency(self, error: BaseException | None = None) -> None:
        """An exception happened somewhere in the node: bring the outputs to a stop."""


def _columns(block: Block, sources: Mapping[str, Place]) -> tuple[FloatArray, dict[tuple[str, str], slice]]:
    return block.array, {source: block.layout.slices[name] for name, source in sources.items()}
