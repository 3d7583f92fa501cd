"""Fusion, torque law and gate on a joint: the single-joint motions of Zhu, Table III, on an independent world.

Expected errors are those that were found for these constants (plausibility, not identification of the paper's
hardware); 10 % because one seed of noise is one seed.
"""

import math

import numpy as np
import pytest
from oracles import gate_law
from oracles.bristle_joint import BristleJoint, PendulumMotion, reference
from oracles.derivative import Derivative

from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws import fusion, torque
from hd_control.laws.calibration import joint_count, quantise
from hd_control.safety import gate as sg
from hd_control.safety import limits

T = 1e-3
JOINTS = {
    5: ({"N": 160.0, "k_f": 5e4, "I": 2.1, "kc": 3.2, "c": 0.4, "kv": 35.0, "g1": 1.5e-2, "g2": 8.75e-5, "J": 1.5,
         "mgl": 10.0}, (30, 100, 2000, 100), 0.1),
    7: ({"N": 160.0, "k_f": 2.6e4, "I": 1.0, "kc": 4.0, "c": 0.3, "kv": 25.0, "g1": 2.4e-2, "g2": 2.24e-4, "J": 1.0,
         "mgl": 4.0}, (30, 80, 2000, 50), 0.05),
}  # fmt: skip


class Chain:
    """Fusion, motion, torque law and gate of one joint, one sample of delay, the paper's tables."""

    def __init__(self, joint, **changes):
        self.plant_values, motion, self.noise = JOINTS[joint]
        name = f"joint_{joint}"
        values = load_params_file(config_path("torque_node.yaml"), "torque_node")
        start = {n: [0.0] * 7 for n in values if n.endswith("_initial") and not n.startswith("torsional")}
        zhu = {"rate_source": "plain", "adapt_friction": True, "adapt_compliance": True, "adaptation_scale": 1.0}
        values |= start | zhu | {"joints": [name], "compliance_derivative": "stiffness_only"} | changes
        self.error_filter = values["rate_source"] == "error_filter"
        self.torque_params = torque.configure(values, None, T)
        sensing = load_params_file(config_path("fusion_node.yaml"), "fusion_node")
        self.fusion_params = fusion.configure(fusion.PARAMETERS.select(sensing, [name]), None, T)
        bounds = load_params_file(config_path("limits.yaml"), "limits")
        self.limits = limits.configure_gate(limits.GATE_PARAMETERS.select(bounds, [name]), T)
        self.states = [fusion.initial_state(self.fusion_params), torque.initial_state(self.torque_params)]
        self.gate = gate_law.activate(sg.initial_gate_state(1), self.limits, np.zeros(1))
        self.samples = [fusion.new_sample(1), torque.new_sample(1), torque.new_reference(1)]
        self.motion = PendulumMotion(self.plant_values["J"], self.plant_values["mgl"], *motion)
        self.error_rate = Derivative(0.8, T)

    def command(self, k, plant, noise, qd, qd_v, qd_a):
        raw, sample, ref = self.samples
        raw.motor_shaft_position = quantise(self.plant_values["N"] * plant.phi, 2 * math.pi / 4000)
        raw.joint_position, raw.gauge_torque = quantise(plant.q, joint_count(16)), plant.torque() + noise
        seen, self.states[0] = fusion.step(self.fusion_params, self.states[0], raw, T)
        q, q_v = float(seen.joint_position[0]), float(seen.joint_velocity[0])
        error_rate = self.error_rate.step(qd - q)
        if self.error_filter:
            q_v = qd_v - error_rate
        ref.joint_torque_required = self.motion.step(q, q_v, qd, qd_v, qd_a, T)
        ref.desired_position, ref.desired_velocity = qd, qd_v
        for name in ("joint_position", "joint_velocity", "joint_torque", "motor_position", "motor_velocity"):
            sample.view(name)[...] = seen.view(name)
        output, self.states[1] = torque.step(self.torque_params, self.states[1], sample, ref, T)
        out, self.gate, faults = sg.safety_gate(
            output.motor_torque.copy(), np.zeros(1), np.full(1, float(k)), self.limits, self.gate
        )
        assert faults == [] and out[0] == output.motor_torque[0], "healthy control passes the gate untouched"
        return float(out[0])


def largest_error(joint, frequency, amplitude, adapt_links=True, **changes):
    """max |q_d - q| over the last three of twelve periods, rad."""
    chain, noise = Chain(joint, **changes), np.random.default_rng(0)
    if not adapt_links:
        chain.motion.rho = [0.0, 0.0, 0.0]
    plant, held, worst = BristleJoint(chain.plant_values), 0.0, 0.0
    ticks = round(12 / frequency / T)
    for k in range(ticks):
        qd, qd_v, qd_a = reference(k * T, amplitude, frequency)
        new = chain.command(k, plant, chain.noise * noise.standard_normal(), qd, qd_v, qd_a)
        plant.advance(held, T)
        held = new
        if k >= ticks - round(3 / frequency / T):
            worst = max(worst, abs(reference((k + 1) * T, amplitude, frequency)[0] - plant.q))
    return worst


@pytest.mark.parametrize(
    ("joint", "frequency", "amplitude", "source", "error"),
    [(7, 5.0, 0.015, "plain", 1.67e-3), (7, 5.0, 0.015, "error_filter", 6.6e-4), (5, 2.0, 0.02, "plain", 6.6e-4)],
)
def test_tracking_error_of_table_3(joint, frequency, amplitude, source, error):
    assert largest_error(joint, frequency, amplitude, rate_source=source) == pytest.approx(error, rel=0.1)


def test_adaptation_is_worth_something():
    """No friction estimate and nothing adapted: joint 5 at 2 Hz has 1.1e-3 rad instead of 6.6e-4."""
    held = largest_error(5, 2.0, 0.02, adapt_links=False, adapt_friction=False, adapt_compliance=False)
    assert held == pytest.approx(1.1e-3, rel=0.1)
