"""Mutants that no test can notice, because they change nothing that can be seen; with the reason for each."""

from __future__ import annotations

EQUIVALENT: dict[tuple[str, str, str], str] = {
    (
        "hd_control.control.safety_gate",
        "return out, Block(gate_state.layout, new_array), faults_from_rows(rows, count) if count else []",
        "condition -> True",
    ): "no rows make an empty list as well",
    (
        "hd_control.control.safety_gate",
        "u = limit if u > 0.0 else -limit",
        "Gt -> GtE",
    ): "u is beyond a limit above 0, so it is not 0",
    (
        "hd_control.control.safety_gate",
        "return high if u > high else low",
        "Gt -> GtE",
    ): "u is not between low and high, so it is not high",
    (
        "hd_control.control.adaptation_monitor",
        "return (level - FORGIVEN if level > FORGIVEN else 0.0), []",
        "Gt -> GtE",
    ): "at equality both are 0",
    (
        "hd_control.control.slow_motion",
        "self.slope = 0.0",
        "0.0 -> 1.0",
    ): "set anew by each step, before it is used",
}
"""Module, line of code, change: reason."""


def reason_of(module: str, code: str, change: str) -> str:
    """Why a mutant cannot be noticed; empty for all others."""
    if code == "@dataclass(frozen=True)":
        return "nothing assigns to these values"
    return EQUIVALENT.get((module, code, change), "")
