"""Recordings as real robots give them: rates, signals, and what happens to torque and angle."""

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_sim.puzzles.real_like import (
    ANGLES,
    RATES,
    SIGNALS,
    TORQUES,
    draw_features,
    make_real_like_pair,
    spoil,
    spoilt_angle,
    spoilt_torque,
)

TIME = np.arange(20_000) * 1e-3
TORQUE = 10.0 * np.sin(2.0 * np.pi * 0.3 * TIME) + 4.0


def features(**changes):
    plain = {"torque": "white", "torque_noise": 1e-6, "torque_corner": 5.0, "repeats": 3, "angle": "plain"}
    rest = {"angle_noise": 1e-5, "vibration": 20.0, "rate": 200, "signals": "all", "temperature": True}
    return {**plain, **rest, **changes}


def spoilt(kind, step=1, **changes):
    return spoilt_torque(TORQUE, features(torque=kind, **changes), np.random.default_rng(0), step)


def delay_of(values):
    """Samples by which the sine comes late."""
    turn = np.exp(-2j * np.pi * 0.3 * TIME[3000:13_000])
    shift = np.angle((turn @ TORQUE[3000:13_000]) / (turn @ values[3000:13_000]))
    return shift / (2.0 * np.pi * 0.3) * 1e3


def test_noise_has_its_size_and_its_colour():
    for kind in ("white", "coloured"):
        noise = spoilt(kind, torque_noise=0.02) - TORQUE
        neighbours = float(np.corrcoef(noise[1:], noise[:-1])[0, 1])
        assert np.std(noise) == pytest.approx(0.02 * np.std(TORQUE), rel=0.03)
        assert (neighbours > 0.9) is (kind == "coloured") and (abs(neighbours) < 0.03) is (kind == "white")


def test_smoothing_is_late_or_not():
    corner = 5.0
    late = (
        1e3 * np.sqrt(2.0) / (2.0 * np.pi * corner)
    )  # group delay of a second-order Butterworth filter at low frequency
    assert delay_of(spoilt("smoothed_causal")) == pytest.approx(late, rel=0.02)
    assert delay_of(spoilt("smoothed_zero_phase")) == pytest.approx(0.0, abs=0.05)
    assert delay_of(spoilt("averaged", step=11)) == pytest.approx(5.0, abs=0.05)


def test_repeated_samples_stand_still():
    values = spoilt("repeated", step=5)[::5]
    assert np.count_nonzero(np.diff(values)) == pytest.approx(values.size / 3, abs=2)


def test_a_vibration_has_one_frequency():
    shaken = spoilt_angle(20_000, features(angle="vibrating"), np.random.default_rng(1))
    spectrum = np.abs(np.fft.rfft(shaken)) ** 2
    frequency = np.fft.rfftfreq(20_000, 1e-3)
    assert np.std(shaken) == pytest.approx(1e-5) and np.sum(frequency * spectrum) / spectrum.sum() == pytest.approx(
        20.0, 0.1
    )
    assert not np.any(spoilt_angle(100, features(), np.random.default_rng(1)))


@pytest.mark.parametrize("signals", SIGNALS)
def test_only_the_chosen_signals_are_stored_at_the_chosen_rate(signals):
    columns = {name: np.arange(1000.0) for name in (*SIGNALS["all"], "time", "reference_position", "temperature")}
    found = spoil(columns, features(signals=signals, temperature=False), 100.0, 1, 0)
    assert set(found) == {"time", "reference_position", *SIGNALS[signals]}
    assert all(column.size == 200 for column in found.values()) and found["time"][1] == 5.0


def test_the_motor_angle_shakes_by_the_gear_ratio():
    columns = {name: np.zeros(1000) for name in (*SIGNALS["all"], "time", "reference_position", "temperature")}
    found = spoil(columns, features(angle="noisy", rate=1000), 80.0, 1, 0)
    assert found["motor_shaft_position"] == pytest.approx(80.0 * found["joint_position"])


def test_a_seed_draws_everything_and_repeats():
    drawn = [draw_features(seed) for seed in range(200)]
    for key, values in (("torque", TORQUES), ("angle", ANGLES), ("rate", RATES), ("signals", SIGNALS)):
        assert {one[key] for one in drawn} == set(values)
    pair, again = make_real_like_pair(3, "one"), make_real_like_pair(3, "one")
    assert pair.case == again.case and pair.case.world == "real_like" and len(pair.case.names) == 1
    assert "visibility" not in pair.truth["joints"]["joint_1"] and pair.case.step == ""
    assert pair.period == 1.0 / pair.case.features["rate"]
    assert all(np.array_equal(pair.fit[name], again.fit[name]) for name in pair.fit)
    with pytest.raises(ConfigError, match="nothing or one effect"):
        make_real_like_pair(3, "poor")
