"""Puts one hand-made bug in the place of the real module, in a process of its own, and asks a test."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sysconfig
from pathlib import Path

from mutants import ROOT, notices, notices_library

EXTENSION = "laws"
"""Every compiled bug is in a header of this extension."""


def is_noticed(bug: tuple[str, str, str, str, str], folder: Path) -> bool:
    """Does the bug's test turn red? Raises AssertionError if the text to break is not there any more."""
    name, file, old, new, tests = bug
    source = (ROOT / file).read_text()
    assert source.count(old) >= 1, f"{name}: the text to break is not there any more"
    broken, asked = source.replace(old, new, 1), shlex.split(tests)
    if file.endswith(".py"):
        return notices(file.removesuffix(".py").replace("/", "."), broken, asked)
    return notices_library(f"hd_control._{EXTENSION}", built(file, broken, folder), asked)


def built(file: str, source: str, folder: Path) -> Path:
    """The extension with one header replaced. Quoted includes look beside the file first, so all headers go along."""
    import pybind11

    shutil.copytree((ROOT / file).parent, folder, dirs_exist_ok=True)
    (folder / Path(file).name).write_text(source)
    module = f"{EXTENSION}_module.cpp"
    made = folder / f"_{EXTENSION}{sysconfig.get_config_var('EXT_SUFFIX')}"
    includes = [pybind11.get_include(), sysconfig.get_paths()["include"]]
    flags = ["-std=c++17", "-O1", "-fno-math-errno", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-fPIC"]
    command = ["c++", *flags, *(f"-I{path}" for path in includes), str(folder / module), "-o", str(made)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    return made
