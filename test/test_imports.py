"""The imports run one way (docs/architecture.md), and what may never be called is never called."""

from __future__ import annotations

import ast
import graphlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Folder or module -> what it may import of this project, besides itself. The longest matching name counts.
ALLOWED: dict[str, set[str]] = {
    "hd_control.core": set(),
    "hd_control.drive": {"hd_control.core"},
    # The laws and what may stop the robot.
    "hd_control.laws": {"hd_control.core", "hd_control.drive"},
    "hd_control.safety": {"hd_control.core", "hd_control.laws"},
    "hd_control.record": {"hd_control.core"},
    "hd_control.chain": {"hd_control.core", "hd_control.laws", "hd_control.safety", "hd_control.record"},
    "hd_control.nodes": {
        "hd_control.core", "hd_control.laws", "hd_control.safety", "hd_control.chain", "hd_control.record",
    },
    # The workbench's arithmetic: each floor stands on those above it in this list.
    "hd_control.lab.signals": {"hd_control.core", "hd_control.record"},
    "hd_control.lab.balances": {"hd_control.core", "hd_control.drive", "hd_control.lab.signals"},
    "hd_control.lab.innovations": {
        "hd_control.core", "hd_control.drive", "hd_control.lab.signals", "hd_control.lab.balances",
        "hd_control._innovations",
    },
    "hd_control.lab.diagnosis": {
        "hd_control.core", "hd_control.drive", "hd_control.lab.signals", "hd_control.lab.balances",
        "hd_control.lab.innovations",
    },
    "hd_control.lab.maps": {"hd_control.core", "hd_control.drive", "hd_control.lab.signals", "hd_control.lab.balances"},
    "hd_control.lab.models": {
        "hd_control.core", "hd_control.drive", "hd_control.record", "hd_control.lab.signals", "hd_control.lab.balances",
        "hd_control.lab.diagnosis", "hd_control.lab.maps",
    },
    "hd_control.lab.page": {
        "hd_control.core", "hd_control.drive", "hd_control.lab.signals", "hd_control.lab.balances",
        "hd_control.lab.diagnosis", "hd_control.lab.maps", "hd_control.lab.models",
    },
    "hd_control.lab": set(),
    # What stands on all of it.
    "hd_control.session": {
        "hd_control.core", "hd_control.laws", "hd_control.chain", "hd_control.record", "hd_control.nodes",
    },
    "hd_control.papers": {
        "hd_control.core", "hd_control.drive", "hd_control.laws", "hd_control.chain", "hd_control.lab.page", "hd_sim",
    },
    # The demo runs nodes of a simulated robot and reads what they recorded; it starts commands, it imports none.
    "hd_control.demo": {
        "hd_control.core", "hd_control.record", "hd_control.lab", "hd_control.nodes", "hd_control.session", "hd_sim",
    },
    "hd_control.bench": {"hd_control", "hd_sim"},
    "hd_control.pages": {"hd_control"},
    "hd_control.cli": {"hd_control", "hd_sim"},
    # The world. Its physics knows the ground floor only.
    "hd_sim": {"hd_control.core"},
    # Written apart from the first one: neither knows the other.
    "hd_sim.second_world": {"hd_control.core"},
    # A scenario says where the arm shall go, in the words of the goals; a recording of a run stores these goals.
    "hd_sim.scenario": {"hd_control.core", "hd_control.laws.trajectory", "hd_sim"},
    "hd_sim.recording": {
        "hd_control.core", "hd_control.laws.trajectory", "hd_control.chain", "hd_control.record", "hd_sim",
    },
    "hd_sim.world": {"hd_control.core", "hd_control.safety", "hd_control.chain", "hd_sim"},
    # The drive side stands for the drive's electronics, whose own gate is the last one before the motor.
    "hd_sim.drive_side": {"hd_control.core", "hd_control.safety", "hd_control.chain.black_box", "hd_sim"},
    "hd_sim.runner": {
        "hd_control._chain", "hd_control.core", "hd_control.laws", "hd_control.safety", "hd_control.chain", "hd_sim",
    },
    "hd_sim.nodes": {
        "hd_control.core", "hd_control.safety", "hd_control.chain", "hd_control.record", "hd_control.nodes",
        "hd_control._plane", "hd_sim",
    },
    # Recordings that hide an effect, and campaigns that ask the workbench and score its answers.
    "hd_sim.puzzles": {"hd_control.core", "hd_control.drive", "hd_control.record", "hd_control.lab", "hd_sim"},
}  # fmt: skip
PHYSICS = ("plant", "plant_config", "sensors", "hidden_effects")
"""Modules of the world that know the ground floor and nothing else of the package under test."""
ONLY_FOR = {"hd_sim.puzzles": ("hd_control.cli", "hd_control.demo")}
"""Package -> who may import it, besides itself."""
ROS = {
    "rclpy",
    "rcl_interfaces",
    "builtin_interfaces",
    "rosgraph_msgs",
    "lifecycle_msgs",
    "diagnostic_msgs",
    "ament_index_python",
}
ROS_ALLOWED = (
    "hd_control.nodes",
    "hd_control.session",
    "hd_control.bench.recording",
    "hd_control.bench.ring",
    "hd_control.pages.node_facts",
    "hd_sim.nodes",
)
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "shelve", "marshal"}
FORBIDDEN_CALLS = {
    "eval",
    "exec",
    "os.system",
    "os.popen",
    "yaml.load",
    "tempfile.mktemp",
    "pickle.load",
    "pickle.loads",
}


