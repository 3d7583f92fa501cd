"""The compiled stages against plain re-statements, bit for bit: whole runs with odd numbers, new models, resets."""

from dataclasses import replace

import numpy as np
import pytest
from bits import seeds
from shadow import Shadow

from hd_control.core.errors import GoalError
from hd_control.core.faults import FaultCode
from hd_control.core.parameters import params_text
from hd_control.core.resources import config_path
from hd_control.core.strict_yaml import load_params_file
from hd_control.laws.trajectory import quintic_move
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

SENSORS = ("motor_shaft_position", "joint_position", "gauge_torque")
INPUTS = {
    "fusion": SENSORS,
    "motion": ("joint_position", "joint_velocity"),
    "torque": ("joint_position", "joint_velocity", "joint_torque", "motor_position", "motor_velocity", "motor_torque"),
}
AT_BOUND = {"torque_node": {"coulomb_torque_high": [21.6, 21.6, 21.6, 3.6, 2.88, 2.88, 3.6]}}
"""The estimate of Coulomb friction starts at its bound."""
RATES = {
    "torque_node": {"rate_source": "error_filter"},
    "motion_node": {"rate_source": "plain", "link_adaptation": True},
}
QUICK = {
    "recover_samples": 40, "reset_samples": 30, "frozen_samples": 12, "rail_samples": 6, "adaptation_time": 0.02,
    "residual_limit": [0.2] * 7, "ripple_limit": [2.0] * 7, "rate_excess_limit": 4,
}  # fmt: skip
"""Limits that are met within a short life."""


def odd(random, value, last):
    """A number that no sensor should give, or one that only just may."""
    choices = (np.nan, np.inf, -np.inf, 0.0, 1e9, last, value + 0.5, value - 1e-3, 1.01 * value, 650.0)
    return choices[random.integers(len(choices))]


class Spoiler:
    """Puts odd numbers into what the stages read: single ones, and runs of a sensor that stands or drifts."""

    def __init__(self, random, share):
        self.random, self.share, self.runs, self.kept = random, share, {}, {}

    def __call__(self, stage, tick):
        name, random = stage.wiring.name, self.random
        for field in INPUTS[name]:
            values = stage.sample.view(field)
            last = self.kept.get((name, field), values).copy()
            if random.random() < self.share[name]:
                j = random.integers(values.size)
                values[j] = odd(random, values[j], last[j])
            if random.random() < 0.05 * self.share[name]:
                kind = random.choice(["stand", "drift", "rail"])
                self.runs[name, field] = int(random.choice([3, 6, 25, 60])), kind, last
            count, kind, start = self.runs.get((name, field), (0, "", values))
            if count:
                values[:] = {"stand": start, "drift": values + 0.002 * count, "rail": np.full(values.size, 620.0)}[kind]
                self.runs[name, field] = count - 1, kind, start
            self.kept[name, field] = values.copy()
        if name == "fusion" and random.random() < self.share[name]:
            warm = stage.sample.motor_temperature
            j, choices = random.integers(warm.size), [np.nan, 1e4, -300.0, 150.0, warm[0] + 0.5, warm[0] - 3.0, np.inf]
            warm[j] = choices[random.integers(len(choices))]
        if name == "torque" and random.random() < 0.003:  # the drive obeys somebody else for a while
            self.runs[name, "motor_torque"] = 16, "rail", values
        if name == "torque" and random.random() < 5.0 * self.share[name]:
            odd_ticks = [np.nan, -1.0, tick - 1, tick - 9, tick - 10, tick + 1]
            stage.input_ticks[random.integers(4)] = random.choice(odd_ticks)


OFFSETS = {"gauge_offset": 5.0, "kinematic_sine": 1e-5, "kinematic_cosine": 1e-5, "friction_offset_initial": 0.3}


def changed(stage, random):
    """Parameters of a stage with some numbers changed by up to a fifth."""
    params = stage.params.copy()
    fields = {
        "fusion": ("torsional_stiffness", "gauge_gain", "gauge_offset", "kinematic_sine"),
        "motion": ("position_gain", "velocity_gain"),
        "torque": ("motor_velocity_gain", "torque_gain", "coulomb_torque_initial", "friction_offset_initial",
                   "load_friction_linear", "kinematic_cosine", "rotor_coulomb", "feedback_friction"),
    }[stage.wiring.name]  # fmt: skip
    for field in fields:
        if field in params.layout.slices and random.random() < 0.6:
            view = params.view(field)
            view[...] = view * random.uniform(0.8, 1.2, view.shape) + OFFSETS.get(field, 0.0) * random.normal()
    return params


