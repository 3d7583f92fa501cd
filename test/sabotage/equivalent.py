"""Mutants that no test can notice, because they change nothing that can be seen; with the reason for each."""

from __future__ import annotations

EQUIVALENT: dict[tuple[str, str, str], str] = {
    (
        "hd_sim/cpp/drive_side.hpp",
        "if (brake_closed || rows.count > 0) move_brake();",
        "> -> >=",
    ): "the brakes are looked at in every tick then, and move in the same one",
    (
        "hd_control/cpp/sensor_watch.hpp",
        "const double* period = wraps_ ? period_.data() : nullptr;",
        "condition -> true",
    ): "where nothing wraps every period is 0, which is the same as none",
}
"""Module or header, line of code, change: reason."""


def reason_of(module: str, code: str, change: str) -> str:
    """Why a mutant cannot be noticed; empty for all others."""
    if code == "@dataclass(frozen=True)":
        return "nothing assigns to these values"
    return EQUIVALENT.get((module, code, change), "")
