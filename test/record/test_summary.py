"""`hd info`: what it says agrees with what was put into the recording."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_bags import RUN, T0, TICK, file_of, write_bag

from hd_control.cli.main import main
from hd_control.core.topics import TICK_NS
from hd_control.record.cdr import TemperatureCodec
from hd_control.record.reader import BagReader
from hd_control.record.schema import joint_state_codec
from hd_control.record.summary import possible_channels, summarize
from hd_control.record.writer import BagWriter

ROTOR, JOINT, TORQUE, MOTOR = "motor_shaft_position", "joint_position", "joint_torque", "motor_torque"


def sine_bag(path, seconds=4.0, amplitude=0.5, frequency=0.5, ratio=100.0):
    """One joint on a sine: every range is known in closed form."""
    ticks = np.arange(round(seconds * 1000))
    keep = np.ones(len(ticks), bool)
    keep[1000:1010] = keep[2000] = False
    angle = amplitude * np.sin(2 * np.pi * frequency * ticks * 1e-3)
    with BagWriter(path, live=False) as bag:
        stamps = T0 + TICK * ticks
        for topic, values in (
            ("encoder", ratio * angle),
            ("resolver", angle),
            ("gauge_bridge", 20 * angle),
            ("motor_torque_applied", 30 * angle),
        ):
            codec = joint_state_codec(topic, ["elbow"])
            (field,) = codec.fields
            use = keep if topic == "resolver" else slice(None)
            bag.write_columns(topic, codec, stamps[use], frame_id=RUN, **{field: values[use, None]})
        for k in (0, 100):
            payload = TemperatureCodec("elbow").encode(T0 + k * TICK, "elbow", temperature=25.0 + k / 10)
            bag.write("motor_temperature", None, T0 + k * TICK, payload)
    return path


def test_ranges_of_a_sine_are_those_of_the_formula(tmp_path):
    document = summarize(BagReader(sine_bag(tmp_path / "bag")))
    elbow = document["joints"]["elbow"]
    assert elbow["channels"] == dict.fromkeys(("motor_torque", "transmission", "link_torque"), "measured")
    coverage = elbow["coverage"]
    # samples lie within half a tick of the peak: relative error below (2 pi f dt / 2)^2 / 2 < 2e-6
    assert coverage["angle"]["low"] == pytest.approx(-0.5, rel=2e-6)
    assert coverage["load"]["high"] == pytest.approx(10.0, rel=2e-6)
    assert coverage["wave_generator_turns"] == pytest.approx(100 * 1.0 / (2 * np.pi), rel=2e-6)
    # the mean slope over w = 20 ms of a sine is smaller by sinc(pi f w) = 1 - 1.6e-4
    assert coverage["speed"]["high"] == pytest.approx(0.5 * 2 * np.pi * 0.5, rel=3e-4)
    assert coverage["speed"]["reversals"] == 4
    assert coverage["temperature"] == {"low": 25.0, "high": 35.0, "unit": "°C"}


def test_gaps_and_rates(tmp_path):
    topics = summarize(BagReader(sine_bag(tmp_path / "bag")))["topics"]
    assert topics["/resolver"]["rate"] == pytest.approx(1000.0) and TICK == TICK_NS
    assert (topics["/resolver"]["gaps"], topics["/resolver"]["missing"]) == (2, 11)
    assert topics["/resolver"]["first_gaps"][0] == [T0 + 999 * TICK, T0 + 1010 * TICK, 10]
    assert (topics["/encoder"]["gaps"], topics["/encoder"]["missing"]) == (0, 0)


@pytest.mark.parametrize(
    ("signals", "channels"),
    [
        ((ROTOR, JOINT, TORQUE, MOTOR), {"motor_torque", "transmission", "link_torque"}),
        ((JOINT, TORQUE), {"link_torque"}),
        ((JOINT, MOTOR), {"motor_torque"}),
        ((ROTOR, TORQUE, MOTOR), {"motor_torque", "link_torque"}),
        ((ROTOR, JOINT, TORQUE), {"transmission", "link_torque"}),
        ((ROTOR, JOINT, MOTOR), {"motor_torque", "transmission"}),
        ((JOINT,), set()),
        ((ROTOR,), set()),
        ((), set()),
    ],
)
def test_signals_decide_the_channels(signals, channels):
    assert set(possible_channels(signals)) == channels


def test_command_on_a_whole_bag(tmp_path, capsys):
    bag, target = sine_bag(tmp_path / "bag"), tmp_path / "info.json"
    assert main(["info", str(bag), "--json", str(target)]) == 0
    text = capsys.readouterr().out
    assert "elbow" in text and "11 missing in 2 gaps" in text and "wave-generator turns" in text
    document = json.loads(target.read_text())
    assert document["schema"] == "hd.info/1" and document["complete"] is True
    assert main(["info", str(bag), "--quiet"]) == 0 and capsys.readouterr().out == ""


def test_command_on_a_cut_bag_says_so_and_exits_with_3(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", 20)
    file_of(bag).write_bytes(file_of(bag).read_bytes()[:-2000])
    assert main(["info", str(bag)]) == 3
    assert "!" in capsys.readouterr().out


def test_command_on_nothing_exits_with_2_and_one_line(tmp_path, capsys):
    assert main(["info", str(tmp_path / "nothing")]) == 2
    error = capsys.readouterr().err
    assert "no such bag" in error and error.count("\n") == 1


def test_bags_without_joint_signals_are_described(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("encoder")
    document = summarize(BagReader(tmp_path / "bag"))
    assert document["topics"]["/encoder"]["messages"] == 0 and document["joints"] == {} and document["complete"]
