"""Goal G9: whatever happens to the recording, the torques stay the same bit for bit, and the error is told at once."""

from __future__ import annotations

import errno
import hashlib

import pytest

from hd_control.record.reader import BagReader
from hd_control.record.recorder import Recorder
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

TICKS, FAIL_AT = 1500, 700
TOPIC, RUN, TICK_NS = "motor_torque_command", "0123456789abcdef", 1_000_000


class BrokenFile:
    """Takes everything up to a time, then fails for ever."""

    def __init__(self, raw, code: int) -> None:
        self.raw, self.code, self.broken = raw, code, False

    def write(self, data) -> int:
        if self.broken:
            raise OSError(self.code, "made to fail")
        return self.raw.write(data)


def torques(recorder: Recorder | None, stream: BrokenFile | None = None) -> tuple[str, int]:
    """Hash of all commands of a run, and the tick at which the recorder told its failure (-1: never)."""
    runner, digest, told = Runner(RunSetup(PlantConfig.from_file("arm_a"), 1)), hashlib.sha256(), -1
    codec = joint_state_codec(TOPIC, runner.robot.joint_names)
    for tick in range(TICKS):
        effort = runner.step()[TOPIC]["effort"]
        digest.update(effort.tobytes())
        if recorder is None:
            continue
        if stream is not None and tick == FAIL_AT:
            stream.broken = True
        recorder.offer(TOPIC, tick * TICK_NS, codec.encode(tick * TICK_NS, RUN, effort=effort))
        if tick % 5 == 0:
            recorder.tend(tick * TICK_NS)
        if recorder.failure and told < 0:
            told = tick
    return digest.hexdigest(), told


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_failing_disk_changes_no_torque(tmp_path, code):
    recorder = Recorder(BagWriter(tmp_path / "bag"))
    recorder.add_topic(TOPIC)
    recorder.bag.flush()
    stream = BrokenFile(recorder.bag._raw, code)
    recorder.bag._file._stream = stream
    with_failure, told = torques(recorder, stream)
    assert with_failure == torques(None)[0]
    assert FAIL_AT <= told <= FAIL_AT + 1000, "the error is told within a second"
    assert recorder.close() == recorder.failure != ""
    row = recorder.statistics()[f"/{TOPIC}"]
    assert row["published"] == TICKS == row["written"] + row["drops"]["disk"] and row["written"] >= FAIL_AT - 5
    assert BagReader(tmp_path / "bag").counts[f"/{TOPIC}"] == row["written"]