def module_name(path: Path) -> str:
    """`hd_control/core/blocks.py` -> `hd_control.core.blocks`."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def inside(name: str, package: str) -> bool:
    """Is the module the package or below it?"""
    return name == package or name.startswith(package + ".")


def imports(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and full name of everything that is imported, also inside functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.lineno, f"{'.' * node.level}{node.module or ''}.{alias.name}") for alias in node.names)


def dotted(node: ast.expr) -> str:
    """`np.random.rand` from its syntax tree; empty for anything else."""
    if isinstance(node, ast.Name):
        return node.id
    return f"{dotted(node.value)}.{node.attr}" if isinstance(node, ast.Attribute) else ""


def constant_true(call: ast.Call, keyword: str) -> bool:
    """Is the keyword given, and anything but a plain False?"""
    given = [k.value for k in call.keywords if k.arg == keyword]
    return bool(given) and not (isinstance(given[0], ast.Constant) and given[0].value is False)


def import_problems(module: str, tree: ast.AST) -> Iterator[str]:
    """Edges that the table does not allow."""
    rules = [name for name in ALLOWED if inside(module, name)]
    own = max(rules, key=len, default=module)
    allowed = ALLOWED.get(own, set())
    for line, name in imports(tree):
        top = name.split(".")[0]
        if name.startswith("."):
            yield f"{module}:{line}: relative import {name}; write the full name"
        elif top in FORBIDDEN_MODULES:
            yield f"{module}:{line}: {top} runs code from data"
        elif (top in ROS or top.endswith("_msgs")) and not any(inside(module, place) for place in ROS_ALLOWED):
            yield f"{module}:{line}: {name} in a pure module; ROS belongs to the nodes"
        elif top in ("hd_control", "hd_sim") and name.count("."):
            # Compiled modules and plain names of the package itself are free: from hd_control import _laws, __version__
            if name.split(".")[1].startswith("_") and top == module.split(".")[0]:
                continue
            if not any(inside(name, package) for package in (*allowed, own)):
                yield f"{module}:{line}: {name} is not allowed here"
        if inside(module, "hd_control.drive.effects") and "hd_control.drive.effects." in name:
            yield f"{module}:{line}: an effect imports another effect, {name}"
        for package, users in ONLY_FOR.items():
            if inside(name, package) and not any(inside(module, user) for user in (*users, package)):
                yield f"{module}:{line}: {package} is for {' and '.join(users)} only"


def call_problems(module: str, tree: ast.AST) -> Iterator[str]:
    """Calls that run text or data as code, or open a door for others."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = dotted(node.func)
        if name in FORBIDDEN_CALLS:
            yield f"{module}:{node.lineno}: {name}() is forbidden"
        for keyword in ("shell", "allow_pickle"):
            if constant_true(node, keyword):
                yield f"{module}:{node.lineno}: {keyword}=True is forbidden"


def cli_problems(module: str, tree: ast.Module) -> Iterator[str]:
    """The command line starts fast: its files import only the standard library until a command runs."""
    if not inside(module, "hd_control.cli"):
        return
    light = {"hd_control.cli", "hd_control.core.errors", "hd_control.__version__", "hd_control"}
    for node in tree.body:
        for line, name in imports(node) if isinstance(node, (ast.Import, ast.ImportFrom)) else ():
            if name.split(".")[0] not in sys.stdlib_module_names and not any(
                inside(name, p) for p in light - {"hd_control"}
            ):
                yield f"{module}:{line}: {name} at the top of a command; import it inside the function"


def problems(module: str, source: str) -> list[str]:
    """Everything that is wrong with one file."""
    tree = ast.parse(source)
    return [*import_problems(module, tree), *call_problems(module, tree), *cli_problems(module, tree)]


