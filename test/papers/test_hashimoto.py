"""hd reproduce hashimoto: targets, the sensor against closed forms, torque control against formula (20)."""

import math

import numpy as np
import pytest

from hd_control.laws.calibration import bridge_gain, misalignment_ripple
from hd_control.papers import hashimoto
from hd_control.papers import hashimoto_sensor as sensor
from hd_control.papers.hashimoto_runs import TorqueExperiment, half_width, run, step_figures, wave_figures
from hd_control.papers.rows import load_constants

CONTRACT = (
    "gauge_gain", "misalignment_2deg", "half_width", "rise_time", "steady_state_error", "20hz.amplitude",
    "20hz.phase_deg",
)  # fmt: skip


@pytest.fixture(scope="module")
def quick():
    return {row.id: row for row in hashimoto.rows(True, 0, print, seeds=1)}


def test_every_target_is_met(quick):
    assert all(f"hashimoto.{name}" in quick for name in CONTRACT)
    with_target = [row for row in quick.values() if row.target is not None]
    assert len(with_target) == 7
    assert all(row.met for row in with_target), [row.id for row in with_target if not row.met]


def test_improved_rows_are_one_set_of_values():
    first, *others = ({**hashimoto_values(motion)} for motion in ("static", "step", "wave"))
    assert all(other == first for other in others)


def hashimoto_values(motion):
    from hd_control.papers.hashimoto_runs import law_values

    return law_values(load_constants("hashimoto"), TorqueExperiment(motion, "improved"))


def test_bridge_gain_by_quadrature_is_formula_8():
    c = load_constants("hashimoto")
    names = ("gauge_factor", "supply_voltage", "thickness", "inner_radius", "outer_radius")
    formula = bridge_gain(*(c[name] for name in names), c["shear_modulus"])
    assert sensor.gain(sensor.bridge(rated=False)) == pytest.approx(formula, rel=1e-7)


@pytest.mark.parametrize("degrees", [-3.0, 0.5, 2.0, 5.0])
def test_exact_bridge_has_the_ripple_of_10_to_12(degrees):
    c, off = load_constants("hashimoto"), math.radians(degrees)
    bridge = sensor.bridge(misalignment=off)
    parts = misalignment_ripple(off, c["modulation_strain"], c["rated_strain"], c["rated_torque"])
    seen = bridge.output(0.0 * sensor.ANGLES, sensor.ANGLES) / sensor.gain(bridge)
    wanted = parts[0] * np.cos(2 * sensor.ANGLES) + parts[1] * np.sin(2 * sensor.ANGLES)
    np.testing.assert_allclose(seen, wanted, atol=1e-6)


def test_ripple_does_not_depend_on_the_torque():
    bridge = sensor.bridge(misalignment=math.radians(2.0))
    empty, loaded = (bridge.output(level + 0.0 * sensor.ANGLES, sensor.ANGLES) for level in (0.0, 40.0))
    difference = loaded - empty
    assert np.ptp(difference) < 1e-6 * difference.mean()


def test_fourth_harmonic_stays_and_a_second_bridge_takes_it():
    one, two = (sensor.bridge(place=place, fourth_modulation=5e-6) for place in (0.0, math.pi / 4))
    assert sensor.ripple_percent(one) == pytest.approx(2.5, rel=1e-6)
    assert sensor.averaged_percent(one, two) < 1e-6


def test_temperature_bridge_is_better_than_one_gauge_and_the_drift_takes_the_rest():
    for seed in range(5):
        alone, bridge, corrected = sensor.warm_percent(seed)
        assert alone > 1.2 * bridge > 100.0 * corrected


def test_static_loop_without_noise_is_formula_20(quick):
    width, _ = half_width(run(TorqueExperiment("static", "paper")))
    assert width == pytest.approx(quick["hashimoto.half_width.formula"].ours, rel=2e-3)
    assert half_width(run(TorqueExperiment("static", "open")))[0] == pytest.approx(4.0, abs=0.01)


def test_step_figures_of_a_known_response():
    result = run(TorqueExperiment("step", "open"))
    rise, left, over = step_figures(result)
    shown = result.torque[result.time >= 0.1]
    assert left == pytest.approx(100.0 * (shown[-600:].mean() / 5.0 - 1.0), abs=1e-6)
    assert over == pytest.approx(100.0 * (shown.max() / shown[-600:].mean() - 1.0), abs=1e-3)
    assert 10.0 < rise < 25.0


def test_wave_figures_of_a_known_wave():
    from dataclasses import replace

    result = run(TorqueExperiment("wave", "paper"))
    w = 2 * math.pi * 20.0
    known = replace(result, torque=4.0 * np.sin(w * result.time - math.radians(30.0)) + 0.7)
    ratio, phase, _ = wave_figures(known)
    assert (ratio, phase) == pytest.approx((0.8, -30.0), rel=1e-6)


def test_a_run_repeats_and_another_seed_differs():
    first = run(TorqueExperiment("step", noise_seed=3)).torque
    run.cache_clear()
    np.testing.assert_array_equal(first, run(TorqueExperiment("step", noise_seed=3)).torque)
    assert not np.array_equal(first, run(TorqueExperiment("step", noise_seed=4)).torque)


def test_quick_figures_have_series():
    found = hashimoto.figures(True, 0, print)
    assert len(found) == 3 and all(len(figure.data) >= 4 for _, figure in found)
