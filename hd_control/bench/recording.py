"""What recording costs: topics at 1 kHz from one process, taken and written by the recorder node of another.

    recorder_run(10.0)               -> RecordingResult: processor time of the recorder, samples that are not in its bag
    recorder_run(10.0, loaded=True)  -> the same while ordinary programs keep every processor busy
    recorder_run(10.0, python=True)  -> the same with messages taken in Python, as where the compiled way cannot be had

Lost is counted from outside: what the source published less what a reader finds in the bag.
"""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.bench.measure import keep_busy
from hd_control.core.errors import HdError
from hd_control.core.topics import JOINT_STATE_TYPE, PROGRESS, TOPICS, VALUES_TYPE
from hd_control.nodes.process import prepare_environment, request_real_time, sleep_until
from hd_control.record.cdr import ValuesCodec, new_run_id
from hd_control.record.reader import BagReader
from hd_control.record.schema import joint_state_codec
from hd_control.session.session import Children, child_environment

JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
CHAIN = tuple(name for name, topic in TOPICS.items() if topic.type_name == JOINT_STATE_TYPE)
EXTRA = ("motion_node/introspection/values", "torque_node/introspection/values")
"""With the nine topics of the chain they are eleven."""
VALUES = 30
"""Numbers of an introspection message."""
SETTLE = 1.0
"""s before the first sample, for both ends of every topic to have found each other, and behind the last."""
IN_PYTHON = """
from hd_control.nodes import recorder_node
def refuse(dt_ns):
    raise RuntimeError("for this measurement")
recorder_node.Pump = refuse
recorder_node.main()
"""


@dataclass(frozen=True)
class RecordingResult:
    """`share`: of one processor that the recorder used, %. `published` and `lost`: samples of all topics together."""

    share: float
    published: int
    lost: int


def recorder_run(seconds: float, loaded: bool = False, python: bool = False) -> RecordingResult:
    """One recording of eleven topics at 1 kHz. Raises HdError if a process fails."""
    with (
        tempfile.TemporaryDirectory(prefix="hd_bench_") as folder,
        Children(child_environment(domain=1 + secrets.randbelow(100))) as children,
    ):
        bag = Path(folder, "bag")
        names = "[" + ", ".join(f'"{name}"' for name in EXTRA) + "]"
        values = {"autostart": "true", "bag": str(bag), "extra_topics": names, "compact": "false"}
        words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
        program = ["-c", IN_PYTHON] if python else ["-m", "hd_control.nodes.recorder_node"]
        log = Path(folder, "log").open("wb")
        recorder = children.start("recorder", [sys.executable, *program, "--ros-args", *words], stdout=log, stderr=log)
        command = [sys.executable, "-m", "hd_control.bench.recording", str(seconds), str(recorder.pid)]
        if loaded:
            keep_busy(children)
        source = children.start("source", command, stdout=subprocess.PIPE, stderr=log)
        text, _ = source.communicate(timeout=seconds + 60.0)
        children.signal("recorder", 2)
        code = recorder.wait(20.0)
        if source.returncode or code:
            raise HdError(f"exit code {source.returncode} of the source, {code} of the recorder")
        found = json.loads(text)
        counts = BagReader(bag).counts
        lost = sum(max(0, found["published"] - counts.get(f"/{name}", 0)) for name in (*CHAIN, *EXTRA))
        return RecordingResult(100.0 * found["used"] / found["time"], found["published"] * len((*CHAIN, *EXTRA)), lost)


def used_by(process: int) -> float:
    """Seconds of processor time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def source(seconds: float, recorder: int) -> dict[str, float]:
    """Publishes every topic each millisecond; returns messages per topic, its own time and the recorder's, s."""
    prepare_environment()
    request_real_time()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from hd_control.nodes.fast_loop import chain_qos, latched_qos
    from hd_control.nodes.recorder_node import message_class

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, run_id = rclpy.create_node("source"), new_run_id()
    codecs = [joint_state_codec(name, JOINTS) for name in CHAIN]
    ends = [node.create_publisher(message_class(JOINT_STATE_TYPE), name, chain_qos()) for name in CHAIN]
    more = [node.create_publisher(message_class(VALUES_TYPE), name, chain_qos(100)) for name in EXTRA]
    progress = node.create_subscription(message_class("std_msgs/msg/UInt64"), PROGRESS, lambda _: None, latched_qos())
    wait_until_recording(progress)
    numbers, values = np.arange(7.0), ValuesCodec(VALUES).encode(data=np.arange(float(VALUES)))
    used, begun, count = used_by(recorder), time.monotonic_ns(), 0
    deadline = begun
    while deadline - begun < seconds * 1e9:
        for codec, end in zip(codecs, ends, strict=True):
            end.handle.publish_raw(codec.encode(deadline, run_id, **dict.fromkeys(codec.fields, numbers)))
        for end in more:
            end.handle.publish_raw(values)
        count += 1
        deadline += 1_000_000
        sleep_until(deadline)
    lasted, used = (time.monotonic_ns() - begun) / 1e9, used_by(recorder) - used
    time.sleep(SETTLE)
    return {"published": count, "time": lasted, "used": used}


def wait_until_recording(progress: Any) -> None:
    """Until the recorder says that it is ready, and a while longer. Raises SystemExit if it never is."""
    end = time.monotonic() + 60.0
    while progress.handle.take_message(progress.msg_type, False) is None:
        if time.monotonic() > end:
            raise SystemExit("the recorder is not ready")
        time.sleep(0.01)
    time.sleep(SETTLE)


if __name__ == "__main__":
    print(json.dumps(source(float(sys.argv[1]), int(sys.argv[2]))), flush=True)
    os._exit(0)
