"""Campaigns write what they reached themselves; `hd test --goals` prints it."""

import json
import resource
from pathlib import Path

FOLDER = Path(__file__).parent / "results"


def cpu_seconds() -> float:
    """What this process and its children that have ended have used so far."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def write_result(goal: str, reached: str, passed: bool, **numbers: object) -> None:
    """Stores the figures of one goal, with the processor time that the run has cost."""
    document = {"goal": goal, "reached": reached, "passed": passed, "cpu_seconds": round(cpu_seconds()), **numbers}
    (FOLDER / f"{goal}.json").write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
