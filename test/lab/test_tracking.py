"""Tracking from recordings, and its picture."""

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.core.errors import BagError
from hd_control.lab.page.model_figures import tracking_figure
from hd_control.lab.page.style import POINTS, thinned
from hd_control.lab.signals.tracking import Tracking, tracking_of
from hd_control.record.reader import BagReader
from hd_control.record.schema import joint_state_codec
from hd_control.record.writer import BagWriter

NAMES = ("joint_1", "joint_2")
TICK = 1_000_000


def _bag(path, reference_ticks, measured_ticks, names=NAMES):
    """Reference k, k and measurement k + 0.5, k - 0.25 at tick k."""
    with BagWriter(path, live=False) as bag:
        for topic, ticks, offset in (
            ("joint_reference", reference_ticks, [0.0, 0.0]),
            ("joint_states", measured_ticks, [0.5, -0.25]),
        ):
            codec = joint_state_codec(topic, NAMES if topic == "joint_reference" else names)
            rows = np.add.outer(np.asarray(ticks, dtype=float), offset)
            arrays = {name: rows for name in codec.fields}
            bag.write_columns(topic, codec, np.asarray(ticks) * TICK, frame_id="0" * 16, **arrays)
    return BagReader(path)


def test_only_ticks_with_both_ends_count(tmp_path):
    tracking = tracking_of(_bag(tmp_path / "bag", range(10), [0, 1, 4, 5, 6, 20]))
    np.testing.assert_array_equal(tracking.stamps_ns, np.array([0, 1, 4, 5, 6]) * TICK)
    assert tracking.maximum() == {"joint_1": 0.5, "joint_2": 0.25}
    assert tracking.rms() == {"joint_1": 0.5, "joint_2": 0.25}
    assert tracking.within(TICK, 4 * TICK).stamps_ns.size == 2


def test_joints_are_matched_by_name(tmp_path):
    tracking = tracking_of(_bag(tmp_path / "bag", range(5), range(5), names=("joint_2", "joint_1")))
    assert tracking.maximum() == {"joint_1": 0.25, "joint_2": 0.5}


def test_a_bag_without_a_reference_says_so(tmp_path):
    with BagWriter(tmp_path / "bag", live=False) as bag:
        codec = joint_state_codec("resolver", NAMES)
        bag.write_columns("resolver", codec, [0], frame_id="0" * 16, position=[[1.0, 2.0]])
    with pytest.raises(BagError, match="no joint_reference"):
        tracking_of(BagReader(tmp_path / "bag"))


def test_thinning_keeps_the_extremes():
    series = np.zeros(100_000)
    series[[12_345, 77_777]] = [3.0, -2.0]
    kept = thinned(series)
    assert kept.size <= POINTS and series[kept].max() == 3.0 and series[kept].min() == -2.0
    np.testing.assert_array_equal(thinned(np.arange(5.0)), np.arange(5))


def test_the_figure_draws_motion_and_error_of_every_joint():
    error = np.array([[0.0, 0.0], [1e-3, -2e-3]])
    figure = tracking_figure(Tracking(NAMES, np.array([0, TICK]), np.deg2rad(error * 1e4), error), "run")
    assert [trace.name for trace in figure.data] == ["joint_1", "joint_1", "joint_2", "joint_2"]
    np.testing.assert_allclose(figure.data[1].y, [0.0, 1.0])
    np.testing.assert_allclose(figure.data[2].y, [0.0, -20.0])


def test_info_prints_the_tracking(tmp_path, capsys):
    _bag(tmp_path / "bag", range(10), range(10))
    assert main(["info", str(tmp_path / "bag"), "--tracking"]) == 0
    assert "joint_2: rms 250.0000 mrad, largest 250.0000 mrad" in capsys.readouterr().out
