"""The pump's threads under the compiler's sanitizers, on a stand-in for the middleware: no race, no use after free."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SOURCES = Path(__file__).parent / "pump"
HEADERS = Path(__file__).parents[2] / "hd_control" / "cpp"
TIMES = os.environ.get("HD_STRESS", "60")


def build(folder: Path, sanitizer: str) -> tuple[Path, Path]:
    """The stand-in for librcl and the program. Skips where the compiler has no such sanitizer."""
    flags = ["-std=c++17", "-g", "-O1", f"-fsanitize={sanitizer}", f"-I{HEADERS}"]
    library, program = folder / "librcl.so", folder / "stress"
    shared = ["-shared", "-fPIC", "-Wl,-soname,librcl.so", str(SOURCES / "fake_rcl.cpp"), "-o", str(library)]
    linked = [str(SOURCES / "stress.cpp"), "-o", str(program), "-ldl", "-lpthread"]
    for more in (shared, linked):
        done = subprocess.run(["g++", *flags, *more], capture_output=True, text=True)
        if "sanitize" in done.stderr or "cannot find -l" in done.stderr:
            pytest.skip(f"no {sanitizer} sanitizer here")
        assert done.returncode == 0, done.stderr
    return library, program


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs a compiler")
@pytest.mark.parametrize("sanitizer", ["thread", "address,undefined"])
def test_beginning_looking_and_ending_race_with_nothing(tmp_path: Path, sanitizer: str) -> None:
    library, program = build(tmp_path, sanitizer)
    environment = {**os.environ, "TSAN_OPTIONS": "halt_on_error=1 exitcode=66"}
    done = subprocess.run(
        [str(program), str(library), TIMES], capture_output=True, text=True, env=environment, timeout=600
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "balanced\n", "")
