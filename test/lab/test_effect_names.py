"""The workbench knows effects by their classes only: no file of it names one, and none imports one."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import hd_control.lab
from hd_control.drive.effect import BASE_NUMBERS
from hd_control.drive.library import library
from hd_control.lab.diagnosis.fit import Fit

LAB = Path(hd_control.lab.__file__).parent
ALLOWED: dict[str, str] = {}
"""File below `hd_control/lab` -> why it may name effects. Empty: what decides about an effect is said by its class."""


def naming(source: str) -> Iterator[str]:
    """Line and text of every string that holds the name of an effect as a word, and of every import of an effect;
    docstrings and comments may name effects."""
    name = re.compile(rf"\b({'|'.join(library())})\b")
    tree = ast.parse(source)
    documents = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documents:
            if name.search(node.value):
                yield f"{node.lineno}: {node.value!r}"
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            yield from (f"{node.lineno}: imports {n}" for n in names if n.startswith("hd_control.drive.effects"))


def test_no_file_names_an_effect() -> None:
    files = {str(path.relative_to(LAB)): path for path in LAB.rglob("*.py")}
    assert len(files) > 20 and set(ALLOWED) <= set(files)
    found = [f"{n}:{text}" for n, path in files.items() if n not in ALLOWED for text in naming(path.read_text())]
    assert not found, "say it in the class of the effect (hd_control/drive/effect.py):\n" + "\n".join(found)


@pytest.mark.parametrize(
    "source",
    [
        'LAW_ERROR = {"kinematic_error": 0.007}',
        "def f(name):\n    return name == 'presliding'",
        'text = f"{x} is backlash"',
        "from hd_control.drive.effects.payload import NAMES",
        "import hd_control.drive.effects.backlash",
    ],
)
def test_the_check_finds(source: str) -> None:
    assert list(naming(source))


@pytest.mark.parametrize(
    "source", ['"""Backlash, such as `backlash`, in a docstring."""', 'x = "kinematic_errors"', "x = 1  # presliding"]
)
def test_the_check_allows(source: str) -> None:
    assert not list(naming(source))


def test_a_fit_has_every_number_of_the_base() -> None:
    """What a class of the drive calls a number is how a fit offers it."""
    assert all(isinstance(getattr(Fit, number, None), property) for number in BASE_NUMBERS)
