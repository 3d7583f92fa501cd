"""One run of Gandhi and Ghorbel's experiment: the joint (8)-(10) under the composite law (26) or the plain one (31)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hd_control import _laws
from hd_control.core.arrays import FloatArray
from hd_control.core.blocks import Block
from hd_control.laws import integral_manifold as law
from hd_control.laws.calibration import joint_count, motor_count, quantise
from hd_control.papers.rows import Constants, load_constants
from hd_sim.paper_joints import GearJoint

PLANT = (
    *("rotor_inertia", "rotor_damping", "link_inertia", "link_damping", "gear_ratio", "stiffness_linear"),
    *("hysteresis_stiffness", "hysteresis_rate", "load_amplitude", "load_frequency"),
)
ABLATION = {"tau_0": "tau_0", "tau_1": "tau_1", "tau_2": "tau_2", "tau_4": "all"}
"""Terms of the law that are kept, one after the other."""
PERIODS = {"0p1ms": 1e-4, "0p2ms": 2e-4, "0p5ms": 5e-4, "1ms": 1e-3}
"""s, of the control."""
JOINT = "joint"
UNLIMITED = 1e9  # N m: the paper's motor has no limit
DRAWN = 1e-3  # s, between two rows of the series that are kept


@dataclass(frozen=True)
class Experiment:
    """What a run is made of. `law` and `plant` change single values, `period` is the law's in s (0: the plant's step).

    `nonlinear` adds cubic and quintic stiffness to the plant (C-2). `phase` rad turns the wave generator on its shaft;
    the law knows it. `sensors` starts two quantised encoders at these shares of a count; None reads the plant's state.
    With sensors the law takes rates through its error filter and the hysteresis from the wanted torque.
    """

    composition: str = "all"
    prediction: float = 0.5
    period: float = 0.0
    nonlinear: bool = False
    phase: float = 0.0
    law: tuple[tuple[str, float], ...] = ()
    plant: tuple[tuple[str, Any], ...] = ()
    sensors: tuple[float, float] | None = None


@dataclass(frozen=True)
class GearRun:
    """Series of one run, one row per ms; the motor's angles at the output side, rad, N m.

    `largest_deg` is the largest absolute joint error of all control samples of the steady state, degrees; not a number
    if the run diverged.
    """

    time: FloatArray
    reference: FloatArray  # (k, 8), the fields of ManifoldReference
    measured: FloatArray  # (k, 6), the fields of the torque law's sample
    wind_up: FloatArray
    largest_deg: float

    @property
    def error_deg(self) -> FloatArray:
        """Joint position minus reference, degrees."""
        return np.rad2deg(self.measured[:, 0] - self.reference[:, 0])

    @property
    def motor_error_deg(self) -> FloatArray:
        """Motor position / N minus reference, degrees: what the law makes the motor absorb."""
        return np.rad2deg(self.measured[:, 3] - self.reference[:, 0])


def reference(c: Constants, time: FloatArray) -> FloatArray:
    """The trajectory and load of section V with their derivatives, (k, 8), in the fields of ManifoldReference."""
    size, w = math.radians(c["reference_amplitude_deg"]), c["reference_frequency"]
    speed, load, v = math.radians(c["reference_speed_deg"]), c["load_amplitude"], c["load_frequency"]
    sine, cosine = size * np.sin(w * time), size * np.cos(w * time)
    push, pull = load * np.sin(v * time), load * np.cos(v * time)
    motion = (sine + speed * time, w * cosine + speed, -(w**2) * sine, -(w**3) * cosine, w**4 * sine)
    return np.stack((*motion, push, v * pull, -(v**2) * push), axis=1)


def turned(cosine: FloatArray, sine: FloatArray, phase: float) -> tuple[FloatArray, FloatArray]:
    """Fourier coefficients of the same series with `phase` rad added to its angle."""
    turn = np.arange(1, len(cosine) + 1) * phase
    return cosine * np.cos(turn) + sine * np.sin(turn), sine * np.cos(turn) - cosine * np.sin(turn)


def plant_values(c: Constants, experiment: Experiment) -> dict[str, Any]:
    """Constants of the plant (8)-(10)."""
    values = c.values(*PLANT, "kinematic_cosine", "kinematic_sine") | {"kinematic_phase": experiment.phase}
    for name in ("stiffness_cubic", "stiffness_quintic"):
        values[name] = c[name] if experiment.nonlinear else 0.0
    return values | dict(experiment.plant)


def law_values(c: Constants, experiment: Experiment) -> dict[str, Any]:
    """Parameters of the law: it knows the linear plant. The paper's kinematic error has the opposite sign of ours."""
    square = c["gear_ratio"] ** 2
    numbers = c.values("gear_ratio", "link_inertia", "link_damping", "hysteresis_stiffness", "hysteresis_rate")
    numbers |= c.values("perturbation_stiffness", "tracking_gain", "tracking_damping", "fast_damping_ratio")
    numbers |= {"rotor_inertia": square * c["rotor_inertia"], "rotor_damping": square * c["rotor_damping"]}
    numbers |= {"torsional_stiffness": c["stiffness_linear"], "motor_torque_limit": UNLIMITED}
    numbers |= {"stiffness_cubic": 0.0, "stiffness_quintic": 0.0, "rotor_coulomb": 0.0, "friction_speed": 1.0}
    numbers |= {"load_constant": 0.0, "load_cosine": 0.0, "load_sine": 0.0}
    series = turned(np.array(c["kinematic_cosine"]), np.array(c["kinematic_sine"]), experiment.phase)
    for kind, column in zip(("cosine", "sine"), series, strict=True):
        numbers |= {f"kinematic_{kind}_{n}": -float(value) for n, value in enumerate(column, 1)}
    numbers |= dict(experiment.law)
    values: dict[str, Any] = {name: [float(number)] for name, number in numbers.items()}
    values |= {"joint_names": [JOINT], "composition": experiment.composition, "load_source": "position"}
    choices = ("plain", "measured") if experiment.sensors is None else ("error_filter", "wanted")
    values |= {"rate_source": choices[0], "hysteresis_source": choices[1], "derivative_cutoff": c["rate_cutoff"]}
    return values | {"prediction_samples": experiment.prediction}


