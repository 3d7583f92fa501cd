"""Small changes of the safety code in Python, one at a time: does any of its tests notice? And who tries them.

A mutant is made in the syntax tree, compiled into a fresh copy of the module, and put in the place of the real one in a
process of its own, which runs the module's tests until the first failure. Nothing is written to the source tree. The
compiled rules have mutants of their own, see `cpp_mutants`.
"""

from __future__ import annotations

import ast
import copy
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GATE, GUARD = "test/safety/test_safety_gate.py", "test/safety/test_guard.py"
MODULES = {
    "hd_control.safety.limits": (GATE, GUARD),
    "hd_control.safety.gate": (GATE, GUARD),
    "hd_control.safety.guard": (GUARD, GATE, "test/safety/test_guard_oracle.py"),
}
"""Module -> files of its tests, in the order in which they are tried."""
NOTICED = (1, 2, -signal.SIGPROF)
"""Exit codes of pytest: a test failed, a test file could not be read any more; or the run never came to its end."""
WALL_SECONDS = 3600.0
"""A run that takes longer without using its processor time has no result; on a busy computer a slow one is no find."""
COMPARE = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitAnd: ast.BitOr,
              ast.BitOr: ast.BitAnd}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change: the module, its line, what was done, and the changed source."""

    module: str
    line: int
    change: str
    source: str


def path_of(module: str) -> Path:
    """File of a module of this project."""
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


def _annotations(tree: ast.AST) -> set[int]:
    """Nodes of type annotations: changing them changes nothing."""
    found: set[int] = set()
    for node in ast.walk(tree):
        parts = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        found |= {id(inner) for part in parts if part is not None for inner in ast.walk(part)}
    return found


def _changes(node: ast.AST):  # type: ignore[no-untyped-def]
    """Changed copies of one node, with words for each."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARE:
        new = copy.deepcopy(node)
        new.ops[0] = COMPARE[type(node.ops[0])]()
        yield f"{type(node.ops[0]).__name__} -> {type(new.ops[0]).__name__}", new
    if isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        new = copy.deepcopy(node)
        new.op = ARITHMETIC[type(node.op)]()
        yield f"{type(node.op).__name__} -> {type(new.op).__name__}", new
    if isinstance(node, ast.BoolOp):
        new = copy.deepcopy(node)
        new.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "and <-> or", new
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not, ast.Invert)):
        yield f"{type(node.op).__name__} removed", copy.deepcopy(node.operand)
    if isinstance(node, ast.Constant) and isinstance(node.value, float | int) and not isinstance(node.value, bool):
        yield f"{node.value} -> {node.value + 1}", ast.Constant(node.value + 1)
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} -> {not node.value}", ast.Constant(not node.value)
    if isinstance(node, (ast.If, ast.IfExp)):
        for value in (True, False):
            new = copy.deepcopy(node)
            new.test = ast.Constant(value)
            yield f"condition -> {value}", new


def mutants(module: str) -> list[Mutant]:
    """Every mutant of a module, in the order of its lines."""
    tree = ast.parse(path_of(module).read_text())
    skipped, found = _annotations(tree), []
    for parent in ast.walk(tree):
        for field, value in ast.iter_fields(parent):
            for place, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if not isinstance(node, ast.AST) or id(node) in skipped:
                    continue
                for words, new in _changes(node):
                    _put(parent, field, place, new)
                    found.append(
                        Mutant(module, getattr(node, "lineno", 0), words, ast.unparse(ast.fix_missing_locations(tree)))
                    )
                    _put(parent, field, place, node)
    return sorted(found, key=lambda mutant: (mutant.line, mutant.change))


def _put(parent: ast.AST, field: str, place: int | None, node: ast.AST) -> None:
    if place is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[place] = node


