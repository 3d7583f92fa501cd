"""Goal G9: whatever happens to the recording, the torques keep their bits, and the error is reported at once."""

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


def torques(recorder: Recorder | None, stream: BrokenFile | None = None, fail_at: int = FAIL_AT) -> tuple[str, int]:
    """Hash of all commands of a run, and the tick at which the recorder reported its failure (-1: never)."""
    runner, digest, reported = Runner(RunSetup(PlantConfig.from_file("arm_a"), 1)), hashlib.sha256(), -1
    codec = joint_state_codec(TOPIC, runner.robot.joint_names)
    for tick in range(TICKS):
        effort = runner.step()[TOPIC]["effort"]
        digest.update(effort.tobytes())
        if recorder is None:
            continue
        if stream is not None and tick == fail_at:
            stream.broken = True
        recorder.offer(TOPIC, tick * TICK_NS, codec.encode(tick * TICK_NS, RUN, effort=effort))
        if tick % 5 == 0:
            recorder.tend(tick * TICK_NS)
        if recorder.failure and reported < 0:
            reported = tick
    return digest.hexdigest(), reported


def fail_once(folder, code: int, fail_at: int, plain: str) -> tuple[int, str]:
    """A run whose disk fails at a tick: when it was reported, and what is wrong with it (nothing: an empty text)."""
    folder.mkdir(exist_ok=True)
    recorder = Recorder(BagWriter(folder / "bag"))
    recorder.add_topic(TOPIC)
    recorder.bag.flush()
    stream = BrokenFile(recorder.bag._raw, code)
    recorder.bag._file.redirect(stream)
    digest, reported = torques(recorder, stream, fail_at)
    closed, row = recorder.close(), recorder.statistics()[f"/{TOPIC}"]
    drops = row["drops"]["disk"]
    checks = {
        "torques differ": digest == plain,
        "reported too late": fail_at <= reported <= fail_at + 1000,
        "no reason": closed == recorder.failure != "",
        "not all published": row["published"] == TICKS,
        "not in balance": TICKS == row["written"] + drops and row["written"] >= fail_at - 5,
        "bag and count differ": BagReader(folder / "bag").counts.get(f"/{TOPIC}", 0) == row["written"],
    }
    return reported, ", ".join(name for name, good in checks.items() if not good)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_f30_a_failing_disk_changes_no_torque(tmp_path, code):
    _, problem = fail_once(tmp_path / "run", code, FAIL_AT, torques(None)[0])
    assert problem == ""
