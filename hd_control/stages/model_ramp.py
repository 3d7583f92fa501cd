"""A change of parameters while the law runs: parameters and start values go over to the new ones without a jump.

A law module says with `MODEL_FIELDS` which fields of its parameter block are a model of the drive, and with
`START_VALUES` which field of its state starts at which of them. These ramp over `RAMP_TIME`; every other field that has
values per joint (gains, bounds) ramps over `GAIN_TIME`; switches and numbers of the whole law act at the next tick.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hd_control.core.blocks import Block

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
