"""Mutants that no test can notice, because they change nothing that can be seen; with the reason for each."""

from __future__ import annotations

NAMES = ("gate", "guard", "loop_monitors", "sensor_monitors")
GATE, GUARD, LOOP, SENSORS = (f"hd_control.safety.{name}" for name in NAMES)
SHORT_CUT = "a short cut: the lines behind it come to the same"
EQUIVALENT: dict[tuple[str, str, str], str] = {
    (
        GATE,
        "return out, Block(gate_state.layout, new_array), faults_from_rows(rows, count) if count else []",
        "condition -> True",
    ): "no rows make an empty list as well",
    (
        GUARD,
        "bound, action = np.where(velocity > 0.0, high, low), Action.CONTROLLED_STOP",
        "Gt -> GtE",
    ): "used only for joints that move outward, faster than 0.05 rad/s",
    (
        GUARD,
        "if self._emitting and not demands and self._quiet(command, ages, ticks):",
        "condition -> False",
    ): "the long way comes to the same bit for bit: test_guard_ordinary.py",
    (GUARD, "if not faults:", "condition -> False"): "the long way comes to the same bit for bit",
    (GUARD, "if found:", "condition -> True"): "looking once more at a state that has not changed",
    (
        GUARD,
        "stops = [fault for fault in faults if fault.action >= Action.CONTROLLED_STOP]",
        "GtE -> Gt",
    ): "the gate demands ramps or nothing, never a controlled stop",
    (LOOP, "level = level - FORGIVEN if level > FORGIVEN else 0.0", "Gt -> GtE"): "at equality both are 0",
    (LOOP, "if _laws.all_below(torque, rail):", "condition -> False"): SHORT_CUT,
    (LOOP, "if not long.any():", "condition -> False"): SHORT_CUT,
    (SENSORS, "if follow:", "condition -> False"): SHORT_CUT,
    (SENSORS, "if ordinary:", "condition -> False"): SHORT_CUT,
    (SENSORS, "if not ordinary:", "condition -> True"): SHORT_CUT,
    (SENSORS, "if _laws.all_below(gauge, limits.gauge_free):", "condition -> False"): SHORT_CUT,
    (SENSORS, "if _laws.all_near(motor, joint, limits.twist_limit):", "condition -> False"): SHORT_CUT,
    (SENSORS, "way = np.where(whole, travel, 1.0)", "1.0 -> 2.0"): "used only where the turn is whole",
    ("hd_control.laws.trajectory", "self.slope = 0.0", "0.0 -> 1.0"): "set anew by each step, before it is used",
}
"""Module, line of code, change: reason."""


def reason_of(module: str, code: str, change: str) -> str:
    """Why a mutant cannot be noticed; empty for all others."""
    if code == "@dataclass(frozen=True)":
        return "nothing assigns to these values"
    return EQUIVALENT.get((module, code, change), "")