class Sensors:
    """Two quantised encoders and the filtered differences of their readings, as the law of a real joint gets them.

    `place` (2,) is where the counts of joint and motor begin, as a share of a count. The torque is not read.
    """

    def __init__(self, c: Constants, period: float, place: FloatArray, joint: FloatArray) -> None:
        self.counts = (joint_count(c["joint_sensor_bits"]), motor_count(c["encoder_counts"], c["gear_ratio"]))
        self.place, self.period = place, period
        self.pole = _laws.derivative_pole(c["rate_cutoff"], period)
        self.sample = Block(law.new_sample(1).layout, joint.copy())
        self.seen: list[float] = []
        self.rates = [0.0, 0.0]

    def read(self, joint: FloatArray) -> Block:
        """The sample (6,) behind the plant's `joint` (6,)."""
        rows = zip((joint[0], joint[3]), self.counts, self.place, strict=True)
        seen = [float(quantise(angle + share * count, count)) - share * count for angle, count, share in rows]
        steps = zip(seen, self.seen or seen, self.rates, strict=True)
        a, dt = self.pole, self.period  # D(x)[k] = a D(x)[k-1] + (1 - a)(x[k] - x[k-1])/dt
        self.rates = [a * rate + (1.0 - a) * ((now - before) / dt) for now, before, rate in steps]
        self.seen = seen
        self.sample.array[[0, 3]], self.sample.array[[1, 4]] = seen, self.rates
        return self.sample


@lru_cache(maxsize=64)
def run(experiment: Experiment) -> GearRun:
    """Simulates the experiment. The load is known to the law, as in the paper."""
    c = load_constants("gandhi")
    step, period = c["plant_step"], experiment.period or c["plant_step"]
    substeps, samples = round(period / step), round(c["duration"] / period)
    params = law.configure(law_values(c, experiment), None, period)
    joint, state = GearJoint(plant_values(c, experiment)), law.initial_state(params)
    wanted, output = law.new_reference(1), law.layout("ManifoldOutput", 1).zeros()
    time = np.arange(samples) * period
    rows, measured, wind = reference(c, time), np.empty((samples, 6)), np.empty(samples)
    true = Block(law.new_sample(1).layout, joint.measured)
    eyes = None if experiment.sensors is None else Sensors(c, period, np.array(experiment.sensors), joint.measured)
    for k in range(samples):
        measured[k] = joint.measured
        wanted.array[:] = rows[k]
        sample = true if eyes is None else eyes.read(joint.measured)
        law.step_in_place(params, state, sample, wanted, output, period)
        wind[k] = joint.wind_up
        joint.advance(output.array[0], step, substeps)
    steady = time >= c["steady_from"]
    largest = float(np.rad2deg(np.abs(measured[steady, 0] - rows[steady, 0]).max()))
    keep = slice(None, None, max(1, round(DRAWN / period)))
    shown = (time[keep], rows[keep].copy(), measured[keep].copy(), wind[keep].copy())
    return GearRun(*shown, largest if math.isfinite(largest) else math.nan)
