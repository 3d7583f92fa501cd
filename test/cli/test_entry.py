"""The shell entry ./hd where something is missing: one line with the remedy, exit code 2, nothing half-made."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ["cat", "cksum", "cmp", "cut", "flock", "grep", "mkdir", "readlink", "rm", "sleep", "tail"]
REAL_PYTHON = os.path.realpath(sys.executable)
# A Python that is new enough for everything asked of it, but without the venv module, or without anything at all.
NO_VENV = '#!/bin/sh\ncase "$*" in *ensurepip*) exit 1 ;; *version_info*) exit 0 ;; esac\nexit 1\n'
TOO_OLD = "#!/bin/sh\nexit 1\n"
COMPILER = "#!/bin/sh\nexit 0\n"
OLD_COMPILER = "#!/bin/sh\nexit 1\n"


class Machine:
    """A copy of ./hd with its lock files, on a PATH that holds only what was put there."""

    def __init__(self, folder: Path) -> None:
        self.checkout, self.bin = folder / "check out", folder / "bin"
        (self.checkout / "requirements").mkdir(parents=True)
        self.bin.mkdir()
        for lock in (ROOT / "requirements").glob("*.lock"):
            shutil.copy(lock, self.checkout / "requirements")
        for name in ("hd", "setup.py", "pyproject.toml"):
            shutil.copy(ROOT / name, self.checkout)
        for tool in TOOLS:
            (self.bin / tool).symlink_to(str(shutil.which(tool)))
        self.environment = {"PATH": str(self.bin), "HOME": str(folder)}

    def tool(self, name: str, script: str) -> None:
        """Puts a script on the PATH."""
        (self.bin / name).write_text(script)
        (self.bin / name).chmod(0o755)

    def start(self, **environment: str) -> subprocess.Popen[str]:
        """Starts ./hd --version."""
        command = ["/bin/sh", str(self.checkout / "hd"), "--version"]
        known = {**self.environment, **environment}
        pipe = subprocess.PIPE
        return subprocess.Popen(command, env=known, stdout=pipe, stderr=pipe, text=True, start_new_session=True)

    def refused(self, **environment: str) -> str:
        """What ./hd says when it must refuse: its last line. Nothing of an environment may be left."""
        process = self.start(**environment)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 2 and not out, err
        assert not (self.checkout / ".venv").exists()
        assert all(line.startswith("hd: ") for line in err.splitlines()), err
        return err.splitlines()[-1]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """A machine with a compiler and nothing else."""
    found = Machine(tmp_path)
    found.tool("c++", COMPILER)
    return found


def test_no_python(machine: Machine) -> None:
    assert "no Python 3.10 to 3.13 found; install one: apt-get install python3" in machine.refused()
    machine.tool("python3", TOO_OLD)
    assert "no Python 3.10 to 3.13 found" in machine.refused()
    assert "HD_PYTHON=python3 is not a Python 3.10 to 3.13" in machine.refused(HD_PYTHON="python3")


def test_no_venv_module(machine: Machine) -> None:
    machine.tool("python3", NO_VENV)
    assert machine.refused().endswith("has no venv module; install it: apt-get install python3-venv")


def test_no_compiler(machine: Machine) -> None:
    machine.tool("python3", NO_VENV)
    machine.tool("c++", OLD_COMPILER)
    assert "does not compile C++17" in machine.refused()
    (machine.bin / "c++").unlink()
    assert "no C++ compiler (c++) found; install one: apt-get install g++" in machine.refused()
    assert "no C++ compiler (clang++-99)" in machine.refused(CXX="clang++-99")


def test_sourced_ros(machine: Machine) -> None:
    machine.tool("python3", NO_VENV)
    sourced = {"AMENT_PREFIX_PATH": "/opt/ros/some"}
    assert "the sourced ROS 2 is 'humble', supported is jazzy" in machine.refused(ROS_DISTRO="humble", **sourced)
    assert "cannot import rclpy" in machine.refused(ROS_DISTRO="jazzy", **sourced)


def test_an_environment_of_the_user_is_not_touched(machine: Machine) -> None:
    mine = machine.checkout / ".venv" / "mine"
    mine.parent.mkdir()
    mine.write_text("work")
    process = machine.start()
    assert "was not made by ./hd; move it away first" in process.communicate(timeout=60)[1]
    assert process.returncode == 2 and mine.read_text() == "work"


@pytest.mark.slow
def test_no_network(machine: Machine) -> None:
    """The package index is a port of this machine where nothing listens."""
    machine.tool("python3", f'#!/bin/sh\nexec "{REAL_PYTHON}" "$@"\n')
    line = machine.refused(PIP_INDEX_URL="http://127.0.0.1:9/", PIP_NO_CACHE_DIR="1", PIP_RETRIES="0")
    assert "no network: the packages could not be fetched" in line


@pytest.mark.process
def test_two_at_once_and_a_kill(machine: Machine) -> None:
    """The second waits for the first and says so; killing the first leaves nothing and lets the second go on."""
    machine.tool("python3", '#!/bin/sh\ncase "$*" in *-m*venv*) sleep 30; exit 1 ;; esac\nexit 0\n')
    first = machine.start()
    deadline = time.monotonic() + 60
    while not (machine.checkout / ".venv" / "hd-made").exists():
        assert time.monotonic() < deadline and first.poll() is None
        time.sleep(0.02)
    second = machine.start()
    assert second.stderr is not None
    assert second.stderr.readline() == "hd: another ./hd is setting up .venv; waiting for it\n"
    machine.tool("python3", NO_VENV)
    os.killpg(first.pid, signal.SIGTERM)  # the whole group, as a terminal or a supervisor does
    first.communicate(timeout=60)
    assert first.returncode != 0
    assert second.communicate(timeout=60)[1].endswith("apt-get install python3-venv\n")
    assert second.returncode == 2 and not (machine.checkout / ".venv").exists()
