"""Campaigns share the cases of the quick lane; they run only when asked for, with `hd test --long`."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
QUICK = ("chain", "core", "docs", "hd_sim", "inputs", "lab", "laws", "nodes", "record", "sabotage", "safety")
for folder in (*(HERE.parent / name for name in QUICK), HERE.parent, HERE):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


def pytest_ignore_collect(collection_path, config):
    """The whole suite leaves the campaigns out; naming a file runs it."""
    named = [str(argument).partition("::")[0] for argument in config.args]
    wanted = any(Path(argument).resolve() in (collection_path, HERE) for argument in named)
    return collection_path.name.startswith("test_") and not wanted or None
