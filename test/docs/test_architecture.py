"""docs/architecture.md says what the code is: its import table, the names of its walks, the modules that it names."""

from __future__ import annotations

import ast
import re

import pytest
from command_blocks import ROOT
from test_imports import ALLOWED

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
WALK = re.compile(r"^\| .+ \| `([\w/.]+)` \| `(\w+)` \|$", re.MULTILINE)
ROW = re.compile(r"^\| `([a-z_.]+)` \| ((?:`[\w.]+`(?:, )?)+|–) \|$", re.MULTILINE)


def defined(file: str) -> set[str]:
    """Names that a file defines: functions, classes, methods, variables; of C++ every word outside comments."""
    text = (ROOT / file).read_text(encoding="utf-8")
    if not file.endswith(".py"):
        return set(re.findall(r"\w+", re.sub(r"//.*|/\*.*?\*/", "", text)))
    nodes = [*ast.walk(ast.parse(text))]
    variables = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return variables | {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def wrong_rows(page: str) -> list[str]:
    """Rows of the walks whose file is not there or does not have the name."""
    found = []
    for file, name in WALK.findall(page):
        if not (ROOT / file).is_file():
            found.append(f"{file}: no such file")
        elif name not in defined(file):
            found.append(f"{file}: has no {name}")
    return found


def full(name: str) -> str:
    """`lab.page` -> `hd_control.lab.page`; names of the world stay."""
    return name if name.startswith("hd_sim") else f"hd_control.{name}"


def test_the_walks_through_the_code_name_what_is_there() -> None:
    encoder, column = PAGE.split("### An encoder count becomes a torque")[1].split("### A column of a bag")
    assert len(WALK.findall(encoder)) >= 15 and len(WALK.findall(column)) >= 12
    assert not wrong_rows(PAGE)


@pytest.mark.parametrize(
    "row",
    [
        "| a step | `hd_control/laws/nowhere.py` | `step` |",
        "| a step | `hd_control/laws/fusion.py` | `no_such_name` |",
        "| a step | `hd_sim/cpp/sensors.hpp` | `no_such_name` |",
    ],
)
def test_a_wrong_row_is_seen(row: str) -> None:
    assert len(wrong_rows(row)) == 1


def test_the_import_table_is_that_of_the_import_test() -> None:
    table = PAGE.split("## Imports run one way")[1].split("\n## ")[0]
    rows = {full(part): {full(n) for n in re.findall(r"`([\w.]+)`", allowed)} for part, allowed in ROW.findall(table)}
    assert len(rows) >= 17
    wrong = {part: (rows[part], ALLOWED.get(part)) for part in rows if rows[part] != ALLOWED.get(part)}
    assert not wrong, wrong


def test_every_part_of_the_import_test_is_named() -> None:
    """Packages only: single modules of the world stand in the test alone."""
    packages = [name for name in ALLOWED if (ROOT / name.replace(".", "/")).is_dir()]
    missing = [name for name in packages if f"`{name.removeprefix('hd_control.')}`" not in PAGE]
    assert not missing, missing
