"""What every test shares: seeds, and a ROS of its own that no other run can hear."""

from __future__ import annotations

import importlib.abc
import importlib.util
import os
import random
import signal
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

SEED = int(os.environ.get("HD_SEED", "20240229"))
LIVE_LIMIT = float(os.environ.get("HD_LIVE_LIMIT", "600"))
"""s"""


class Overlay(importlib.abc.MetaPathFinder):
    """Other builds of compiled modules, `FOLDER/hd_control/_chain.*.so` and so on, in the place of the tree's own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find_spec(self, name, path, target=None):  # type: ignore[no-untyped-def]
        place = self.folder.joinpath(*name.split("."))
        library = place.with_name(place.name + sysconfig.get_config_var("EXT_SUFFIX"))
        return importlib.util.spec_from_file_location(name, library) if library.is_file() else None


if "HD_EXTENSIONS" in os.environ:  # the sabotage tests try changed builds so, without touching the source tree
    sys.meta_path.insert(0, Overlay(Path(os.environ["HD_EXTENSIONS"])))

# Set before anything imports rclpy. A number given from outside wins, so that a run can be joined or repeated.
os.environ.setdefault("ROS_DOMAIN_ID", str(random.SystemRandom().randint(1, 100)))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_LOG_DIR", os.path.join(tempfile.gettempdir(), f"hd_test_log_{os.getuid()}"))

# No deadline: a busy machine is not a defect. The same examples each time, unless HD_SEED asks for others.
settings.register_profile("repeatable", deadline=None, derandomize="HD_SEED" not in os.environ)
settings.load_profile("repeatable")


def pytest_report_header() -> str:
    """What is needed to repeat this run."""
    return f"HD_SEED={SEED} ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All tests of nodes count as live: they meet in one process with ROS."""
    for item in items:
        if item.path.parent == Path(__file__).parent / "nodes":
            item.add_marker(pytest.mark.process)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    """The global generators start equal in each test, whatever ran before it."""
    random.seed(SEED)
    np.random.seed(SEED % 2**32)  # noqa: NPY002 - only to pin code that still uses the global state


@pytest.fixture(autouse=True)
def _limited(request: pytest.FixtureRequest) -> Iterator[None]:
    """A live test that waits for ever fails after `LIVE_LIMIT` s; what it has started is ended by its own clean-up."""
    if request.node.get_closest_marker("process") is None:
        yield
        return

    def give_up(number: int, frame: object) -> None:
        raise TimeoutError(f"{request.node.nodeid}: longer than {LIVE_LIMIT} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, LIVE_LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that starts equal in each test; HD_SEED changes it."""
    return np.random.default_rng(SEED)
