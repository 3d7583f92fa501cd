"""Build of the compiled parts. Everything else is declared in pyproject.toml and package.xml."""

from glob import glob
from pathlib import Path

from pybind11.setup_helpers import Pybind11Extension, build_ext
from setuptools import find_packages, setup

HERE = Path(__file__).parent
FLAGS = ["-O3", "-fno-math-errno", "-ffp-contract=off", "-Wall", "-Wextra"]


def extensions():
    """One extension `package._name` for every `package/cpp/name_module.cpp`."""
    found = []
    for source in sorted(glob("hd_*/cpp/*_module.cpp")):
        package = source.split("/")[0]
        name = Path(source).name.removesuffix("_module.cpp")
        found.append(
            Pybind11Extension(
                f"{package}._{name}",
                [source],
                cxx_std=17,
                extra_compile_args=FLAGS,
                include_dirs=["hd_control/cpp", f"{package}/cpp"],
                depends=glob("hd_*/cpp/*.hpp"),
            )
        )
    return found


packages = find_packages(include=["hd_control*", "hd_sim*"])
setup(packages=packages, ext_modules=extensions(), cmdclass={"build_ext": build_ext})