def sources() -> list[Path]:
    """Every Python file of the two packages."""
    return sorted(path for package in ("hd_control", "hd_sim") for path in (ROOT / package).rglob("*.py"))


def test_the_packages_keep_the_rules() -> None:
    found = [text for path in sources() for text in problems(module_name(path.relative_to(ROOT)), path.read_text())]
    assert not found, "\n".join(found)


def test_the_physics_of_the_world_has_no_rule_of_its_own() -> None:
    """A wider rule for one of these modules would open what is closed here."""
    assert ALLOWED["hd_sim"] == {"hd_control.core"} and not {f"hd_sim.{name}" for name in PHYSICS} & set(ALLOWED)
    assert all((ROOT / "hd_sim" / f"{name}.py").is_file() for name in PHYSICS)


def test_every_folder_has_a_rule() -> None:
    folders = {module_name(path.relative_to(ROOT)) for path in sources() if path.name == "__init__.py"}
    without = [name for name in folders if name != "hd_control" and not any(inside(name, rule) for rule in ALLOWED)]
    assert not without, f"name them in ALLOWED: {without}"


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("hd_control.core.blocks", "import hd_control.record.cdr"),
        ("hd_control.core.blocks", "from hd_control.laws import motion"),
        ("hd_control.drive.model", "from hd_control.lab import fit"),
        ("hd_control.drive.model", "def f():\n    from hd_control.record.reader import read"),
        ("hd_control.drive.effects.backlash", "from hd_control.drive.effects.stribeck import friction"),
        ("hd_control.lab.diagnosis.fit", "import hd_sim.plant"),
        ("hd_sim.plant", "from hd_control.safety import fusion"),
        *((f"hd_sim.{name}", "from hd_control.drive.model import Model") for name in PHYSICS),
        *((f"hd_sim.{name}", "from hd_control.laws import trajectory") for name in PHYSICS),
        *((f"hd_sim.{name}", "def f():\n    from hd_control import _laws") for name in PHYSICS),
        ("hd_control.papers.zhu", "from hd_sim.puzzles.draw import draw_case"),
        ("hd_control.bench.rows", "from hd_sim import puzzles"),
        ("hd_sim.runner", "from hd_sim.puzzles import draw"),
        ("hd_sim.nodes.plant_node", "def f():\n    import hd_sim.puzzles.draw"),
        ("hd_control.laws.motion", "import rclpy"),
        ("hd_control.record.writer", "from sensor_msgs.msg import JointState"),
        ("hd_control.laws.motion", "from . import baselines"),
        ("hd_control.cli.info", "import numpy as np"),
        ("hd_control.cli.info", "from hd_control.record.reader import read"),
        ("hd_control.record.reader", "import pickle"),
        ("hd_control.record.reader", "x = eval('1')"),
        ("hd_control.record.reader", "exec('x = 1')"),
        ("hd_control.record.reader", "import yaml\nyaml.load(text)"),
        ("hd_control.record.reader", "import numpy as np\nnp.load(path, allow_pickle=True)"),
        ("hd_control.record.reader", "import subprocess\nsubprocess.run('ls', shell=True)"),
        ("hd_control.record.reader", "import tempfile\ntempfile.mktemp()"),
    ],
)
def test_the_checker_catches(module: str, source: str) -> None:
    assert problems(module, source)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("hd_control.laws.motion", "from hd_control.drive import model\nfrom hd_control import _laws"),
        ("hd_control.nodes.plant", "import rclpy\nfrom sensor_msgs.msg import JointState"),
        ("hd_sim.runner", "from hd_control.laws import motion"),
        ("hd_control.demo.run", "from hd_sim.puzzles.puzzle import score_joint"),
        ("hd_sim.puzzles.campaign", "from hd_sim.puzzles import draw"),
        ("hd_control.cli.info", "def run(a):\n    import numpy as np\n    from hd_control.record import reader"),
        ("hd_control.record.reader", "import re\nre.compile('x')\nmodel.eval()\nnp.load(path, allow_pickle=False)"),
    ],
)
def test_the_checker_allows(module: str, source: str) -> None:
    assert problems(module, source) == []


def test_no_modules_import_each_other_in_a_circle():
    """Also through imports inside functions; what only a type checker reads does not count."""
    files = [path for package in ("hd_control", "hd_sim") for path in (ROOT / package).rglob("*.py")]
    modules = {module_name(path.relative_to(ROOT)): path for path in files}
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                node.body = []
        names = {full for _, full in imports(tree)}
        graph[name] = {n if n in modules else n.rpartition(".")[0] for n in names} & set(modules) - {name}
    assert list(graphlib.TopologicalSorter(graph).static_order())
