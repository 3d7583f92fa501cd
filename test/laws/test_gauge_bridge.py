"""Gauge bridge: ripple built here from strains (Hashimoto (3)-(13)), removed by correction and fusion law."""

import math

import numpy as np
import pytest

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import fusion
from hd_control.laws.calibration import GaugeModel, bridge_gain, correct, indicate, misalignment_ripple

PSI, RATED_STRAIN, RATED_TORQUE, GAUGE_FACTOR = 100e-6, 200e-6, 40.0, 2.1


def wheatstone(torque, beta, misalignment, fourth=0.0):
    """Indicated torque of an exact four-arm bridge: two gauge pairs, the second turned by 90 degrees + misalignment."""
    torsion = RATED_STRAIN * torque / RATED_TORQUE

    def modulation(angle):
        return 0.5 * (PSI * np.sin(2 * angle) + fourth * np.sin(4 * angle))

    pair_1, pair_2 = modulation(beta), modulation(beta - misalignment - math.pi / 2)
    r1, r2 = 1 + GAUGE_FACTOR * (torsion + pair_1), 1 + GAUGE_FACTOR * (-torsion - pair_1)
    r3, r4 = 1 + GAUGE_FACTOR * (torsion + pair_2), 1 + GAUGE_FACTOR * (-torsion - pair_2)
    ratio = 0.5 * ((r1 - r2) / (r1 + r2) + (r3 - r4) / (r3 + r4))
    return ratio * RATED_TORQUE / (GAUGE_FACTOR * RATED_STRAIN)


ANGLES = np.linspace(0, 2 * math.pi, 721)


@pytest.mark.parametrize(("degrees", "percent"), [(0.5, 0.218), (1, 0.436), (2, 0.8725), (5, 2.18)])
def test_ripple_of_misaligned_pairs(degrees, percent):
    """Half amplitude in percent of rated torque, Hashimoto (13); the formula for it and the bridge agree."""
    indicated = wheatstone(0.0, ANGLES, math.radians(degrees))
    assert 100 * np.abs(indicated).max() / RATED_TORQUE == pytest.approx(percent, rel=2e-3)
    cosine, sine = misalignment_ripple(math.radians(degrees), PSI, RATED_STRAIN, RATED_TORQUE)
    assert 100 * math.hypot(cosine, sine) / RATED_TORQUE == pytest.approx(percent, rel=2e-3)


@pytest.mark.parametrize("degrees", [0.0, 0.5, 2.0, -2.0, 5.0])
@pytest.mark.parametrize("torque", [-40.0, 0.0, 13.0, 40.0])
def test_the_correction_undoes_the_ripple(degrees, torque):
    cosine, sine = misalignment_ripple(math.radians(degrees), PSI, RATED_STRAIN, RATED_TORQUE)
    indicated = wheatstone(torque, ANGLES, math.radians(degrees))
    corrected = correct(GaugeModel(cosine_2=cosine, sine_2=sine), indicated, ANGLES)
    # the bridge is linear in strain up to rounding: (r1 - r2)/(r1 + r2) has an exact denominator of 2
    assert np.abs(corrected - torque).max() < 1e-11


def test_the_fourth_harmonic_is_not_cancelled_by_pairs_at_90_degrees():
    """5 microstrain leave 2.5 percent; the correction needs the fourth harmonic for it."""
    indicated = wheatstone(0.0, ANGLES, 0.0, fourth=10e-6)
    assert 100 * np.abs(indicated).max() / RATED_TORQUE == pytest.approx(2.5, rel=1e-3)
    model = GaugeModel(sine_4=0.025 * RATED_TORQUE)
    assert np.abs(correct(model, indicated, ANGLES)).max() < 1e-3


def test_indicate_and_correct_are_inverse():
    rng = np.random.default_rng(2)
    model = GaugeModel(0.93, 1.2, 0.3, -0.2, 0.1, 0.05, 0.02, 25.0)
    torque, beta = rng.normal(0, 30, 100), rng.uniform(-50, 50, 100)
    for temperature in (40.0, math.nan):
        assert np.allclose(
            correct(model, indicate(model, torque, beta, temperature), beta, temperature), torque, atol=1e-12
        )
    assert np.ptp(indicate(model, torque, beta, 40.0) - indicate(model, torque, beta)) < 1e-12
    assert indicate(model, 0.0, 0.0, 40.0) - indicate(model, 0.0, 0.0) == pytest.approx(15 * 0.02)


@pytest.mark.parametrize("turns", [0.0, 1.0, -1.0])
def test_the_fusion_law_gives_back_the_torque(turns):
    """Gauge fixed to the casing or turning with the joint, in both senses."""
    model = GaugeModel(0.93, 1.2, 0.3, -0.2, 0.1, 0.05, 0.02, 25.0)
    values = load_params_file(config_path("fusion_node.yaml"), "fusion_node") | {
        "gauge_gain": [model.gain] * 7,
        "gauge_offset": [model.offset] * 7,
        "gauge_cosine_2": [model.cosine_2] * 7,
        "gauge_sine_2": [model.sine_2] * 7,
        "gauge_cosine_4": [model.cosine_4] * 7,
        "gauge_sine_4": [model.sine_4] * 7,
        "gauge_temperature_drift": [model.offset_drift] * 7,
        "gauge_reference_temperature": [model.reference_temperature] * 7,
        "gauge_angle_offset": [0.4] * 7,
        "gauge_joint_turns": [turns] * 7,
    }
    params = fusion.configure(values, None, 1e-3)
    state, sample = fusion.initial_state(params), fusion.new_sample(7)
    rng = np.random.default_rng(3)
    for _ in range(50):
        torque, q, theta = rng.normal(0, 30, 7), rng.uniform(-3, 3, 7), rng.uniform(-300, 300, 7)
        sample.motor_shaft_position, sample.joint_position, sample.motor_temperature = theta, q, 31.0
        sample.gauge_torque = indicate(model, torque, theta - turns * q + 0.4, 31.0)
        output, state = fusion.step(params, state, sample, 1e-3)
        assert np.abs(output.joint_torque - torque).max() < 1e-11
        terms = model.gain * output.joint_torque + output.gauge_drift + output.gauge_ripple
        assert np.abs(terms - sample.gauge_torque).max() < 1e-11


def test_gain_of_hashimotos_bridge():
    gain = bridge_gain(2.1, 3.0, 0.39e-3, 15.8e-3, 24.85e-3, 8.3e10)
    assert 1e6 * gain == pytest.approx(50.74, abs=0.01)
