"""Compiled modules built from changed headers in a folder of their own; the tree stays as it is."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sysconfig
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULES = ("hd_control._laws", "hd_control._chain", "hd_sim._drive_side", "hd_control._plane", "hd_sim._plant")
"""Those that the tests of the safety rules use."""
SUFFIX, PYTHON = sysconfig.get_config_var("EXT_SUFFIX"), sysconfig.get_paths()["include"]
FLAGS = ["-std=c++17", "-O1", "-fno-math-errno", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-fPIC"]


def main_file(module: str) -> str:
    """`hd_control._chain` is made of `hd_control/cpp/chain_module.cpp`."""
    package, name = module.split("._")
    return f"{package}/cpp/{name}_module.cpp"


def headers_of(file: str) -> set[str]:
    """The project's headers that a source takes in, directly or through others, as paths from the root."""
    found: set[str] = set()
    for name in re.findall(r'#include "(\w+\.hpp)"', (ROOT / file).read_text()):
        for folder in (Path(file).parent, Path("hd_control/cpp")):
            if (ROOT / folder / name).is_file():
                path = (folder / name).as_posix()
                found |= {path} | headers_of(path)
                break
    return found


def users_of(header: str) -> list[str]:
    """The modules of `MODULES` into which a header goes."""
    return [module for module in MODULES if header in headers_of(main_file(module))]


def build(changed: Mapping[str, str], modules: list[str], folder: Path) -> Path:
    """Builds modules with some files changed (path from the root -> text); the folder for HD_EXTENSIONS."""
    for package in ("hd_control", "hd_sim"):
        shutil.copytree(ROOT / package / "cpp", folder / "source" / package / "cpp", dirs_exist_ok=True)
    for file, text in changed.items():
        (folder / "source" / file).write_text(text)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda module: _compile(module, folder), modules))
    return folder / "lib"


def _compile(module: str, folder: Path) -> None:
    import pybind11

    place = folder / "lib" / Path(*module.split("."))
    place.parent.mkdir(parents=True, exist_ok=True)
    source = folder / "source"
    includes = [pybind11.get_include(), PYTHON, source / "hd_control" / "cpp"]
    includes.append((source / main_file(module)).parent)
    made = place.with_name(place.name + SUFFIX)
    command = ["c++", *FLAGS, *(f"-I{path}" for path in includes), str(source / main_file(module)), "-o", str(made)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr[-3000:]
