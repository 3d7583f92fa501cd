"""Style, types and size, with the tools that pyproject.toml configures. Each check names the place that breaks it."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# What touches rclpy (nodes, session, bench, pages) is left out: rclpy carries no types.
PURE = ["core", "drive", "laws", "safety", "chain", "record", "lab", "papers", "demo", "cli"]
MAX_LINES, MAX_FUNCTION_LINES = 600, 40
SKIP = {".git", ".venv", "build", "install", "log", "bags", "__pycache__"}


def files(*patterns: str) -> list[Path]:
    """Files of the source tree, without what tools made."""
    found = (path for pattern in patterns for path in ROOT.rglob(pattern))
    return sorted(p for p in found if not any(q in SKIP or q.startswith(".venv") for q in p.relative_to(ROOT).parts))


def packaged(*patterns: str) -> list[Path]:
    """Files of the two packages."""
    return [path for path in files(*patterns) if path.relative_to(ROOT).parts[0] in ("hd_control", "hd_sim")]


def passes(*command: str) -> None:
    """Runs a tool on the tree and fails with its words."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command[:6])}\n{done.stdout[-6000:]}{done.stderr[-2000:]}"


def test_ruff_finds_nothing() -> None:
    passes(sys.executable, "-m", "ruff", "check", "--output-format", "concise", ".")


def test_types_are_strict() -> None:
    folders = [f"hd_control/{name}" for name in PURE if [*(ROOT / "hd_control" / name).rglob("*.py")]]
    modules = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "hd_sim").glob("*.py"))]
    modules += ["hd_sim/puzzles", "hd_sim/second_world"]
    passes(sys.executable, "-m", "mypy", *folders, *modules)


def test_shell_is_posix() -> None:
    shell = shutil.which("dash") or "/bin/sh"
    for script in ("hd", ".ci/run"):
        passes(shell, "-n", script)


def test_files_stay_small() -> None:
    long = [f"{path.relative_to(ROOT)}: {n}" for path in packaged("*.py", "*.[hc]pp") if (n := lines(path)) > MAX_LINES]
    assert not long, f"more than {MAX_LINES} lines: {long}"


def lines(path: Path) -> int:
    """Lines of a file."""
    return path.read_bytes().count(b"\n")


def test_functions_stay_small() -> None:
    found = []
    for path in packaged("*.py"):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
                size = (node.end_lineno or 0) - body[0].lineno + 1
                if size > MAX_FUNCTION_LINES:
                    found.append(f"{path.relative_to(ROOT)}:{node.lineno} {node.name}: {size}")
    assert not found, f"bodies of more than {MAX_FUNCTION_LINES} lines: {found}"


@pytest.mark.parametrize(
    ("what", "pattern"),
    [
        ("a package registry's address", r"--(extra-)?index-url\s*[=h]|https?://[^\s\"')]*/simple\b|--find-links\s+\S"),
        ("a silenced type check without a reason", r"#\s*type:\s*ignore\s*$"),
        ("a silenced lint without a rule", r"#\s*noqa\s*$"),
    ],
)
def test_text_has_no(what: str, pattern: str) -> None:
    texts = files("*.py", "*.md", "*.toml", "*.lock", "*.xml", "*.yaml", "hd", "run", "*.hpp", "*.cpp")
    search = re.compile(pattern, re.MULTILINE).search
    found = [str(path.relative_to(ROOT)) for path in texts if path != Path(__file__) and search(path.read_text())]
    assert not found, f"{what}: {found}"