FINDER = """
import importlib.abc, importlib.util, json, os, signal, sys
class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self, module, source, path):
        self.module, self.source, self.path = module, source, path
    def find_spec(self, name, path, target=None):
        if name != self.module:
            return None
        spec = importlib.util.spec_from_loader(name, self, origin=self.path)
        spec.has_location = True
        return spec
    def create_module(self, spec):
        return None
    def exec_module(self, made):
        made.__file__ = self.path
        getattr(__import__("builtins"), "exec")(compile(self.source, self.path, "exec"), made.__dict__)
OPTIONS = ["-q", "-x", "--no-header", "-p", "no:cacheprovider", "--tb=no"]
"""
RUNNER = (
    FINDER
    + """
module, source, path, seconds, tests = json.loads(sys.stdin.read())
if module:
    sys.meta_path.insert(0, Finder(module, source, path))
import pytest
signal.setitimer(signal.ITIMER_PROF, seconds)
sys.exit(pytest.main([*OPTIONS, *tests]))
"""
)
SERVER = (
    FINDER
    + """
import hypothesis, numpy, pinocchio, pytest
class SlowLast:
    def pytest_collection_modifyitems(self, items):
        items.sort(key=lambda item: hasattr(item.obj, "hypothesis"))
for line in sys.stdin:
    module, source, path, seconds, tests, environment = json.loads(line)
    child = os.fork()
    if child == 0:
        quiet = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(quiet, number)
        signal.setitimer(signal.ITIMER_PROF, seconds)
        os.environ.update(environment)
        if module:
            sys.meta_path.insert(0, Finder(module, source, path))
        os._exit(int(pytest.main([*OPTIONS, *tests], plugins=[SlowLast()])))
    print(json.dumps(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])), flush=True)
"""
)


def notices(module: str, source: str, tests: list[str], seconds: float = 300.0) -> bool:
    """Do the tests fail with this source in the place of the module, or use more than so much processor time?"""
    return _fails([module, source, str(path_of(module)), seconds, tests], {})


def notices_libraries(folder: Path, tests: list[str], seconds: float = 600.0, **environment: str) -> bool:
    """Do the tests fail with the compiled modules of this folder in the place of those of the tree?"""
    return _fails(["", "", "", seconds, tests], {"HD_EXTENSIONS": str(folder), **environment})


def _surroundings(changes: Mapping[str, str]) -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), **changes}


def _fails(job: list[object], environment: Mapping[str, str]) -> bool:
    done = subprocess.run(
        [sys.executable, "-c", RUNNER], input=json.dumps(job), text=True, cwd=ROOT, env=_surroundings(environment),
        capture_output=True, timeout=WALL_SECONDS,
    )  # fmt: skip
    return done.returncode in NOTICED


class MutantServer:
    """Tries mutants one after the other, each in a fork of a process that has the libraries loaded already.

    `environment`: of every one of them.
    """

    def __init__(self, **environment: str) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER], stdin=pipe, stdout=pipe, text=True, cwd=ROOT, env=_surroundings(environment)
        )

    def notices(self, module: str, source: str, tests: list[str], seconds: float = 300.0) -> bool:
        """Do the tests fail with this source in the place of the module? One that never ends counts as noticed."""
        return self._ask([module, source, str(path_of(module)), seconds, tests, {}])

    def notices_switched(self, number: int, tests: list[str], seconds: float = 300.0) -> bool:
        """Do the tests fail with this mutant of the compiled rules switched on? The server's modules have them all."""
        return self._ask(["", "", "", seconds, tests, {"HD_MUTANT": str(number)}])

    def _ask(self, job: list[object]) -> bool:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(job) + "\n")
        self._process.stdin.flush()
        # A change of compiled code may end in a signal: that is noticed as well.
        code = json.loads(self._process.stdout.readline())
        return code in NOTICED or code < 0

    def close(self) -> None:
        """Ends the process."""
        self._process.communicate()


BRANCHED = (ast.If, ast.IfExp, ast.While)


def with_probes(module: str, report: str) -> tuple[str, int]:
    """The module's source with every condition reporting to a file how it ended; and how many conditions there are."""
    tree = ast.parse(path_of(module).read_text())
    count = 0
    for node in ast.walk(tree):
        if isinstance(node, BRANCHED):
            node.test = ast.Call(ast.Name("_probe", ast.Load()), [ast.Constant(count), node.test], [])
            count += 1
    text = ast.unparse(ast.fix_missing_locations(tree))
    head = (
        "_seen = set()\ndef _probe(number, value):\n    key = (number, bool(value))\n    if key not in _seen:\n"
        f"        _seen.add(key)\n        with open({report!r}, 'a') as file:\n"
        "            file.write(f'{number} {bool(value)}\\n')\n"
        "    return value\n"
    )
    future = "from __future__ import annotations"
    return text.replace(future, future + "\n" + head, 1), count
