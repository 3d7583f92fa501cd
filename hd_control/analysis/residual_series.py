"""Residual channels as series for plotting tools: what is measured and what the model leaves, on the bag's clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hd_control.analysis.compare import ChannelComparison, compare, noises_of
from hd_control.analysis.joint_task import written_coefficients
from hd_control.analysis.link_function import LinkSide
from hd_control.analysis.signals import Recording
from hd_control.analysis.workbench import joint_task
from hd_control.core.arrays import FloatArray
from hd_control.drive.model import Model
from hd_control.record.series import topic_name

NS = 1_000_000_000
Comparisons = Mapping[str, Mapping[str, tuple[FloatArray, FloatArray, FloatArray]]]
"""Joint -> channel -> (time s, residual, measured), each (rows,) in the unit of the channel, NaN where unusable."""


def residual_series(comparisons: Comparisons, start_ns: int = 0) -> dict[str, tuple[NDArray[np.int64], FloatArray]]:
    """Series `measured/JOINT/CHANNEL` and `residual/JOINT/CHANNEL`; `start_ns`: stamp of time zero."""
    found = {}
    for joint, channels in comparisons.items():
        for channel, (time, residual, measured) in channels.items():
            stamps = start_ns + np.round(np.asarray(time) * NS).astype(np.int64)
            found[topic_name("measured", joint, channel)] = (stamps, np.asarray(measured, dtype=np.float64))
            found[topic_name("residual", joint, channel)] = (stamps, np.asarray(residual, dtype=np.float64))
    return found


def residual_pages(comparisons: Comparisons) -> dict[str, list[list[str]]]:
    """One page per joint; per channel the measured series over the residual."""
    return {
        joint: [[topic_name(kind, joint, channel)] for channel in channels for kind in ("measured", "residual")]
        for joint, channels in comparisons.items()
        if channels
    }


def channel_rows(
    recording: Recording, model: Model, joints: Sequence[str]
) -> Iterator[tuple[str, dict[str, tuple[FloatArray, FloatArray, FloatArray]]]]:
    """(joint, channel -> (time, residual of the model as written, measured)), joint by joint. Raises ConfigError."""
    side = LinkSide(model, recording.joints)
    for joint in joints:
        task = joint_task(recording, model, joint, side)
        noises = noises_of(task)
        dictionary = compare(task, None, noises).dictionary
        written = written_coefficients(dictionary, model.joint(joint), task.context)
        yield joint, {name: _rows(channel) for name, channel in compare(task, written, noises).channels.items()}


def _rows(channel: ChannelComparison) -> tuple[FloatArray, FloatArray, FloatArray]:
    residual = np.where(channel.used, channel.residual, np.nan)
    return channel.time, residual, np.where(channel.used, channel.measured, np.nan)