def act_upon(shadow, runner, random):
    """Now and then one of the things that other threads ask for."""
    if random.random() < 0.004:
        name = ("fusion", "motion", "torque")[random.integers(3)]
        shadow.adopt(name, changed(shadow.stages[name], random))
    if random.random() < (0.01 if runner.torque.guard.stopped else 0.001):
        shadow.ask_reset("motion" if random.random() < 0.5 else "torque")
    if random.random() < 0.0005:
        shadow.throw()
    if random.random() < 0.0005:
        shadow.restart()
    if random.random() < 0.006 and runner.motion.follower is not None:
        offer(runner, random)


def offer(runner, random):
    """A small move, now or somewhat later; a goal that is refused is none."""
    start = runner.motion.follower.at(runner.motion.tick).position
    end = start + random.uniform(-0.15, 0.15, start.size)
    goal = quintic_move(runner.robot.joint_names, start, end, random.uniform(0.1, 0.4))
    try:
        runner.offer(replace(goal, start_tick=runner.tick + int(random.choice([0, 0, 1, 40, 200]))))
    except GoalError:
        return


def live(seed, plant, ticks, share, **values):
    """A random life of a robot with its oracles beside it; the shadow at its end."""
    random = np.random.default_rng([seed, 0x57A6E])
    runner = Runner(RunSetup(PlantConfig.from_file(plant), seed, values))
    shadow = Shadow(runner, Spoiler(random, share))
    while runner.tick < ticks:
        act_upon(shadow, runner, random)
        runner.step()
        if random.random() < 0.003:
            runner.tick += int(random.choice([1, 1, 2, 3, 9, 10]))  # samples that never came
        if runner.torque.guard.stopped and random.random() < 0.005:
            repair(shadow, runner)
    assert shadow.ticks > 2.5 * ticks, "every stage was compared in nearly every tick"
    return shadow


def repair(shadow, runner):
    """The robot as after a long rest on its brakes: a reset would now be granted."""
    guard, oracle = runner.torque.guard, shadow.oracles["torque"].guard
    guard.state.healthy, oracle.healthy = 1e4, 10_000
    for gate in (guard.gate, oracle.gate):
        gate.last_torque = 0.0
    shadow.ask_reset("motion")
    shadow.ask_reset("torque")


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """A limits file with limits that are met soon."""
    path = tmp_path_factory.mktemp("limits") / "quick.yaml"
    path.write_text(params_text({**load_params_file(config_path("limits.yaml"), "limits"), **QUICK}))
    return str(path)


CALM = {"fusion": 0.0005, "motion": 0.0, "torque": 0.0002}
WILD = {"fusion": 0.02, "motion": 0.002, "torque": 0.002}
"""Share of samples with an odd number, by stage."""
OFTEN = {FaultCode.FRAME_LOST, FaultCode.NOT_FINITE, FaultCode.SPIKE, FaultCode.RATE_LIMITED, FaultCode.NODE_KILLED,
         FaultCode.TEMPERATURE_BAD, FaultCode.NOT_OBEYED}  # fmt: skip
"""What a few lives cannot miss."""


@pytest.mark.parametrize(
    ("plant", "values"),
    [
        ("single_joint_3", AT_BOUND),
        ("single_joint_5", RATES),
        ("single_joint_7", {"torque_node": {"law": "integral_manifold"}}),
        ("single_joint_4", {"torque_node": {"law": "torque_feedback"}}),
        ("arm_a", AT_BOUND),
    ],
    ids=["adaptive", "other_rates", "integral_manifold", "torque_feedback", "arm"],
)
def test_a_random_life_is_that_of_the_oracles_bit_for_bit(plant, values, quick):
    lives = [live(seed, plant, 1200, share, limits={"file": quick}, **values)
             for seed in seeds(2) for share in (CALM, WILD)]  # fmt: skip
    modes, codes = (set().union(*(getattr(each, name) for each in lives)) for name in ("modes", "codes"))
    assert modes >= {"ACTIVE", "DEGRADED", "HOLDING", "STOPPED"} and codes >= OFTEN or len(lives) < 4
    assert all(sum(each.resets[name] for each in lives) > 4 for name in ("motion", "torque")) or len(lives) < 4


def test_a_hold_after_slow_motion_begins_anew():
    """Each end of a slow motion puts the path off by a fraction of a tick, also one that holds."""
    runner = Runner(RunSetup(PlantConfig.from_file("single_joint_3")))

    def slow_often(stage, tick):
        if stage.wiring.name == "motion":
            stage.controller_mode = "DEGRADED" if tick % 30 < 7 and tick < 300 else "ACTIVE"

    shadow = Shadow(runner, slow_often)
    for tick in range(330):
        if tick > 320:
            shadow.ask_reset("motion")
        runner.step()
    assert shadow.oracles["motion"].aborted_goals == 0 and shadow.oracles["motion"].resets == 9
