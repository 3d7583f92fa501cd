"""Calibration of a gauge bridge from a slow turn: right values within their errors, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from hd_control.core.errors import BagError
from hd_control.laws.calibration import GaugeModel, SlowTurn, fit_gauge, indicate

TRUE = GaugeModel(gain=0.97, offset=0.8, cosine_2=0.4, sine_2=-0.3, cosine_4=0.1, sine_4=0.05)
OLD = GaugeModel()


def turn(rng, *, speed=0.1, seconds=12.0, back=True, noise=0.1, load=8.0, friction=0.0, warm=None, model=TRUE):
    """There and back at constant speed through a load that follows the joint angle; N = 160, 1 kHz."""
    time = 1e-3 * np.arange(round(1e3 * seconds))
    direction = np.where(time < 0.5 * seconds, 1.0, -1.0) if back else np.ones_like(time)
    velocity = speed * direction
    position = np.cumsum(velocity) * 1e-3
    torque = 2.0 + load * np.sin(2.0 * position)
    angle = 160.0 * position
    seen = indicate(replace(model, offset_drift=0.0), torque + friction * direction, angle)
    if warm is not None:
        seen = seen + model.offset_drift * (warm(time) - model.reference_temperature)
    return SlowTurn(
        "joint_5", seen + noise * rng.standard_normal(time.size), torque, angle, velocity, 160.0 * velocity,
        None if warm is None else warm(time),
    )  # fmt: skip


def test_finds_every_parameter_within_its_error(rng):
    fit = fit_gauge(turn(rng), OLD)
    assert set(fit.errors) == {"gain", "offset", "cosine_2", "sine_2", "cosine_4", "sine_4"}
    for name, error in fit.errors.items():
        assert 0.0 < error < 0.02
        assert abs(getattr(fit.model, name) - getattr(TRUE, name)) < 4.0 * error, name
    assert fit.after == pytest.approx(0.1, rel=0.03) and fit.before > 0.5


def test_errors_are_honest_over_many_turns():
    """Deviations in units of the stated errors have a spread of about one."""
    scores = []
    for seed in range(60):
        fit = fit_gauge(turn(np.random.default_rng(seed)), OLD)
        scores += [(getattr(fit.model, name) - getattr(TRUE, name)) / error for name, error in fit.errors.items()]
    assert 0.8 < np.std(scores) < 1.35 and abs(np.mean(scores)) < 0.2


def test_bearing_friction_does_not_go_into_the_offset(rng):
    both = fit_gauge(turn(rng, friction=1.5), OLD)
    assert both.model.offset == pytest.approx(TRUE.offset, abs=0.02)
    one_way = fit_gauge(turn(rng, friction=1.5, back=False), OLD)
    assert any("one direction" in note for note in one_way.notes)


def test_a_drift_is_found_where_the_temperature_moves(rng):
    true = replace(TRUE, offset_drift=0.03, reference_temperature=25.0)
    old = replace(OLD, reference_temperature=25.0)
    fit = fit_gauge(turn(rng, seconds=20.0, warm=lambda t: 25.0 + 0.6 * t, model=true), old)
    assert fit.model.offset_drift == pytest.approx(0.03, abs=4.0 * fit.errors["offset_drift"])
    cool = fit_gauge(turn(rng, warm=lambda t: 25.0 + 0.1 * t, model=true), replace(old, offset_drift=0.03))
    assert "offset_drift" not in cool.errors and cool.model.offset_drift == 0.03
    assert any("drift kept" in note for note in cool.notes)


def test_parts_that_are_not_asked_for_stay(rng):
    fit = fit_gauge(turn(rng), replace(OLD, gain=0.97), ("ripple",))
    assert (fit.model.gain, fit.model.offset) == (0.97, 0.0)
    assert fit.model.cosine_2 == pytest.approx(0.4, abs=0.02)
    assert set(fit.errors) == {"cosine_2", "sine_2", "cosine_4", "sine_4"}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"speed": 0.001}, "wave generator turns .* a calibration needs 2 turns"),
        ({"speed": 0.5}, "rotor below 60 rad/s"),
        ({"seconds": 0.8, "speed": 0.3}, "calibration needs 2 turns and 1000 samples"),
        ({"load": 0.0}, "gain is not determined by this turn"),
        ({"load": 0.05}, "gain is not determined by this turn .* --only ripple offset"),
        ({"model": replace(TRUE, gain=-1.0)}, "gain of -1 is outside"),
    ],
)
def test_what_the_turn_does_not_determine_is_refused(rng, change, text):
    with pytest.raises(BagError, match=f"joint_5: .*{text}"):
        fit_gauge(turn(rng, **change), OLD)


def test_without_load_ripple_and_offset_are_still_determined(rng):
    fit = fit_gauge(turn(rng, load=0.0), replace(OLD, gain=TRUE.gain), ("ripple", "offset"))
    assert fit.model.offset == pytest.approx(TRUE.offset, abs=0.02)


def test_what_is_not_finite_is_refused(rng):
    broken = turn(rng)
    broken.torque[100] = np.nan
    with pytest.raises(BagError, match="not finite"):
        fit_gauge(broken, OLD)
