"""A module that only one neighbour in its folder imports is usually a part of it; one that stays apart has a reason.

A module that nobody imports is found by its name (a command, an executable, an effect, a paper) or is dead.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TOPS = ("hd_control", "hd_sim")
REASONS = {
    "hd_control.bench.robot": "a process of its own beside the run: the bare loop",
    "hd_sim.drive_side": "the drives' electronics are a subject of their own: watchdog, guard, brake",
    "hd_control.bench.recording": "runs as a process of its own beside the recorder that it measures",
    "hd_control.bench.peers": "the only file that may import MuJoCo, which is an extra",
    "hd_control.lab.diagnosis.decide": "the search on innovations, apart from what may be said of it",
    "hd_control.lab.innovations.noise": "how loud sensors and torque are, apart from the filter that is given it",
    "hd_control.pages.fault_page": "one long page of its own; pages lists all",
    "hd_control.pages.node_facts": "asks nodes, so it may import rclpy; the pages may not",
    "hd_control.pages.pages": "makes the pages; `__main__` only writes them",
    "hd_control.papers.gandhi_runs": "the simulated experiment, apart from the figures that are made of it",
    "hd_control.papers.hashimoto_sensor": "the sensor of the paper; its torque control is in hashimoto_runs",
    "hd_control.papers.zhu_arms": "one of three parts with the same face, `cases` and `rows`",
    "hd_control.papers.zhu_checks": "one of three parts with the same face, `cases` and `rows`",
    "hd_control.record.compact": "needs the reading side, which a recording that is being written does not load",
    "hd_control.record.db3_source": "one file for each storage format, mcap_read is the other",
    "hd_sim.puzzles.real_like": "how recordings are spoilt, apart from who asks and who scores",
    "hd_sim.puzzles.arm_recordings": "pairs of a whole arm; those of one joint are in recordings",
}
"""Module with exactly one importer, which stands in the same folder -> why it is not a part of it."""


def module_name(path: Path, root: Path) -> str:
    """`hd_control/core/blocks.py` -> `hd_control.core.blocks`."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def importers(root: Path) -> dict[str, set[str]]:
    """Every module of the two packages -> modules that import it, also inside functions."""
    trees = {module_name(p, root): ast.parse(p.read_text()) for top in TOPS for p in (root / top).rglob("*.py")}
    found: dict[str, set[str]] = {name: set() for name in trees}
    for importer, tree in trees.items():
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            for name in names:
                target = name if name in trees else name.rpartition(".")[0]
                if target in trees and target != importer:
                    found[target].add(importer)
    packages = {name.rpartition(".")[0] for name in trees} | {name for name in trees if (root / path_of(name)).is_dir()}
    return {name: users for name, users in found.items() if name not in packages}


def path_of(module: str) -> str:
    """The folder that a package would have."""
    return module.replace(".", "/")


def found_by_name(module: str) -> bool:
    """Commands, effects and papers are listed by folder, executables by pyproject.toml."""
    executables = re.findall(r'^\w+ = "([\w.]+):main"', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    from hd_control.papers.rows import PAPERS

    papers = {f"hd_control.papers.{name}" for name in PAPERS}
    folder = module.rpartition(".")[0]
    return (
        module in papers
        or module in executables
        or module.endswith(".__main__")
        or folder in ("hd_control.cli", "hd_control.drive.effects")
    )


def only_neighbours(users: Mapping[str, set[str]]) -> dict[str, str]:
    """Modules with exactly one importer that stands in the same folder -> that importer."""
    single = {name: next(iter(found)) for name, found in users.items() if len(found) == 1}
    return {name: user for name, user in single.items() if name.rpartition(".")[0] == user.rpartition(".")[0]}


@pytest.fixture(scope="module")
def users() -> dict[str, set[str]]:
    """Importers of every module that is not found by its name."""
    return {name: found for name, found in importers(ROOT).items() if not found_by_name(name)}


def test_each_module_of_one_neighbour_has_a_reason(users: dict[str, set[str]]) -> None:
    apart = only_neighbours(users)
    without = {name: user for name, user in apart.items() if name not in REASONS}
    assert not without, f"a part of its only importer, or apart for a reason: {without}"
    assert set(REASONS) <= set(apart), f"not of one neighbour any more: {set(REASONS) - set(apart)}"


def test_no_module_is_imported_by_tests_only(users: dict[str, set[str]]) -> None:
    dead = [name for name, found in users.items() if not found]
    assert not dead, f"nothing imports them: an oracle belongs to test/oracles, the rest is out: {dead}"


def test_the_search_finds_what_it_should(tmp_path: Path) -> None:
    for name, text in {
        "hd_control/a/__init__.py": "",
        "hd_control/a/one.py": "def f():\n    from hd_control.a import two\n",
        "hd_control/a/two.py": "import hd_sim.far\n",
        "hd_control/a/three.py": "from hd_control.a.four import x\nfrom hd_control.a.one import f\n",
        "hd_control/a/four.py": "from hd_control.a.one import f\n",
        "hd_sim/far.py": "",
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = importers(tmp_path)
    assert found["hd_control.a.one"] == {"hd_control.a.three", "hd_control.a.four"} and not found["hd_control.a.three"]
    assert only_neighbours(found) == {
        "hd_control.a.two": "hd_control.a.one",
        "hd_control.a.four": "hd_control.a.three",
    }
