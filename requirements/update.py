"""Writes the lock files from pyproject.toml: exact versions and the hashes of the files that were really fetched.

    python3 requirements/update.py FOLDER      needs uv and pip; FOLDER keeps the fetched files (about 1 GB)

ros.lock    ROS 2 wheels and what must match them (numpy, scipy, yaml): a sourced ROS 2 brings its own
run.lock    the remaining run-time packages       build.lock  what compiles and installs this package
test.lock   tools of `./hd test`                  bench.lock  peers of `hd bench`, optional

Each requirement holds for Linux on x86_64 and the Python versions below; the markers say which version is for which.
"""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
PLATFORMS = [f"manylinux_2_{minor}_x86_64" for minor in range(39, 4, -1)]  # newest first, as pip prefers them
PLATFORMS += [f"{name}_x86_64" for name in ("manylinux2014", "manylinux2010", "manylinux1", "linux")]
FROM_SOURCE = "empy"  # published without a wheel
EXTRAS = ["ros", "test", "build", "bench"]
WITH_ROS = {"numpy", "scipy", "pyyaml", "typing-extensions"}  # compiled against each other on a system with ROS


def resolve(extras: list[str], constraints: str, *options: str) -> dict[str, str]:
    """Package name to requirement line (`name==version ; marker`) of pyproject.toml with these extras."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "constraints").write_text(constraints)
        command = "uv pip compile -q --no-header --no-annotate pyproject.toml -c".split()
        command += [f"{folder}/constraints", *options]
        for extra in extras:
            command += ["--extra", extra]
        output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    lines: dict[str, str] = {}
    for line in output.splitlines():
        if name := re.match(r"[\w.-]+(?===)", line):
            lines[name[0]] = f"{lines[name[0]]}\n{line}" if name[0] in lines else line
    return lines


def fetch(python: str, lines: dict[str, str], folder: Path) -> None:
    """Fetches the files of one Python version into the folder."""
    listed = folder / f"python{python}.txt"
    listed.write_text("\n".join(lines.values()) + "\n")
    command = [sys.executable, *"-m pip download -q --no-deps --only-binary :all: --no-binary".split(), FROM_SOURCE]
    command += ["--python-version", python, "-d", str(folder), "-r", str(listed)]
    for platform in PLATFORMS:
        command += ["--platform", platform]
    subprocess.run(command, check=True)


def hashes(folder: Path) -> dict[tuple[str, str], list[str]]:
    """(name, version) to the SHA-256 of its fetched files."""
    found: dict[tuple[str, str], list[str]] = {}
    for path in sorted(folder.iterdir()):
        if match := re.match(r"(.+?)-(\d[^-]*?)(?:-.*\.whl|\.tar\.gz)$", path.name):
            key = (re.sub(r"[-_.]+", "-", match[1]).lower(), match[2])
            found.setdefault(key, []).append(hashlib.sha256(path.read_bytes()).hexdigest())
    return found


def locked(line: str, known: dict[tuple[str, str], list[str]]) -> str:
    """The requirement lines with their hashes."""
    blocks = []
    for part in line.splitlines():
        name, version = part.split(" ")[0].split("==")
        wanted = known[(re.sub(r"[-_.]+", "-", name).lower(), version)]
        blocks.append(" \\\n    ".join([part, *(f"--hash=sha256:{value}" for value in sorted(wanted))]))
    return "\n".join(blocks)


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    universal = ("--universal", "--python-version", "3.10")
    everything = resolve(EXTRAS, "", *universal)
    constraints = "\n".join(everything.values())
    for python in PYTHONS:
        one = ("--python-version", python, "--python-platform", "x86_64-manylinux_2_35")
        fetch(python, resolve(EXTRAS, constraints, *one), folder)
    known = hashes(folder)
    run, ros, test, build = (set(resolve(e, constraints, *universal)) for e in ([], ["ros"], ["test"], ["build"]))
    build = (build - run) | {"packaging"}  # wheel imports packaging, and the build tools are installed first
    ros = ((ros - run) | (WITH_ROS & ros)) - build
    run -= ros | build
    groups = {"build": build, "ros": ros, "run": run, "test": test - build - run - ros}
    groups["bench"] = set(everything) - set().union(*groups.values())
    for group, names in groups.items():
        usable = [everything[name] for name in sorted(names) if "win32" not in everything[name]]
        Path(ROOT, "requirements", f"{group}.lock").write_text("\n".join(locked(line, known) for line in usable) + "\n")


if __name__ == "__main__":
    main()
