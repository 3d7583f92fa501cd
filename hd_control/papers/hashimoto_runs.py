"""One run of Hashimoto's torque control: the one-link arm (15)-(17) under the law (19) or with the motor alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.laws import torque_feedback as law
from hd_control.papers.rows import Constants, load_constants
from hd_sim.paper_joints import OneLinkArm

JOINT = "joint"
UNLIMITED = 1e9  # N m: the paper gives no limit
Motion = Literal["static", "step", "wave"]
Variant = Literal["open", "paper", "integral", "improved"]
"""Motor alone; the law (19); with an integral term; with integral term and part of the friction fed forward."""


@dataclass(frozen=True)
class TorqueExperiment:
    """What a run is made of. `noise_seed` None leaves the gauge without noise."""

    motion: Motion
    variant: Variant = "paper"
    locked: bool = True
    noise_seed: int | None = None


@dataclass(frozen=True)
class TorqueRun:
    """Series of one run, one row per control sample; `torque` is the true joint torque, N m."""

    time: FloatArray
    required: FloatArray
    required_rate: FloatArray
    torque: FloatArray


def required_torque(c: Constants, experiment: TorqueExperiment) -> FloatArray:
    """T_d with two derivatives, (k, 3). A step is not differentiated; a sine is, in closed form."""
    period = c["period"]
    if experiment.motion == "step":
        rows = np.zeros((round(1.0 / period), 3))
        rows[round(0.1 / period) :, 0] = c["step_amplitude"]
        return rows
    static = experiment.motion == "static"
    frequency = c["static_frequency"] if static else c["wave_frequency"]
    size = c["static_amplitude"] if static else c["wave_amplitude"]
    time = np.arange(round((c["static_cycles"] / frequency if static else 1.5) / period)) * period
    w = 2.0 * math.pi * frequency
    wave = size * np.stack((np.sin(w * time), w * np.cos(w * time), -(w**2) * np.sin(w * time)), axis=1)
    return np.asarray(wave)


def rotor_inertia(c: Constants) -> float:
    """J = N^2 J_M, kg m^2 at the output side."""
    return float(c["gear_ratio"] ** 2 * c["rotor_inertia"])


def arm(c: Constants, locked: bool) -> OneLinkArm:
    """The plant at rest."""
    values: dict[str, Any] = c.values("stiffness", "coulomb_torque", "presliding_distance", "bristle_damping")
    values |= {"rotor_inertia": rotor_inertia(c), "link_inertia": 0.0 if locked else c["link_inertia"]}
    return OneLinkArm(values | {"viscous": 0.0})


def law_values(c: Constants, experiment: TorqueExperiment) -> dict[str, Any]:
    """Parameters of the law for one variant."""
    improved = experiment.variant == "improved"
    numbers = c.values("feedback_proportional", "feedback_rate", "feedback_integral_limit", "feedback_friction_rate")
    numbers |= {"torsional_stiffness": c["stiffness"], "rotor_inertia": rotor_inertia(c)}
    numbers |= {"motor_torque_limit": UNLIMITED, "link_inertia": 0.0 if experiment.locked else c["link_inertia"]}
    numbers["feedback_integral"] = c["feedback_integral"] if experiment.variant in ("integral", "improved") else 0.0
    numbers["feedback_friction"] = c["friction_share"] * c["coulomb_torque"] if improved else 0.0
    values: dict[str, Any] = {name: [float(number)] for name, number in numbers.items()}
    return values | {"joint_names": [JOINT], "setpoint_kick": False, "torque_rate_cutoff": c["torque_rate_cutoff"]}


@lru_cache(maxsize=64)
def run(experiment: TorqueExperiment) -> TorqueRun:
    """Simulates the experiment. The command waits `command_delay` samples; the link stands still if it is locked."""
    c = load_constants("hashimoto")
    period, step = c["period"], c["plant_step"]
    rows = required_torque(c, experiment)
    samples, substeps = len(rows), round(period / step)
    noise = np.zeros(samples)
    if experiment.noise_seed is not None:
        noise = c["gauge_noise"] * np.random.default_rng(experiment.noise_seed).standard_normal(samples)
    params, plant = law.configure(law_values(c, experiment), None, period), arm(c, experiment.locked)
    state, output = law.initial_state(params), law.layout("FeedbackOutput", 1).zeros()
    sample, wanted = law.new_sample(1), law.new_reference(1)
    torque, motor = np.empty(samples), np.zeros(samples + c["command_delay"])
    for k in range(samples):
        torque[k] = plant.measured[2]
        sample.joint_torque = torque[k] + noise[k]
        wanted.array[:] = rows[k]
        law.step_in_place(params, state, sample, wanted, output, period)
        motor[k + c["command_delay"]] = rows[k, 0] if experiment.variant == "open" else output.array[0]
        plant.advance(motor[k], step, substeps)
    return TorqueRun(np.arange(samples) * period, rows[:, 0], rows[:, 1], torque)


def half_width(result: TorqueRun) -> tuple[float, float]:
    """Half the width of the static loop in its middle, and the largest error anywhere, N m; first cycle left out.

    The middle is the required torque below `static_range`; a branch is averaged over bins of `static_bin`.
    """
    c = load_constants("hashimoto")
    last = slice(len(result.time) // c["static_cycles"], None)
    required, error = result.required[last], (result.torque - result.required)[last]
    edges = np.arange(-c["static_range"], c["static_range"] + 0.5 * c["static_bin"], c["static_bin"])
    place = np.digitize(required, edges)
    up, inside = result.required_rate[last] > 0.0, range(1, len(edges))
    branches = [np.array([error[(place == k) & side].mean() for k in inside]) for side in (up, ~up)]
    return float(np.abs(branches[0] - branches[1]).max() / 2.0), float(np.abs(error).max())


def step_figures(result: TorqueRun) -> tuple[float, float, float]:
    """Rise time 10-90 % of the run's own final value in ms, final error in % of the step, overshoot in %."""
    start = int(np.argmax(result.required != 0.0))
    final = float(result.torque[-len(result.time) // 3 :].mean())
    share = result.torque[start:] / final
    times = []
    for level in (0.1, 0.9):
        k = int(np.argmax(share >= level))
        times.append(result.time[k] - (share[k] - level) / (share[k] - share[k - 1]) * result.time[1])
    return 1e3 * (times[1] - times[0]), 100.0 * (final / result.required[-1] - 1.0), 100.0 * (share.max() - 1.0)


def wave_figures(result: TorqueRun) -> tuple[float, float, float]:
    """Amplitude ratio, phase in degrees (positive: ahead) and largest error in N m at the wave's frequency."""
    w = 2.0 * math.pi * load_constants("hashimoto")["wave_frequency"]
    settled = result.time >= result.time[-1] - 1.0 + 0.5 * result.time[1]
    turn = np.exp(-1j * w * result.time[settled])
    ratio = complex((result.torque[settled] * turn).sum() / (result.required[settled] * turn).sum())
    error = float(np.abs(result.torque - result.required)[settled].max())
    return abs(ratio), math.degrees(math.atan2(ratio.imag, ratio.real)), error
