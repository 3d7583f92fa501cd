"""What reads text from outside, as functions of (folder, bytes), each with files to begin from.

A target takes everything or raises HdError; nothing else may leave it, and what it refuses leaves nothing behind.
"""

from __future__ import annotations

import io
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mutate import mutated

from hd_control.core.errors import HdError

ROOT = Path(__file__).resolve().parents[2]
MOST_SECONDS = 1.0
MAPPING = """
joints: {joint_1: j1, joint_2: j2}
time: {column: t, unit: s}
signals:
  motor_shaft_position: {columns: "q_{joint}", unit: deg, wrap: 360}
  motor_torque: {columns: {joint_1: u_j1, joint_2: u_j2}, unit: Nm, sign: -1}
"""
FORMULAS = ["a * sin(2 * q) + b", "c * tanh(v / s)", "-((a + b) ** 2) / (1 + abs(v))", "max(a, b) - min(a, 0)"]


@dataclass(frozen=True)
class Target:
    """`read(folder, data)` takes one file; `seeds` are texts that are right."""

    read: Callable[[Path, bytes], Any]
    seeds: tuple[str, ...]


def _file(folder: Path, data: bytes, name: str) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def _yaml(folder: Path, data: bytes) -> Any:
    from hd_control.core.strict_yaml import parse_yaml

    return parse_yaml(data)


def _params(folder: Path, data: bytes) -> Any:
    from hd_control.core.strict_yaml import load_params_file
    from hd_control.laws.torque import PARAMETERS

    values = load_params_file(_file(folder, data, "params.yaml"), "torque_node")
    PARAMETERS.check(values, 7)
    return values


def _model(folder: Path, data: bytes) -> Any:
    from hd_control.drive.model_file import parse_model

    return parse_model(data)


def _mapping(folder: Path, data: bytes) -> Any:
    from hd_control.lab.signals.sources import load_mapping

    return load_mapping(_file(folder, data, "map.yaml"))


def _metadata(folder: Path, data: bytes) -> Any:
    from hd_control.record.bag_folder import load

    return load(_file(folder, data, "metadata.yaml"))


def _urdf(folder: Path, data: bytes) -> Any:
    from hd_control.core.robot import Robot

    robot = Robot.from_file(str(_file(folder, data, "robot.urdf")))
    assert all(
        np.isfinite(getattr(robot, x)).all() for x in ("rotation", "origin", "mass", "center_of_mass", "inertia")
    )
    assert (robot.mass > 0).all() and (robot.position_low <= robot.position_high).all()
    return robot


def _csv(folder: Path, data: bytes) -> Any:
    from hd_control.record.tables import read_table

    return read_table(_file(folder, data, "table.csv"))


def _npz(folder: Path, data: bytes) -> Any:
    from hd_control.record.tables import read_table

    return read_table(_file(folder, data, "table.npz"))


def _import(folder: Path, data: bytes) -> Any:
    """A table with a good mapping becomes a bag, or nothing appears."""
    from hd_control.lab.signals.import_table import import_table
    from hd_control.lab.signals.sources import load_mapping

    mapping = load_mapping(_file(folder, MAPPING.encode(), "map.yaml"))
    bag = folder / "bag"
    try:
        found = import_table(_file(folder, data, "table.csv"), bag, mapping)
    except HdError:
        assert not bag.exists() and not list(folder.glob(".bag*")), "a refused table left something behind"
        raise
    return found


def _formula(folder: Path, data: bytes) -> Any:
    from hd_control.drive.expression import parse_formula

    return parse_formula(data.decode("utf-8", "replace"))


def _texts(pattern: str) -> tuple[str, ...]:
    return tuple(path.read_text() for path in sorted(ROOT.glob(pattern)))


def _table() -> str:
    rows = [f"{k * 1e-3:.3f},{k * 0.5},{-k * 0.25},{k % 7},{k % 5}" for k in range(60)]
    return "\n".join(["t,q_j1,q_j2,u_j1,u_j2", *rows]) + "\n"


def _archive() -> str:
    stream = io.BytesIO()
    np.savez(stream, time=np.arange(20.0), position=np.zeros((20, 2)), joints=np.array(["a", "b"]))
    return stream.getvalue().decode("latin-1")


def targets() -> dict[str, Target]:
    """All of them by name."""
    from hd_control.record import bag_folder

    entry = bag_folder.TopicEntry("/encoder", "sensor_msgs/msg/JointState", "", 5)
    metadata = bag_folder.dump(
        {"rosbag2_bagfile_information": bag_folder.document("bag_0.mcap", [entry], 0, 5, {"a": "b"})}
    )
    configuration = _texts("config/*.yaml")
    return {
        "yaml": Target(_yaml, configuration),
        "params": Target(_params, _texts("config/torque_node.yaml")),
        "model": Target(_model, _texts("config/models/*.yaml")),
        "mapping": Target(_mapping, (*_texts("config/maps/*.yaml"), MAPPING)),
        "metadata": Target(_metadata, (metadata,)),
        "urdf": Target(_urdf, _texts("config/robots/*.urdf")),
        "csv": Target(_csv, (_table(), _table().replace(",", ";"))),
        "npz": Target(lambda folder, data: _npz(folder, _latin(data)), (_archive(),)),
        "import": Target(_import, (_table(),)),
        "formula": Target(_formula, tuple(FORMULAS)),
    }


def _latin(data: bytes) -> bytes:
    """The bytes of a text whose characters stand for bytes."""
    return data.decode("utf-8", "replace").encode("latin-1", "replace")


def check_case(folder: Path, name: str, target: Target, number: int) -> bool:
    """Runs one case; True if the input was taken. Raises AssertionError with the case's words if a rule is broken."""
    rng = random.Random(f"{name} {number}")
    data = mutated(rng.choice(target.seeds), rng)
    place = folder / f"{name}_{number}"
    place.mkdir()
    start = time.process_time()
    try:
        target.read(place, data)
        taken = True
    except HdError as error:
        assert str(error).strip(), f"{name} {number}: an error without words"
        assert len(str(error)) < 20_000, f"{name} {number}: an endless error"
        taken = False
    except Exception as error:
        raise AssertionError(f"{name} {number}: {type(error).__name__}: {error!s:.200} for {data[:300]!r}") from error
    used = time.process_time() - start
    assert used < MOST_SECONDS, f"{name} {number}: {used:.1f} s of processor time for {len(data)} bytes"
    return taken
