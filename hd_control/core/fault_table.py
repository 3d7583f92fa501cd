"""What is known of every fault besides its numbers: how it is found, what happens, where it is tested.

The entries are in config/fault_pages.yaml; docs/faults.md is made of them.

State: `built` works in this version, `elsewhere` names the part that answers for it, `open` is not built yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from hd_control.core.faults import KINDS, FaultCode
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_yaml


@dataclass(frozen=True)
class FaultPage:
    """One entry of the manual. `samples`: from the onset until the action starts, at most."""

    meaning: str
    found_by: str
    samples: str
    action: str
    state: str
    test: str


@lru_cache
def pages() -> dict[FaultCode, FaultPage]:
    """The entry of every fault. Raises ConfigError for a malformed file, KeyError for a fault without an entry."""
    found = load_yaml(config_path("fault_pages.yaml"))
    return {code: FaultPage(**found[code.name.lower()]) for code in FaultCode}


def manual() -> str:
    """docs/faults.md: one section per fault, from this table and the texts of `faults.py`."""
    lines = [
        "# Faults",
        "",
        "Made from `config/fault_pages.yaml` by `python -m hd_control.core.fault_table > docs/faults.md`. Every",
        "fault has a code, an action, a text with value, limit and remedy, and a test. What is not built yet says so.",
        "Actions and goals: docs/safety.md. This is not a certified safety function.",
    ]
    for code, page in pages().items():
        kind = KINDS[code]
        unit = f", {kind.unit}" if kind.unit else ""
        lines += ["", f"## {code.text}", "", f"{page.meaning[0].upper()}{page.meaning[1:]}.", ""]
        lines += [f"- found by: {page.found_by}", f"- compared: {kind.quantity} {kind.relation} limit{unit}"]
        lines += [f"- samples until the action: {page.samples}", f"- action: {page.action}"]
        lines += [f"- what to do: {kind.remedy}", f"- state: {page.state}", f"- test: {page.test}"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(manual(), end="")
