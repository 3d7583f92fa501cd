"""Every command of the documents runs, or is at least a command that exists with options that it has."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

import pytest
from command_blocks import KINDS, ROOT, blocks, commands, inline_commands, pages
from command_words import problems
from page_runs import run_page

PAGES = pages()
WITH_RUNS = [page for page in PAGES if any(command.kind == "" for command in commands(page))]


def name_of(page: Path) -> str:
    """The id of a page."""
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", WITH_RUNS, ids=name_of)
def test_the_commands_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").mkdir()
    assert run_page(page, {""}) > 0


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_commands_of_a_page_exist(page: Path) -> None:
    found = [f"{command}: {text}" for command in commands(page) for text in problems(command.text)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_commands_in_the_text_exist(page: Path) -> None:
    found = [
        f"{name_of(page)}:{line}: {text}: {what}"
        for line, text in inline_commands(page)
        for what in problems(text, complete=False)
    ]
    assert not found, "\n".join(found)


def test_most_pages_of_the_workbench_run() -> None:
    """A page whose blocks are all marked would pass by saying nothing."""
    found = {name_of(page) for page in WITH_RUNS}
    assert found >= {"README.md", "docs/bags.md", "docs/signals.md", "docs/tutorials/first_bag.md"}
    assert {command.kind for page in PAGES for command in commands(page)} == set(KINDS)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("hd nonsense BAG", "no command"),
        ("hd info", "BAG"),
        ("hd info bag --nonsense", "unknown"),
        ("ros2 param set /torque_node nonsense 1.0", "no parameter"),
        ("ros2 topic hz /nonsense", "no topic"),
        ("ros2 run hd_control nonsense", "no executable"),
        ("ros2 launch hd_control robot.launch.py nonsense:=1", "no argument"),
        ("ros2 lifecycle set /torque_node nonsense", "no transition"),
        ("ros2 service call /torque_node/nonsense std_srvs/srv/Trigger", "no service"),
        (".venv/bin/pip install -r requirements/nonsense.lock", "no requirements"),
    ],
)
def test_the_check_finds(text: str, what: str) -> None:
    assert any(what in problem for problem in problems(text)), problems(text)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_command_hides_in_another_block(page: Path) -> None:
    found = [
        f"{name_of(page)}:{number}: {line}"
        for number, language, _, lines in blocks(page)
        for line in lines
        if language != "sh" and re.match(r"(\./hd|hd|ros2|pip|colcon|apt-get) [a-z]", line)
    ]
    assert not found, "say ```sh at the head of the block"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_python_of_a_page_imports_what_exists(page: Path) -> None:
    for number, language, _, lines in blocks(page):
        if language != "python":
            continue
        for node in ast.walk(ast.parse("\n".join(lines))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ("hd_control", "hd_sim"):
                module = importlib.import_module(node.module or "")
                missing = [name.name for name in node.names if not hasattr(module, name.name)]
                assert not missing, f"{name_of(page)}:{number}: {node.module} has no {missing}"
