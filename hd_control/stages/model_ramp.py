"""A change of the model while the law runs: parameters and start values go over to the new ones without a jump.

A law module says with `MODEL_FIELDS` which fields of its parameter block are a model of the drive, and with
`START_VALUES` which field of its state starts at which of them. These ramp over `RAMP_TIME`; all other fields (gains,
bounds, switches without effect at zero) act at the next tick. Method sheet, section 14.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hd_control.core.blocks import Block

RAMP_TIME = 0.5
"""s from the old model to the new one."""


class ModelRamp:
    """The way from one parameter block to another, tick by tick."""

    def __init__(self, law: Any, before: Block, after: Block, state: Block, ticks: int) -> None:
        self.before, self.after, self.ticks, self.tick = before.copy(), after, ticks, 0
        self._fields = [name for name in model_fields(law) if name in after.layout.slices]
        self._moves = list(self._start_moves(law, state))

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
        share, params = self.tick / self.ticks, self.after.copy()
        for name in self._fields:
            old, new = self.before.view(name), self.after.view(name)
            params.view(name)[...] = old + share * (new - old)
        return params, state


def model_fields(law: Any) -> tuple[str, ...]:
    """Fields of a law's parameter block that are a model of the drive."""
    return tuple(getattr(law, "MODEL_FIELDS", ()))


def ramp_to(law: Any, before: Block, after: Block, state: Block | None, dt: float) -> ModelRamp | None:
    """A ramp if the model changes while the law runs; None if the new block may act at once."""
    if state is None or before.layout != after.layout:
        return None
    fields = [name for name in model_fields(law) if name in after.layout.slices]
    if all(np.array_equal(before.view(name), after.view(name)) for name in fields):
        return None
    return ModelRamp(law, before, after, state, max(1, round(RAMP_TIME / dt)))
