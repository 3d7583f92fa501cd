"""Campaigns write what they reached themselves; `hd test --goals` prints it."""

import json
from pathlib import Path

FOLDER = Path(__file__).parent / "results"


def write_result(goal: str, reached: str, passed: bool, **numbers: object) -> None:
    """Stores the figures of one goal."""
    document = {"goal": goal, "reached": reached, "passed": passed, **numbers}
    (FOLDER / f"{goal}.json").write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
