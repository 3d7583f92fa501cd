"""Mutants that no test can notice, because they change nothing that can be seen; with the reason for each."""

from __future__ import annotations

EQUIVALENT: dict[tuple[str, str, str], str] = {}
"""Module, line of code, change: reason."""


def reason_of(module: str, code: str, change: str) -> str:
    """Why a mutant cannot be noticed; empty for all others."""
    if code == "@dataclass(frozen=True)":
        return "nothing assigns to these values"
    return EQUIVALENT.get((module, code, change), "")
