"""How far parameters may go while the law runs (HD-F21): counted from the activation, in shares of the joint's limits.

At both ends of every reach a moving joint stays below its velocity limit, stopped or not.
"""

import math

import pytest

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, LiveReach, Parameter, ParameterSet, Shape, live_scale
from hd_control.laws import fusion, motion, torque
from hd_control.laws.trajectory import sine_goal
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup

LAWS = {"fusion_node": fusion, "motion_node": motion, "torque_node": torque}
LIVE = [
    (node, p)
    for node, law in LAWS.items()
    for p in law.PARAMETERS.parameters
    if p.change is Change.HOT and p.kind is float
]
IDS = [f"{node}-{p.name}" for node, p in LIVE]


def setup_of(plant, law="adaptive"):
    return RunSetup(PlantConfig.from_file(plant), 1, {"torque_node": {"law": law}})


def reach_of(setup, node):
    robot = setup.config.robot
    return LiveReach(setup.node_values(node), robot.effort_limit.tolist(), robot.velocity_limit.tolist())


@pytest.mark.parametrize(("node", "parameter"), LIVE, ids=IDS)
def test_every_live_number_has_a_reach_around_its_shipped_value(node, parameter):
    setup = setup_of("arm_a")
    assert parameter.live is not None and parameter.live != (1.0, 0.0)
    reach, value = reach_of(setup, node), setup.node_values(node)[parameter.name]
    for joint, start in enumerate(value if parameter.shape is Shape.PER_JOINT else [value]):
        low, high = reach.bounds(parameter, joint)
        assert low <= start <= high and math.isfinite(high - low)
        assert low < high or start == 0.0, "a number of the unit of a torque may leave zero"
    assert reach.problems(parameter, value) == []


@pytest.mark.parametrize(
    ("node", "name", "value"),
    [
        ("torque_node", "motor_velocity_gain", 1e12),
        ("torque_node", "friction_offset_high", 1e9),
        ("torque_node", "friction_offset_low", -1e9),
        ("torque_node", "torsional_compliance_high", 1.0),
        ("fusion_node", "gauge_offset", -1e4),
        ("motion_node", "integral_high", 1e6),
    ],
)
def test_f21_a_legal_value_that_throws_a_moving_arm_needs_inactive(node, name, value):
    setup, law = setup_of("arm_a"), LAWS[node].PARAMETERS
    before = setup.node_values(node)
    after = {**before, name: [value if joint == 6 else old for joint, old in enumerate(before[name])]}
    assert law.refusal(before, after, 7, active=False, reach=reach_of(setup, node)) == ""
    said = law.refusal(before, after, 7, active=True, reach=reach_of(setup, node))
    assert said.startswith(f"HD-F21 param_moving {law.owner}: {name}[6]: {value:g} is outside [")
    assert "while active" in said and f"{name}[5]" not in said


GAIN = Parameter("gain", "a gain", "1/s", shape=Shape.PER_JOINT, change=Change.HOT, live=(2.0, 0.0))
OFFSET = Parameter("offset", "an offset", "N m", shape=Shape.PER_JOINT, change=Change.HOT, live=(1.0, 0.1))
SCALE = Parameter("scale", "a factor", change=Change.HOT, live=(4.0, 0.5))
FREE = Parameter("free", "anything", change=Change.HOT)
SET = ParameterSet("law", (GAIN, OFFSET, SCALE, FREE))
START = {"gain": [10.0, -10.0], "offset": [0.0, 5.0], "scale": 2.0, "free": 0.0}
REACH = LiveReach(START, [100.0, 40.0], [2.0, 4.0])


def test_the_reach_of_a_factor_and_of_a_share():
    assert [REACH.bounds(GAIN, joint) for joint in (0, 1)] == [(5.0, 20.0), (-20.0, -5.0)]
    assert [REACH.bounds(OFFSET, joint) for joint in (0, 1)] == [(-10.0, 10.0), (1.0, 9.0)]
    assert REACH.bounds(SCALE, 0) == (0.0, 8.5)
    assert REACH.problems(FREE, 1e300) == []


