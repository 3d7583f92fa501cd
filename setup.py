"""Builds the compiled parts and places the shipped files. The metadata is in pyproject.toml and package.xml."""

import os
import re
import shutil
import sys
from glob import glob
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

os.chdir(Path(__file__).resolve().parent)

# -ffp-contract=off: without it the compiler fuses a*b+c where it likes, and two builds differ in the last bit.
FLAGS = ["-std=c++17", "-O3", "-g0", "-fno-math-errno", "-ffp-contract=off", "-Wall", "-Wextra", "-fvisibility=hidden"]
SHIPPED = {"config": "**/*", "launch": "*.launch.py"}


def pybind11_include():
    """Folder of pybind11's headers; empty where the system's own headers are on the compiler's path."""
    try:
        import pybind11
    except ImportError:
        return []
    return [pybind11.get_include()]


def ros_includes():
    """Folders of the headers of rcl and what they use: of a sourced ROS, else of the wheels; empty without either.

    Nothing is linked: hd_control/cpp/rcl_access.hpp finds the library at run time, the headers are compared with it.
    """
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if os.environ.get("ROS_DISTRO") else []
    for prefix in filter(None, [*prefixes, sys.prefix]):
        root = Path(prefix, "include")
        if Path(root, "rcl", "rcl", "subscription.h").exists():
            return sorted(str(path) for path in root.iterdir() if Path(path, path.name).is_dir())
    return []


def headers_of(source, include_dirs, found=()):
    """The headers of this project that a source includes, directly or through others: what it is rebuilt for."""
    known = list(found)
    for name in re.findall(r'^#include "([^"]+)"', Path(source).read_text(encoding="utf-8"), re.MULTILINE):
        for path in (Path(folder, name) for folder in include_dirs):
            if path.exists() and str(path) not in known:
                known = headers_of(path, include_dirs, [*known, str(path)])
    return known


def extensions():
    """One extension `package._name` for every `package/cpp/name_module.cpp`."""
    found = []
    for source in sorted(glob("hd_*/cpp/*_module.cpp")):
        package = source.split("/")[0]
        name = Path(source).name.removesuffix("_module.cpp")
        own = dict.fromkeys(["hd_control/cpp", f"{package}/cpp"])
        headers = headers_of(source, own)
        ros = ros_includes() if "hd_control/cpp/rcl_access.hpp" in headers else []
        found.append(
            Extension(
                f"{package}._{name}",
                [source],
                language="c++",
                extra_compile_args=FLAGS,
                include_dirs=[*pybind11_include(), *own, *ros],
                depends=[*headers, "setup.py"],
            )
        )
    return found


def shipped_files():
    """Every file below config/ and the launch files, as paths from here."""
    paths = (path for folder, pattern in SHIPPED.items() for path in Path(folder).glob(pattern))
    return sorted(path for path in paths if path.is_file() and "__pycache__" not in path.parts)


def data_files():
    """What ROS tools look for below share/: the package marker, package.xml, config/ and launch/."""
    folders = {
        "share/ament_index/resource_index/packages": ["resource/hd_control"],
        "share/hd_control": ["package.xml"],
    }
    for path in shipped_files():
        folders.setdefault(f"share/hd_control/{path.parent}", []).append(str(path))
    return sorted(folders.items())


class BuildExtensions(build_ext):
    """Compiles the extensions side by side, one for each processor."""

    def finalize_options(self):
        super().finalize_options()
        self.parallel = self.parallel or os.cpu_count()


class BuildPython(build_py):
    """Copies config/ and launch/ into the package, where `core/resources.py` finds them after an install."""

    def run(self):
        super().run()
        if not getattr(self, "editable_mode", False):
            for path in shipped_files():
                target = Path(self.build_lib, "hd_control", path)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)


setup(
    python_requires=">=3.10",
    packages=find_packages(include=["hd_control*", "hd_sim*"]),
    data_files=data_files(),
    ext_modules=extensions(),
    cmdclass={"build_ext": BuildExtensions, "build_py": BuildPython},
    # Where `ros2 run` looks for executables in a colcon workspace; pip places scripts itself.
    options={
        "develop": {"script_dir": "$base/lib/hd_control"},
        "install": {"install_scripts": "$base/lib/hd_control"},
    },
    zip_safe=False,
)
