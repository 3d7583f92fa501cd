"""The package as it is installed: names, versions, files and executables agree wherever they are written twice."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest

import hd_control

ROOT = Path(__file__).resolve().parents[1]
OURS = {"hd_control", "hd_sim"}
DISTRIBUTIONS = {"pinocchio": "pin", "yaml": "pyyaml"}
"""Module -> package that brings it, where the names differ."""
OPTIONAL = {"mujoco": {"hd_control/bench/peers.py"}, "pytest": {"hd_control/cli/test.py"}}
"""Package of an extra -> the only files that may import it."""
NODES = {"plant_node", "fusion_node", "motion_node", "torque_node", "recorder_node", "chain"}


def scripts() -> dict[str, str]:
    """Executable to `module:function`, from pyproject.toml."""
    text = (ROOT / "pyproject.toml").read_text().partition("[project.scripts]")[2].partition("\n[")[0]
    return dict(re.findall(r'^(\w+) = "([\w.:]+)"', text, re.MULTILINE))


def requirements() -> dict[str, list[str]]:
    """Lock file name to its requirement blocks (the lines of one requirement joined)."""
    found = {}
    for path in sorted((ROOT / "requirements").glob("*.lock")):
        found[path.stem] = path.read_text().replace(" \\\n", " ").splitlines()
    return found


def test_versions_agree() -> None:
    assert ElementTree.parse(ROOT / "package.xml").findtext("version") == hd_control.__version__
    assert f"## {hd_control.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_ros_package_is_complete() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.findtext("name") == "hd_control" and package.findtext("license") == "Apache-2.0"
    assert package.findtext("export/build_type") == "ament_python"
    assert (ROOT / "resource" / "hd_control").is_file()


def declared(extra: str = "") -> set[str]:
    """Names of the packages that pyproject.toml asks for at run time, or in an extra."""
    text = (ROOT / "pyproject.toml").read_text()
    block = re.search(rf"^{extra or 'dependencies'} = \[(.*?)\]$", text, re.MULTILINE | re.DOTALL)
    assert block, extra
    return {re.split(r"[<>=!\[]", name)[0] for name in re.findall(r'"([^"]+)"', block[1])}


def in_package_xml() -> set[str]:
    """What package.xml asks for at run time."""
    return {str(node.text) for node in ElementTree.parse(ROOT / "package.xml").getroot().iter("exec_depend")}


def imported(paths: Iterable[Path]) -> dict[str, set[str]]:
    """Modules that files import and that are neither Python's nor ours, by their first name: files that do."""
    found: dict[str, set[str]] = {}
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            for name in {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) - OURS:
                found.setdefault(name, set()).add(str(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path))
    return found


def from_ros(module: str) -> bool:
    """Does the module come with ROS 2?"""
    return module.startswith(("rcl", "launch", "ament_")) or module.endswith(("_msgs", "_srvs", "_interfaces"))


def shipped_sources() -> list[Path]:
    """What an installation runs."""
    return [path for folder in ("hd_control", "hd_sim", "launch") for path in sorted((ROOT / folder).rglob("*.py"))]


def dependency_problems(found: Mapping[str, set[str]], asked: set[str], ros: set[str]) -> list[str]:
    """Imports that are not declared, declared packages without import. `asked`: pyproject.toml, `ros`: package.xml."""
    problems = []
    for module, files in sorted(found.items()):
        name = DISTRIBUTIONS.get(module, module)
        if from_ros(module):
            problems += [] if module in ros else [f"{module} is not in package.xml: {sorted(files)[0]}"]
        elif name not in asked and not files <= OPTIONAL.get(name, set()):
            problems.append(f"{name} is not in pyproject.toml: {sorted(files)[0]}")
    used = {DISTRIBUTIONS.get(module, module) for module in found}
    problems += [f"pyproject.toml asks for {name}, nothing imports it" for name in sorted(asked - used)]
    rosdep = {f"python3-{name.removeprefix('py')}": name for name in asked} | {"pinocchio": "pin"}
    return problems + [
        f"package.xml asks for {name}, nothing imports it"
        for name in sorted(ros)
        if name not in found and rosdep.get(name) not in used
    ]


def test_every_dependency_is_imported_and_every_import_declared() -> None:
    assert dependency_problems(imported(shipped_sources()), declared(), in_package_xml()) == []


def test_build_and_tests_import_what_their_extras_bring() -> None:
    for extra, files in (("build", [ROOT / "setup.py"]), ("test", [*(ROOT / "test").rglob("*.py")])):
        beside = {path.stem for path in files} | {path.parent.name for path in files}
        used = {DISTRIBUTIONS.get(m, m) for m in imported(files) if m not in beside and not from_ros(m)}
        known = declared() | declared("build") | declared(extra) | set(OPTIONAL)
        assert used <= known, f"{extra}: {used - known}"


