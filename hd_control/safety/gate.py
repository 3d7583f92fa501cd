"""Safety gate: the last layer before the motor command. It does not trust the controller.

The gate is compiled (`SafetyGate` in `cpp/safety.hpp`). No clock, no file, no exception for any number. Order of the
checks: finite -> tick and age -> active and latch -> size -> rate (against the torque that last left the gate).

- A compliant command leaves bit for bit as it came. Not active: exactly zero torque.
- Too large or too fast: limited, counted, reported. Too fast many times in a row: stop.
- Not finite, too old, or a tick that is not above the last one used: stop.
- A stop latches for all joints of the block: torque ramps to zero at the rate limit without changing sign, and the
  brake is requested. Only a reset ends it.

Here are its state as a block and its findings as values. This is not a certified safety function: a real arm needs a
hardware emergency stop and brakes of its own. Source: docs/equations/safety_gate.md (V1)-(V5).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block, Layout, layout_of
from hd_control.core.faults import Action, Fault, FaultCode

LARGEST_TICK = 2.0**53


@lru_cache
def state_layout(joints: int) -> Layout:
    """Layout of the gate's memory."""
    return layout_of("GateState", _laws.BLOCKS["GateState"], joints)


def initial_gate_state(joints: int) -> Block:
    """The gate before activation: no torque leaves it."""
    state = state_layout(joints).zeros()
    state.stop_joint = -1.0
    state.last_tick = -1.0
    return state


def safety_gate(
    command: FloatArray, ages: FloatArray, ticks: FloatArray, limits: Block, gate_state: Block
) -> tuple[FloatArray, Block, list[Fault]]:
    """One sample. Returns the torque that may leave (n,) N m, the new state, and the faults of this sample.

    `command` (n,) N m; `ages` (n,) samples since each command was computed from its oldest input; `ticks` (n,) tick
    numbers of those inputs; `limits` from `limits.configure_gate`.
    """
    joints = gate_state.layout.joints
    out = np.empty(joints)
    new_array = np.empty(gate_state.layout.size)
    rows = np.empty(joints * _laws.FAULTS_PER_JOINT * _laws.FAULT_FIELDS)
    count = _laws.gate_step(command, ages, ticks, limits.array, gate_state.array, out, new_array, rows, joints)
    return out, Block(gate_state.layout, new_array), faults_of(rows[: count * _laws.FAULT_FIELDS])


def faults_of(rows: FloatArray) -> list[Fault]:
    """Rows of findings (k, 5): code, joint, value, limit, action, as values."""
    return [
        Fault(FaultCode(int(code)), int(joint), value, limit, Action(int(action)))
        for code, joint, value, limit, action in rows.reshape(-1, _laws.FAULT_FIELDS).tolist()
    ]


def rows_of(faults: Sequence[Fault]) -> FloatArray:
    """Findings as rows (k, 5)."""
    table = [(fault.code, fault.joint, fault.value, fault.limit, fault.action) for fault in faults]
    return np.array(table, dtype=float).reshape(-1, _laws.FAULT_FIELDS)
