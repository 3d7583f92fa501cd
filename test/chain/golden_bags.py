"""Small recordings of the runner that guard the laws: `python test/chain/golden_bags.py` writes them anew.

They change only with an intended change of a law, and the commit that changes them says which.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from hd_control.core.parameters import params_text
from hd_control.laws.trajectory import quintic_move
from hd_sim.plant_config import PlantConfig
from hd_sim.recording import RunRecording
from hd_sim.runner import Runner, RunSetup

FOLDER = Path(__file__).resolve().parents[2] / "bags" / "golden"
START_TICK = 20
KINEMATIC = {"kinematic_cosine_4": [4.9e-5] * 7, "kinematic_sine_2": [2.909e-4] * 7, "kinematic_feedforward": True}
CASES: dict[str, tuple[str, int, dict[str, dict[str, object]]]] = {
    "adaptive_arm": ("arm_a", 180, {}),
    "adaptive_joint": (
        "single_joint_3", 150,
        {
            "torque_node": {
                "compliance_derivative": "filtered", "rate_source": "plain", "adapt_compliance": True, **KINEMATIC,
            },
            "motion_node": {"rate_source": "plain", "link_adaptation": True},
            "fusion_node": {"gauge_gain": [1.02] * 7, "gauge_offset": [0.5] * 7, "gauge_cosine_2": [0.4] * 7,
                            "gauge_temperature_drift": [0.05] * 7, "joint_position_source": "complementary"},
        },
    ),
    "torque_feedback_joint": ("single_joint_5", 150, {"torque_node": {"law": "torque_feedback"}}),
    "integral_manifold_joint": (
        "single_joint_7", 150, {"torque_node": {"law": "integral_manifold", "rotor_coulomb": [3.0] * 7, **KINEMATIC}},
    ),
    "computed_torque_joint": (
        "single_joint_4", 150, {"torque_node": {"law": "direct"}, "motion_node": {"law": "computed_torque"}},
    ),
}  # fmt: skip
"""Name: plant, ticks, parameters that are not as shipped."""


def a_goal(robot, start):
    """A fast small move of all joints, rad."""
    goal = quintic_move(robot.joint_names, start, start + 0.008 * (-1.0) ** np.arange(robot.joints), 0.1, "golden")
    return replace(goal, start_tick=START_TICK, times=np.round(goal.times, 9))


def record(path: Path, plant: str, ticks: int, values: dict[str, dict[str, object]]) -> Path:
    """One run of the runner as a bag, with its parameters."""
    config = PlantConfig.from_file(plant)
    setup = RunSetup(config, 4, values)
    runner = Runner(setup)
    with RunRecording(path, runner.robot, runner.period, {"period": repr(runner.period)}) as recording:
        for node, own in setup.all_values().items():
            recording.writer.attach(f"{node}.yaml", params_text(own), "application/yaml")
        for tick in range(ticks):
            if tick == 5:
                goal = a_goal(runner.robot, config.start_position)
                runner.offer(goal)
                recording.goal(tick, goal)
            recording.observe(tick, runner.step())
    assert not runner.world.seam.stopped
    return path


if __name__ == "__main__":
    for name, (plant, ticks, values) in CASES.items():
        target = (Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER) / name
        target.parent.mkdir(parents=True, exist_ok=True)
        print(record(target, plant, ticks, values))