def test_the_check_of_dependencies_can_fail(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text("import numpy as np\nfrom yaml import parse\ndef f():\n    import can, std_msgs.msg\n")
    found = imported([path])
    assert set(found) == {"numpy", "yaml", "can", "std_msgs"}
    assert dependency_problems(found, {"numpy", "pyyaml", "lz4"}, {"python3-numpy", "python3-yaml", "launch"}) == [
        f"can is not in pyproject.toml: {path}",
        f"std_msgs is not in package.xml: {path}",
        "pyproject.toml asks for lz4, nothing imports it",
        "package.xml asks for launch, nothing imports it",
    ]
    assert dependency_problems({"numpy": {"a"}}, {"numpy"}, {"python3-numpy"}) == []


def test_every_executable_exists() -> None:
    found = scripts()
    assert set(found) == {*NODES, "hd"}
    for name, target in found.items():
        module, _, function = target.partition(":")
        path = ROOT / (module.replace(".", "/") + ".py")
        assert path.is_file(), f"{name}: {path} is missing"
        defined = {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}
        assert function in defined, f"{name}: {module} has no function {function}"


def test_locks_pin_every_package_with_a_hash() -> None:
    for name, blocks in requirements().items():
        assert blocks, name
        for block in blocks:
            assert re.match(r"[a-z0-9.-]+==[\w.]+( ; .+?)? +--hash=sha256:[0-9a-f]{64}", block), (
                f"{name}.lock: {block[:80]}"
            )


def test_locks_do_not_overlap() -> None:
    names = {group: {block.split("==")[0] for block in blocks} for group, blocks in requirements().items()}
    groups = sorted(names)
    for i, one in enumerate(groups):
        for other in groups[i + 1 :]:
            assert not names[one] & names[other], f"{one}.lock and {other}.lock"


def test_a_sourced_ros_brings_its_own() -> None:
    """With a sourced ROS only build, run and test are installed: none may bring ROS or what its messages build on."""
    for group in ("run", "build", "test"):
        names = {block.split("==")[0] for block in requirements()[group]}
        assert not [name for name in names if name.startswith("ros-") or name in ("numpy", "scipy")], group


@pytest.mark.slow
def test_an_install_finds_its_files(tmp_path: Path) -> None:
    """A wheel of a copy of the tracked files, installed into an empty environment.

    The compiled parts are those of this checkout, where ./hd has just compiled them, at the place where a build looks
    for what is new enough.
    """
    environment = tmp_path / "environment"
    venv.create(environment, with_pip=False, symlinks=True)
    python = environment / "bin" / "python"
    source = tmp_path / "source"
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("needs the git checkout")
    for name in filter(None, done.stdout.split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
            (source / name).chmod((ROOT / name).stat().st_mode)
    built = source / "build" / f"lib.{sysconfig.get_platform()}-{sys.implementation.cache_tag}"
    for part in ROOT.glob("hd_*/_*.so"):
        (built / part.parent.name).mkdir(parents=True, exist_ok=True)
        shutil.copy(part, built / part.parent.name)
    pip = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check"]
    wheel_of = ["wheel", "--no-deps", "--no-index", "--no-build-isolation", "-w", str(tmp_path), str(source)]
    subprocess.run([*pip, *wheel_of], check=True, cwd=tmp_path)
    wheel = str(next(tmp_path.glob("hd_control-*.whl")))
    subprocess.run(
        [*pip, "--python", str(python), "install", "--no-deps", "--no-index", wheel], check=True, cwd=tmp_path
    )
    hd = subprocess.run([environment / "bin" / "hd", "--version"], capture_output=True, text=True, cwd=tmp_path)
    assert hd.stdout == f"hd {hd_control.__version__}\n", hd.stderr
    code = (
        "import hd_control; from hd_control.core import resources; print(resources.config_path(), hd_control.__file__)"
    )
    config, file = subprocess.run([python, "-c", code], capture_output=True, text=True, cwd=tmp_path).stdout.split()
    assert Path(config).is_relative_to(environment) and Path(file).is_relative_to(environment)
    shipped = {str(path.relative_to(source / "config")) for path in (source / "config").rglob("*") if path.is_file()}
    assert shipped == {str(path.relative_to(config)) for path in Path(config).rglob("*") if path.is_file()}
    share = environment / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "hd_control").is_file()
    assert (share / "hd_control" / "package.xml").is_file()
    compiled = {path.name.split(".")[0] for path in environment.rglob("hd_*/_*.so")}
    wanted = {f"_{path.name.removesuffix('_module.cpp')}" for path in source.glob("hd_*/cpp/*_module.cpp")}
    assert compiled == wanted
    assert {path.name for path in (environment / "bin").iterdir()} >= {*NODES, "hd"}


def test_the_entry_of_a_checkout_runs(tmp_path: Path) -> None:
    """The README's cheap commands, from another folder, where ./hd made the environment."""
    if not (ROOT / ".venv" / "hd-current").exists():
        pytest.skip("this environment was not made by ./hd")
    for words, start in (["--version"], f"hd {hd_control.__version__}"), (["--help"], "usage: hd COMMAND"):
        done = subprocess.run([str(ROOT / "hd"), *words], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0 and done.stdout.startswith(start), done.stderr
