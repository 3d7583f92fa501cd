"""A law at its place in the chain: arrays of topics in, arrays of topics out, parameters that change without a jump.

Knows no ROS and reads no clock. `Stage` runs one law per tick; `ModelRamp` leads its parameters and start values from
one block to another while it runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hd_control.chain.wiring import Wiring
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.core.robot import Robot
from hd_control.core.topics import Place

# ---- A change of parameters while the law runs -----------------------------------------------------
#
# A law module says with `MODEL_FIELDS` which fields of its parameter block are a model of the drive, and with
# `START_VALUES` which field of its state starts at which of them. These ramp over `RAMP_TIME`; every other field that
# has values per joint (gains, bounds) ramps over `GAIN_TIME`; switches and numbers of the whole law act at the next
# tick.


RAMP_TIME = 0.5
"""s from the old model to the new one."""
GAIN_TIME = 0.1
"""s from old gains and bounds to new ones."""


class ModelRamp:
    """The way from one parameter block to another, tick by tick. `dt` s is the length of a tick."""

    def __init__(self, law: Any, before: Block, after: Block, state: Block, dt: float) -> None:
        self.before, self.after, self.tick = before.copy(), after, 0
        self.ticks = max(1, round(RAMP_TIME / dt))
        gain_ticks, model = max(1, round(GAIN_TIME / dt)), model_fields(law)
        self._fields = [
            (name, self.ticks if name in model else gain_ticks) for name in changed_fields(law, before, after)
        ]
        self._moves = list(self._start_moves(law, state))
        if not self._moves:
            self.ticks = max((ticks for _, ticks in self._fields), default=1)

    def _start_moves(self, law: Any, state: Block) -> Any:
        """State field and its change per tick, for the joints whose start value changes."""
        starts: Mapping[str, str] = getattr(law, "START_VALUES", {})
        for name, source in starts.items():
            if name in state.layout.slices and source in self.after.layout.slices:
                old, new = self.before.view(source), self.after.view(source)
                change = np.where(new != old, new - state.view(name), 0.0)
                if np.any(change != 0.0):
                    yield name, change / self.ticks

    @property
    def done(self) -> bool:
        """True once the new block is reached."""
        return self.tick >= self.ticks

    def step(self, state: Block) -> tuple[Block, Block]:
        """Parameters and state for the next tick; the blocks given stay as they were."""
        self.tick += 1
        if self._moves:
            state = state.copy()
            for name, change in self._moves:
                state.view(name)[...] += change
        if self.done:
            return self.after, state
        params = self.after.copy()
        for name, ticks in self._fields:
            if self.tick >= ticks:
                continue
            share = self.tick / ticks
            old, new = self.before.view(name), self.after.view(name)
            params.view(name)[...] = old + share * (new - old)
        return params, state


def model_fields(law: Any) -> tuple[str, ...]:
    """Fields of a law's parameter block that are a model of the drive."""
    return tuple(getattr(law, "MODEL_FIELDS", ()))


def changed_fields(law: Any, before: Block, after: Block) -> list[str]:
    """Fields that ramp and differ: those with values per joint, and the model."""
    per_joint = [field.name for field in after.layout.fields if field.per_joint]
    names = dict.fromkeys((*per_joint, *(name for name in model_fields(law) if name in after.layout.slices)))
    return [name for name in names if not np.array_equal(before.view(name), after.view(name))]


def ramp_to(law: Any, before: Block, after: Block, state: Block | None, dt: float) -> ModelRamp | None:
    """A ramp if a number of the law changes while it runs; None if the new block may act at once."""
    if state is None or before.layout != after.layout or not changed_fields(law, before, after):
        return None
    return ModelRamp(law, before, after, state, dt)


# ---- The stage -------------------------------------------------------------------------------------


Bus = dict[str, dict[str, FloatArray]]
"""Arrays of the present tick by topic and name (`position`, `velocity`, `effort`), for all joints of the robot."""

OK, WARN, ERROR = 0, 1, 2
"""Levels of a report, as in diagnostics."""


