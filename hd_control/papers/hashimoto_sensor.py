"""Hashimoto's torque sensor: the bridge from geometry, what the wave generator leaves in it, temperature, and motion.

The world is an exact Wheatstone bridge (hd_sim/paper_joints.py); the way back to the torque is the fusion law's
(hd_control/laws/calibration.py).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.laws.calibration import GaugeModel, correct, misalignment_ripple
from hd_control.papers.hashimoto_runs import arm
from hd_control.papers.rows import Constants, load_constants
from hd_sim.paper_joints import Diaphragm, GaugeBridge

ANGLES: FloatArray = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)


def constants() -> Constants:
    """The paper's numbers."""
    return load_constants("hashimoto")


def diaphragm() -> Diaphragm:
    """The flexspline of section III-B."""
    c = constants()
    return Diaphragm(**c.values("thickness", "inner_radius", "outer_radius", "shear_modulus"))


def bridge(*, rated: bool = True, **changes: Any) -> GaugeBridge:
    """The bridge with `rated_strain` at rated torque (typical, says the paper), or the diaphragm's own strain."""
    c = constants()
    strain = c["rated_strain"] / c["rated_torque"] if rated else diaphragm().gauge_strain(1.0)
    parts = (c["gauge_factor"], c["gauge_resistance"], c["supply_voltage"], strain, c["modulation_strain"])
    return GaugeBridge(*parts, **changes)


def gain(sensor: GaugeBridge) -> float:
    """Output per torque, V/(N m): the slope between minus and plus the rated torque, mean over a turn."""
    most = constants()["rated_torque"]
    ends = [float(sensor.output(np.array(sign * most), ANGLES).mean()) for sign in (-1.0, 1.0)]
    return float((ends[1] - ends[0]) / (2.0 * most))


def nonlinearity(sensor: GaugeBridge) -> float:
    """Largest distance from the straight line over the rated range, as a share of the rated output."""
    most = constants()["rated_torque"]
    torque = np.linspace(-most, most, 81)
    output = sensor.output(torque, np.zeros_like(torque))
    line = np.polynomial.Polynomial.fit(torque, output, 1)
    return float(np.abs(output - line(torque)).max() / (gain(sensor) * most))


def ripple_percent(sensor: GaugeBridge, one_pair: bool = False) -> float:
    """What one turn of the wave generator does without torque, amplitude in % of the rated torque."""
    read = sensor.one_pair if one_pair else sensor.output
    voltage = read(np.zeros_like(ANGLES), ANGLES)
    scale = gain(sensor) * (0.5 if one_pair else 1.0)
    return float(100.0 * np.abs(voltage - voltage.mean()).max() / (scale * constants()["rated_torque"]))


def averaged_percent(sensor: GaugeBridge, other: GaugeBridge) -> float:
    """The ripple of the mean of two bridges, in % of the rated torque."""
    voltage = 0.5 * (sensor.output(0.0 * ANGLES, ANGLES) + other.output(0.0 * ANGLES, ANGLES))
    return float(100.0 * np.abs(voltage - voltage.mean()).max() / (gain(sensor) * constants()["rated_torque"]))


def corrected_percent(misalignment: float) -> float:
    """Ripple that stays of a misaligned bridge after the fusion law's correction with the formula (9)-(13)."""
    c, sensor = constants(), bridge(misalignment=misalignment)
    indicated = sensor.output(0.0 * ANGLES, ANGLES) / gain(sensor)
    parts = misalignment_ripple(misalignment, c["modulation_strain"], c["rated_strain"], c["rated_torque"])
    model = GaugeModel(cosine_2=parts[0], sine_2=parts[1])
    return float(100.0 * np.abs(correct(model, indicated, ANGLES)).max() / c["rated_torque"])


def spread(seed: int) -> tuple[float, float, float, float]:
    """Apparent strain per kelvin of the four gauges of one bridge."""
    c = constants()
    numbers = c["apparent_strain"] + c["apparent_spread"] * np.random.default_rng(seed).standard_normal(4)
    return (float(numbers[0]), float(numbers[1]), float(numbers[2]), float(numbers[3]))


def warm_percent(seed: int) -> tuple[float, float, float]:
    """Zero error after `warming`, % of the rated torque: one gauge, the bridge, the bridge with a fitted drift.

    The drift is fitted at half the warming, without torque, and used by the fusion law at the full one.
    """
    c, strains = constants(), spread(seed)
    sensor = bridge(apparent_strain=strains)
    per_torque = gain(sensor)

    def zero(warming: float) -> float:
        return float(sensor.output(np.array(0.0), np.array(0.0), warming)) / per_torque

    model = GaugeModel(offset=zero(0.0), offset_drift=(zero(0.5 * c["warming"]) - zero(0.0)) / (0.5 * c["warming"]))
    left = correct(model, zero(c["warming"]), 0.0, model.reference_temperature + c["warming"])
    alone = c["gauge_factor"] * c["supply_voltage"] * strains[0] * c["warming"] / 4.0 / per_torque
    scale = 100.0 / c["rated_torque"]
    return scale * abs(alone), scale * abs(zero(c["warming"])), scale * abs(float(left))


def moving_joint(misalignment: float) -> dict[str, FloatArray]:
    """Fig. 14: a step of the joint angle under a position law at the motor; the sensor's torque beside the true one.

    N m over s.
    """
    c, sensor = constants(), bridge(misalignment=misalignment)
    plant, period, scale = arm(c, locked=False), c["period"], gain(sensor)
    samples, substeps = round(1.5 / period), round(period / c["plant_step"])
    time, true, seen = np.arange(samples) * period, np.empty(samples), np.empty(samples)
    position = np.empty(samples)
    for k in range(samples):
        position[k], _, true[k], motor, rate, _ = plant.measured
        seen[k] = float(sensor.output(true[k], c["gear_ratio"] * motor)) / scale
        wanted = c["joint_step"] if time[k] >= 0.1 else 0.0
        plant.advance(
            c["joint_proportional"] * (wanted - position[k]) - c["joint_rate"] * rate, c["plant_step"], substeps
        )
    return {"time": time, "true": true, "sensor": seen, "position": position}


def pulse() -> dict[str, FloatArray]:
    """Fig. 13: rectangular motor torque on the locked link; true torque and what the 2 degree sensor shows, N m."""
    c, sensor = constants(), bridge(misalignment=math.radians(2.0))
    plant, period, scale = arm(c, locked=True), c["period"], gain(sensor)
    samples, substeps = round(1.0 / period), round(period / c["plant_step"])
    time, true, seen = np.arange(samples) * period, np.empty(samples), np.empty(samples)
    for k in range(samples):
        true[k] = plant.measured[2]
        seen[k] = float(sensor.output(true[k], c["gear_ratio"] * plant.measured[3])) / scale
        plant.advance(0.5 * c["rated_torque"] if 0.1 <= time[k] < 0.5 else 0.0, c["plant_step"], substeps)
    return {"time": time, "true": true, "sensor": seen}