@pytest.mark.parametrize(
    ("change", "good"),
    [
        ({"gain": [20.0, -5.0]}, True),
        ({"gain": [20.1, -5.0]}, False),
        ({"gain": [4.9, -5.0]}, False),
        ({"offset": [-10.0, 9.0]}, True),
        ({"offset": [0.0, 9.1]}, False),
        ({"scale": 8.5}, True),
        ({"scale": -0.1}, False),
        ({"free": 1e300}, True),
    ],
)
def test_both_ends_belong_to_the_reach(change, good):
    assert (SET.refusal(START, {**START, **change}, 2, True, REACH) == "") is good


def test_many_small_changes_go_no_further_than_one():
    now = dict(START)
    for _ in range(20):
        after = {**now, "gain": [1.3 * gain for gain in now["gain"]]}
        now = now if SET.refusal(now, after, 2, True, REACH) else after
    assert now["gain"][0] == pytest.approx(10.0 * 1.3**2)


def test_what_is_out_of_reach_already_may_stay_beside_another_change():
    now = {**START, "gain": [50.0, -10.0]}
    assert SET.refusal(now, {**now, "scale": 3.0}, 2, True, REACH) == ""


def test_shares_of_a_joint_by_unit():
    assert live_scale("N m", 300.0, 3.0) == 300.0 and live_scale("N m s", 300.0, 3.0) == 100.0
    assert live_scale("1/(N m)", 300.0, 3.0) == 1.0 / 300.0 and live_scale("1/(N m)^2", 300.0, 3.0) == 300.0**-2
    assert live_scale("N m/K", 300.0, 3.0) == 3.0 and live_scale("rad", 300.0, 3.0) == 1.0


def fastest(plant, law, node, parameter, end):
    """Largest speed, rad/s, of a joint that follows a sine while one parameter goes to an end of its reach; None: the
    values do not fit together."""
    setup = setup_of(plant, law)
    runner, reach = Runner(setup), reach_of(setup, node)
    runner.run_on(200)
    runner.offer(sine_goal(runner.robot.joint_names, runner.torque.sample.joint_position.copy(), 0.1, 1.0, 2))
    runner.run_on(400)
    lowest = math.nextafter(parameter.low, math.inf) if parameter.open_low else parameter.low
    value = min(max(reach.bounds(parameter, 0)[end], lowest), parameter.high)
    stage, values = dict(runner.stages)[node], setup.node_values(node)
    wanted = {**values, parameter.name: [value] if parameter.shape is Shape.PER_JOINT else value}
    try:
        stage.adopt(stage.prepare(wanted))
    except ConfigError:
        return None
    found = 0.0
    for _ in range(100):
        runner.run_on(10)
        found = max(found, abs(float(runner.world.seam.plant.state.joint_velocity[0])))
    return found


USED = {
    "adaptive": IDS,
    "integral_manifold": ["torque_node-kinematic", "torque_node-rotor"],
    "torque_feedback": ["torque_node-feedback"],
}
RUNS = [
    (plant, law, node, parameter)
    for plant in ("single_joint_3", "single_joint_7")
    for law, heads in USED.items()
    for node, parameter in LIVE
    if any(f"{node}-{parameter.name}".startswith(head) for head in heads)
]


@pytest.mark.parametrize(
    ("plant", "law", "node", "parameter"), RUNS, ids=[f"{plant}-{law}-{p.name}" for plant, law, _, p in RUNS]
)
def test_f21_a_moving_joint_stays_below_its_velocity_limit_at_both_ends(plant, law, node, parameter):
    limit = float(PlantConfig.from_file(plant).robot.velocity_limit[0])
    speeds = [fastest(plant, law, node, parameter, end) for end in (0, 1)]
    assert all(speed is None or speed < limit for speed in speeds), speeds
