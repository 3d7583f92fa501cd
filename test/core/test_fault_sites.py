"""Every fault code has a place in the sources that raises it, and no source writes a code by hand."""

import ast
import re
from pathlib import Path

import pytest

from hd_control.core.faults import FaultCode

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = (ROOT / "hd_control" / "core" / "faults.py", ROOT / "hd_control" / "pages")
"""The list itself, and the manual, whose examples raise nothing."""


def sources(ending):
    """Files of both packages that may raise a fault."""
    found = (path for package in ("hd_control", "hd_sim") for path in sorted((ROOT / package).rglob(f"*{ending}")))
    return [path for path in found if not any(path.is_relative_to(part) for part in LEFT_OUT)]


def sites(source):
    """Names of the codes that a Python source uses as values: for a `Fault`, a line, an error. A comparison is none."""
    tree = ast.parse(source)
    compared = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Compare) for part in ast.walk(node)}
    return {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "FaultCode"
        and id(node) not in compared
    }


def compiled_sites(source):
    """The same of C++, by name with the number there: `kNodeKilled = 18`, used anywhere but in a comparison."""
    numbers = {name: int(number) for name, number in re.findall(r"\b(k[A-Z]\w+) = (\d+)", source)}
    used = re.findall(r"(?<![=!<>] )(?<!case )\b(k[A-Z]\w+)\b(?! *(?:=|[!<>]=))", source)
    return {_constant(name): numbers[name] for name in used if name in numbers}


def _constant(name):
    """`kNodeKilled` as NODE_KILLED."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name[1:]).upper()


def literals(source):
    """Codes that stand in texts of a Python source, docstrings left out: these must come from `FaultCode`."""
    tree = ast.parse(source)
    documents = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    texts = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    return [node.value for node in texts if id(node) not in documents and re.search(r"HD-F\d", node.value)]


def raised_in(python, headers=""):
    """Names of the codes that some sources raise."""
    return {name for text in python for name in sites(text)} | set(compiled_sites(headers))


@pytest.fixture(scope="module")
def python():
    return [path.read_text("utf-8") for path in sources(".py")]


@pytest.fixture(scope="module")
def headers():
    return "\n".join(path.read_text("utf-8") for path in sources(".hpp"))


def test_every_code_has_a_place_that_raises_it(python, headers):
    nowhere = {code.name for code in FaultCode} - raised_in(python, headers)
    assert not nowhere, f"raise {', '.join(sorted(nowhere))} or remove them from FaultCode"


def test_a_code_without_a_place_is_noticed(python, headers):
    """The places of one code taken away: it is the only one that is missing, whatever else names it."""
    for code in (FaultCode.TWO_PUBLISHERS, FaultCode.YAML_BAD):
        without = [re.sub(rf"\bFaultCode\.{code.name}\b", f"FaultCode('{code.name}')", text) for text in python]
        assert {each.name for each in FaultCode} - raised_in(without, headers) == {code.name}
    assert "BUS_OFF" not in raised_in(python, headers)


def test_a_comparison_or_a_mention_is_no_place():
    assert sites('"""FaultCode.SPIKE"""\n# FaultCode.SPIKE\nif code is FaultCode.SPIKE:\n    pass\n') == set()
    assert sites("found = FaultCode.SPIKE if bad else FaultCode.NOT_FINITE\n") == {"SPIKE", "NOT_FINITE"}
    assert sites("raise ConfigError(FaultCode.YAML_BAD.line(why, where))\n") == {"YAML_BAD"}
    enumeration = "enum FaultCode { kSpike = 5, kLetGo = 41 };\n"
    assert compiled_sites(enumeration + "if (code == kSpike) faults.add(kLetGo, j);") == {"LET_GO": 41}
    assert compiled_sites(enumeration + "switch (code) { case kSpike: return kLetGo == code; }") == {}


def test_compiled_numbers_are_those_of_the_table(headers):
    both = {name: number for name, number in compiled_sites(headers).items() if name in FaultCode.__members__}
    assert len(both) >= 6 and both == {name: FaultCode[name].value for name in both}


def test_no_source_writes_a_code_by_hand():
    found = {str(path.relative_to(ROOT)): literals(path.read_text("utf-8")) for path in sources(".py")}
    assert {path: texts for path, texts in found.items() if texts} == {}
    assert literals('"""HD-F22."""\nraise E(f"HD-F22 goal_bad {name}")\n') == ["HD-F22 goal_bad "]
