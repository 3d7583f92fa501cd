"""The rigid arm inside the world: against Pinocchio, and against the tables of the shipped arms."""

import numpy as np
import pinocchio
import pytest
from oracles.plant_runs import flywheel

from hd_control.core.errors import ConfigError
from hd_sim import _plant
from hd_sim.plant import Plant, make_kernel
from hd_sim.plant_config import PlantConfig

ARMS = ("arm_a", "arm_b", "arm_c", "single_joint_3", "single_joint_5")
GRAVITY = {
    "arm_a": [0, 503.1249, 51.6914, -32.6241, 1.1671, 5.9695, -1.6293],
    "arm_b": [0, -24.3693, -11.4020, -90.9979, -3.7046, -1.1185, -0.2686],
    "arm_c": [0, -72.95505, -1.51124, 9.09687, -0.41957, -2.52478, 0.11777],
}
DIAGONAL = {
    "arm_a": [63.9874, 83.2410, 64.3625, 21.1501, 1.9338, 0.9611, 0.4104],
    "arm_b": [3.9923, 75.3916, 73.4500, 23.6333, 2.8882, 1.2723, 0.4104],
    "arm_c": [1.67833, 7.75664, 0.89776, 1.37426, 0.05802, 0.06701, 0.0035],
}


@pytest.mark.parametrize("arm", ARMS)
def test_accelerations_agree_with_pinocchio(arm):
    """Relative to the largest acceleration: 1e-12 is rounding on badly conditioned poses."""
    config = PlantConfig.from_file(arm)
    kernel, n = make_kernel(config), config.joints
    model = config.robot.pinocchio_model()
    data, rng = model.createData(), np.random.default_rng(1)
    for _ in range(300):
        q, w, torque = rng.uniform(-3, 3, n), rng.uniform(-3, 3, n), rng.uniform(-100, 100, n)
        for armature in (np.zeros(n), rng.uniform(0, 1, n)):
            model.armature = armature
            expected = pinocchio.aba(model, data, q, w, torque)
            found = kernel.accelerate(q, w, torque, armature)[0]
            assert np.abs(found - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("arm", ARMS)
def test_inertia_and_bias_agree_with_pinocchio(arm):
    config = PlantConfig.from_file(arm)
    n, model = config.joints, config.robot.pinocchio_model()
    data, (q, w) = model.createData(), np.random.default_rng(2).uniform(-2, 2, (2, n))
    _, inertia, bias = make_kernel(config).accelerate(q, w, np.zeros(n), np.zeros(n))
    upper = pinocchio.crba(model, data, q)
    expected = np.triu(upper) + np.triu(upper, 1).T
    assert np.abs(inertia - expected).max() < 1e-12 * np.abs(expected).max()
    assert np.abs(bias - pinocchio.rnea(model, data, q, w, np.zeros(n))).max() < 1e-10


@pytest.mark.parametrize("arm", GRAVITY)
def test_tables_of_the_arms(arm):
    """Printed with four or five decimals."""
    config = PlantConfig.from_file(arm)
    zeros = np.zeros(7)
    _, inertia, bias = make_kernel(config).accelerate(config.start_position, zeros, zeros, zeros)
    assert bias == pytest.approx(GRAVITY[arm], abs=6e-5)
    assert np.diag(inertia) == pytest.approx(DIAGONAL[arm], abs=6e-5)


@pytest.mark.parametrize(("joint", "inertia", "gravity"), [(3, 40, 120), (4, 6, 40), (5, 1.5, 10), (7, 1, 4)])
def test_single_joint_rigs_follow_their_protocol(joint, inertia, gravity):
    """tau = J qdd - m g l sin q: the centre of mass stands above the axis at q = 0."""
    kernel = make_kernel(PlantConfig.from_file(f"single_joint_{joint}"))
    for q in (0.0, 0.4, -1.2):
        acceleration, found, bias = kernel.accelerate([q], [0.7], [5.0], [0.0])
        assert found[0, 0] == pytest.approx(inertia, rel=1e-12)
        assert bias[0] == pytest.approx(-gravity * np.sin(q), abs=1e-11)
        assert acceleration[0] == pytest.approx((5.0 + gravity * np.sin(q)) / inertia, rel=1e-11)


def test_start_is_an_equilibrium():
    """Started with gravity held by the springs and the holding command, an arm with friction does not ring."""
    plant = Plant(PlantConfig.from_file("arm_b"))
    hold = plant.gravity_torque(plant.config.start_position)
    begin = plant.true_joint_position
    assert begin == pytest.approx(plant.config.start_position, abs=1e-12)
    for _ in range(500):
        plant.step(hold)
    assert np.abs(plant.true_joint_position - begin).max() < 1e-9


def test_payload_is_a_mass_on_the_link():
    """Against Pinocchio with the mass appended to the link."""
    config = PlantConfig.from_file("arm_a")
    mass, at = 3.0, np.array([0.05, -0.02, 0.2])
    loads, centers = np.zeros(7), np.zeros((7, 3))
    loads[5], centers[5] = mass, at
    kernel = make_kernel(config.with_settings(payload_mass=loads, payload_center=centers))
    model = config.robot.pinocchio_model()
    model.inertias[6] = model.inertias[6] + pinocchio.Inertia(mass, at, np.zeros((3, 3)))
    q, w, torque = np.random.default_rng(3).uniform(-2, 2, (3, 7))
    expected = pinocchio.aba(model, model.createData(), q, w, torque)
    found = kernel.accelerate(q, w, torque, np.zeros(7))[0]
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_any_joint_count_up_to_eight():
    size = sum(max(1, field[1]) for field in _plant.BLOCKS["PlantParameters"])
    for joints in (0, 9):
        with pytest.raises(ValueError, match="1 to 8 joints"):
            _plant.Kernel(joints, np.zeros(size * joints), 1e-3, 1, 0, False, False, [0, 0, 0])
    assert Plant(flywheel()).joints == 1


@pytest.mark.parametrize(
    ("period", "substeps", "delay", "words"),
    [(2.5e-4, 5, 0, "whole number"), (1e-3, 0, 0, "whole"), (1e-3, 5, 17, "extra")],
)
def test_impossible_ticks_are_refused(period, substeps, delay, words):
    config = PlantConfig.from_file("arm_a")
    with pytest.raises(ConfigError, match=words):
        PlantConfig(config.robot, config.drives, config.start_position, period, substeps, delay)


def test_quarter_millisecond_ticks():
    """4 kHz with 20 substeps per ms is the same integration as 1 kHz with 20."""
    config = PlantConfig.from_file("arm_a")
    slow = Plant(PlantConfig(config.robot, config.drives, config.start_position, 1e-3, 20))
    fast = Plant(PlantConfig(config.robot, config.drives, config.start_position, 2.5e-4, 20))
    torque = slow.gravity_torque(config.start_position) * 1.2
    for _ in range(50):
        slow.step(torque)
    for _ in range(200):
        fast.step(torque)
    assert fast.time == pytest.approx(slow.time)
    assert fast.true_joint_position == pytest.approx(slow.true_joint_position, abs=1e-12)
