"""Campaigns write what they reached themselves; `hd test --goals` prints it."""

import hashlib
import json
import resource
from pathlib import Path

FOLDER = Path(__file__).parent / "results"
ROOT = Path(__file__).resolve().parents[2]
JUDGED = ("config/*", "hd_control/chain/*", "hd_control/core/*", "hd_control/cpp/*", "hd_control/laws/*",
          "hd_control/safety/*", "hd_sim/*", "hd_sim/cpp/*")  # fmt: skip
"""Files whose change makes earlier simulated hours worthless."""


def code_mark() -> str:
    """A short hash of the files that are judged."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in JUDGED for path in ROOT.glob(pattern)):
        if path.suffix in (".py", ".cpp", ".hpp", ".yaml"):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def earlier(goal: str, name: str, seed: int) -> float:
    """A number of the goal's result if that is of the same code and first seed and without a failure; else 0."""
    path = FOLDER / f"{goal}.json"
    found = json.loads(path.read_text()) if path.exists() else {}
    same = (found.get("code"), found.get("seed"), found.get("failures")) == (code_mark(), seed, 0)
    return float(found.get(name, 0.0)) if same else 0.0


def cpu_seconds() -> float:
    """What this process and its children that have ended have used so far."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def write_result(goal: str, reached: str, passed: bool, **numbers: object) -> None:
    """Stores the figures of one goal, with the processor time that the run has cost."""
    document = {"goal": goal, "reached": reached, "passed": passed, "cpu_seconds": round(cpu_seconds()), **numbers}
    (FOLDER / f"{goal}.json").write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