class Stage:
    """One law with its wiring. `adopt` may be called by any thread: a reference is swapped (`ModelRamp`).

    `law` is a law module (docs/architecture.md). `joint_names` are the joints that it runs, all if empty.
    """

    def __init__(self, wiring: Wiring, law: Any, robot: Robot, dt: float, joint_names: Sequence[str] = ()) -> None:
        self.wiring, self.law, self.robot, self.dt = wiring, law, robot, dt
        self.joint_names = tuple(joint_names) or robot.joint_names
        indices = robot.indices(self.joint_names)
        self._pick: Any = slice(None) if self.joint_names == robot.joint_names else np.array(indices)
        joints = len(self.joint_names)
        self.sample: Block = law.new_sample(joints)
        self.reference: Block | None = law.new_reference(joints) if hasattr(law, "new_reference") else None
        rows = [*wiring.sample.items(), *wiring.slow.items()]
        self._inputs = [(self.sample.view(name), *source) for name, source in rows]
        if self.reference is not None:
            self._inputs += [(self.reference.view(name), *source) for name, source in wiring.reference.items()]
        self._results: list[tuple[str, str, slice]] = []
        self.params: Block | None = None
        self._newest: Block | None = None
        self._taken: Block | None = None
        self._ramp: ModelRamp | None = None
        self.state: Block | None = None
        self.output: Block | None = None
        self.tick = -1

    def prepare(self, values: Mapping[str, Any]) -> Block:
        """The parameter block of a complete set of values. Raises ConfigError."""
        return self.law.configure(values, self.robot, self.dt)  # type: ignore[no-any-return]

    def adopt(self, params: Block) -> None:
        """Takes a new parameter block, from any thread; the next tick uses it, a changed model ramps from there."""
        self._newest = params
        if self.state is None:
            self._arrive()

    def start(self) -> None:
        """Forgets the state; the next tick makes a new one from its sample."""
        self.state, self.tick = None, -1
        if self._newest is not None:
            self._arrive()

    def _arrive(self) -> None:
        """The newest parameters as a whole, without a ramp."""
        self.params = self._taken = self._newest
        self._ramp = None

    def _change(self) -> None:
        """In the loop, before the law's step: the next parameters on the way to the newest."""
        newest = self._newest
        if newest is not self._taken:
            assert self.params is not None and newest is not None
            self._ramp = ramp_to(self.law, self.params, newest, self.state, self.dt)
            self._taken = newest
            if self._ramp is None:
                self.params = newest
        ramp = self._ramp
        if ramp is not None and self.state is not None:
            self.params, self.state = ramp.step(self.state)
            self._ramp = None if ramp.done else ramp

    def step(self, tick: int, bus: Bus) -> Bus:
        """One tick: reads its inputs from the bus, returns the arrays of each topic that it makes."""
        self.read(bus)
        self.act(tick)
        return self.results()

    def act(self, tick: int) -> None:
        """The law on what sample and reference hold now; `outgoing` has the numbers to publish then."""
        self.advance()
        self.tick = tick

    def destinations(self, topic: str) -> dict[str, list[tuple[FloatArray, list[int]]]]:
        """By array of the topic: the views of sample and reference that take it, with the robot's joints they take."""
        joints = self.robot.indices(self.joint_names)
        found: dict[str, list[tuple[FloatArray, list[int]]]] = {}
        for block, fields in ((self.sample, self.wiring.sample), (self.reference, self.wiring.reference)):
            for name, (source, array) in fields.items():
                if source == topic and block is not None:
                    found.setdefault(array, []).append((block.view(name), joints))
        return found

    def signals(self) -> list[tuple[FloatArray, dict[tuple[str, str], slice]]]:
        """What the stage receives, for a black box: arrays of numbers, and where each array of a topic lies in them."""
        found = [_columns(self.sample, self.wiring.sample)]
        return found if self.reference is None else [*found, _columns(self.reference, self.wiring.reference)]

    def absent(self, topic: str) -> None:
        """An optional input is not there in this tick."""

    @property
    def outgoing(self) -> FloatArray:
        """All numbers that the outputs are taken from, as one array; `outgoing_places` says where each lies."""
        output = self.output
        assert output is not None
        return output.array

    def outgoing_places(self, topic: str) -> dict[str, range]:
        """Where the numbers of each array of a topic lie in `outgoing`; known after `names`."""
        output = self.output
        assert output is not None
        parts = {array: output.layout.slices[name] for array, name in self.wiring.outputs[topic].items()}
        return {array: range(part.start, part.stop) for array, part in parts.items()}

    def read(self, bus: Bus) -> None:
        """Fills sample and reference from the bus; a topic that is absent leaves its fields as they were."""
        pick = self._pick
        for view, topic, array in self._inputs:
            arrays = bus.get(topic)
            if arrays is not None:
                view[:] = arrays[array][pick]

    def read_slow(self, bus: Bus) -> None:
        """Fills the fields that are updated now and then; a topic that is absent leaves them as they were."""
        for name, (topic, array) in self.wiring.slow.items():
            if topic in bus:
                self.sample.view(name)[:] = bus[topic][array][self._pick]

    def advance(self) -> None:
        """The law's step, with the state made on the first tick."""
        if self._newest is not self._taken or self._ramp is not None:
            self._change()
        params = self.params
        assert params is not None
        if self.state is None:
            self.state = self.law.initial_state(params, self.sample)
        given = (self.sample,) if self.reference is None else (self.sample, self.reference)
        self.output, self.state = self.law.step(params, self.state, *given, self.dt)

    def results(self) -> Bus:
        """Output fields as the arrays of each topic."""
        assert self.output is not None
        if not self._results:
            parts = self.output.layout.slices
            outputs = self.wiring.outputs.items()
            self._results = [(topic, array, parts[name]) for topic, arrays in outputs for array, name in arrays.items()]
        numbers = self.output.array
        found: Bus = {}
        for topic, array, part in self._results:
            found.setdefault(topic, {})[array] = numbers[part]
        return found

    def blocks(self) -> list[tuple[str, Block]]:
        """The blocks of the present tick by kind, for introspection."""
        return [(kind, block) for kind, block in (("output", self.output), ("state", self.state)) if block is not None]

    def names(self) -> list[str]:
        """Names of the introspection numbers, `fusion/output/joint_position/joint_1` and so on."""
        self.advance()
        found = [
            f"{self.wiring.name}/{kind}/{name}"
            for kind, block in self.blocks()
            for name in block.layout.element_names(self.joint_names)
        ]
        self.state = None
        return found

    def numbers(self) -> list[FloatArray]:
        """The introspection numbers in the order of `names`."""
        return [block.array for _, block in self.blocks()]

    def report(self) -> tuple[int, str, dict[str, Any]]:
        """Level, one line and values for diagnostics."""
        return OK, "", {}

    def emergency(self, error: BaseException | None = None) -> None:
        """An exception happened somewhere in the node: bring the outputs to a stop."""


def _columns(block: Block, sources: Mapping[str, Place]) -> tuple[FloatArray, dict[tuple[str, str], slice]]:
    return block.array, {source: block.layout.slices[name] for name, source in sources.items()}
