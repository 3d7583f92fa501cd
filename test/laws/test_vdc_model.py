"""The link model of virtual decomposition control against Pinocchio, explicit matrices and finite differences."""

import numpy as np
import pinocchio
import pytest
from chains import pinocchio_chain, random_robot
from oracles import vdc_numpy as oracle

from hd_control import _laws
from hd_control.core.robot import Robot
from hd_control.laws import motion
from hd_control.laws.motion import rigid_torque


def _state(random, joints, count=4):
    return [random.uniform(-1.5, 1.5, joints) for _ in range(count)]


def test_equal_rates_give_the_inverse_dynamics_of_200_random_chains():
    """q'_r = q'. 1e-9 N m: the papers' check reached 4.5e-13 at torques up to 659 N m."""
    random = np.random.default_rng(1)
    worst = largest = 0.0
    for _ in range(200):
        robot = random_robot(random)
        model = pinocchio_chain(robot)
        q, v, a = _state(random, 7, 3)
        expected = pinocchio.rnea(model, model.createData(), q, v, a)
        worst = max(worst, np.abs(rigid_torque(robot, q[None], v[None], a[None])[0] - expected).max())
        largest = max(largest, np.abs(expected).max())
    assert largest > 100.0
    assert worst < 1e-11


def _explicit(robot, q, v, v_r, a_r):
    """Torque from M, C and G of every link, and the motions."""
    motions = oracle.link_motions(robot.rotation, robot.origin, q, v, v_r, a_r)
    wrenches = []
    for j, (X, Xr, dXr, g, *_) in enumerate(motions):
        M, C, G = oracle.explicit_matrices(robot.mass[j], robot.center_of_mass[j], robot.inertia[j], X[3:], g)
        wrenches.append(M @ dXr + C @ Xr + G)
    return oracle.torques(motions, wrenches), motions


def test_required_rates_that_differ_agree_with_explicit_matrices():
    random = np.random.default_rng(2)
    for _ in range(50):
        robot = random_robot(random)
        q, v, v_r, a_r = _state(random, 7)
        expected, _ = _explicit(robot, q, v, v_r, a_r)
        found = rigid_torque(robot, q[None], v[None], a_r[None], v_r[None])[0]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)  # rounding at some 100 N m
        crossed = rigid_torque(robot, q[None], v[None], a_r[None])[0]
        assert np.abs(crossed - expected).max() > 1e-3, "the case must separate required from actual rates"


def test_coriolis_matrix_is_skew_symmetric():
    """C + C^T = 0 makes the velocity terms workless; the stability proof needs it."""
    random = np.random.default_rng(3)
    robot = random_robot(random)
    for j in range(7):
        _, C, _ = oracle.explicit_matrices(
            robot.mass[j], robot.center_of_mass[j], robot.inertia[j], random.normal(size=3), np.zeros(3)
        )
        np.testing.assert_allclose(C + C.T, 0.0, atol=1e-13)


@pytest.mark.parametrize("index", range(13))
def test_torque_is_linear_in_each_parameter_with_the_regressor_column(index):
    """One unit parameter at a time against the 6 x 13 matrix, on one link of a chain of three."""
    random = np.random.default_rng(100 + index)
    robot = random_robot(random, 3)
    q, v, v_r, a_r = _state(random, 3)
    for link in range(3):
        theta = np.zeros((3, 13))
        theta[link, index] = 1.0
        found = _laws.batch_torque(3, robot.rotation, robot.origin, 9.81, theta, q, v, v_r, a_r)[0]
        motions = oracle.link_motions(robot.rotation, robot.origin, q, v, v_r, a_r)
        wrenches = [oracle.regressor(*m[:4]) @ t for m, t in zip(motions, theta, strict=True)]
        np.testing.assert_allclose(found, oracle.torques(motions, wrenches), rtol=0, atol=1e-12)


def _params(robot):
    block = motion.layout("MotionParams", robot.joints).zeros()
    block.rotation, block.origin, block.gravity = robot.rotation.reshape(-1, 9), robot.origin, 9.81
    block.link_parameters = robot.link_parameters()
    return block


def test_adaptation_drive_is_the_transposed_regressor_times_the_velocity_difference():
    random = np.random.default_rng(4)
    for _ in range(30):
        robot = random_robot(random)
        q, v, v_r, a_r = _state(random, 7)
        found = _laws.parameter_drive(7, _params(robot).array, q, v, v_r, a_r)
        motions = oracle.link_motions(robot.rotation, robot.origin, q, v, v_r, a_r)
        expected = [oracle.regressor(X, Xr, dXr, g).T @ (Xr - X) for X, Xr, dXr, g, *_ in motions]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_virtual_power_flow_balances_for_any_motion_and_any_estimate():
    """Sum (X_r-X)^T M d(X_r-X) = sum (q'_r-q')(tau_r-tau) + sum (theta-theta_hat)^T psi, with compiled torques."""
    random = np.random.default_rng(5)
    for _ in range(50):
        robot = random_robot(random)
        q, v, v_r, a_r = _state(random, 7)
        a = random.uniform(-5, 5, 7)
        theta = robot.link_parameters()
        estimate = theta * random.uniform(0.5, 1.5, theta.shape)
        tau = rigid_torque(robot, q[None], v[None], a[None])[0]
        tau_r = _laws.batch_torque(7, robot.rotation, robot.origin, 9.81, estimate, q, v, v_r, a_r)[0]
        psi = _laws.parameter_drive(7, _params(robot).array, q, v, v_r, a_r)
        actual = oracle.link_motions(robot.rotation, robot.origin, q, v, v, a)
        required = oracle.link_motions(robot.rotation, robot.origin, q, v, v_r, a_r)
        stored = 0.0
        for j in range(7):
            M, _, _ = oracle.explicit_matrices(robot.mass[j], robot.center_of_mass[j], robot.inertia[j], v[:3], q[:3])
            stored += (required[j][1] - actual[j][1]) @ M @ (required[j][2] - actual[j][2])
        supplied = (v_r - v) @ (tau_r - tau) + np.sum((theta - estimate) * psi)
        assert abs(stored - supplied) < 1e-9


def test_derivative_of_the_required_velocity_agrees_with_finite_differences():
    """d(X_r)/dt along q(t), q'_r(t), through the torque of unit masses: central differences, error about h^2."""
    random = np.random.default_rng(6)
    robot, h = random_robot(random), 1e-5
    for _ in range(10):
        q, v, v_r, a, a_r = _state(random, 7, 5)

        def required(t, q=q, v=v, v_r=v_r, a=a, a_r=a_r):
            at = (q + v * t + a * t * t / 2, v + a * t, v_r + a_r * t, a_r)
            return oracle.link_motions(robot.rotation, robot.origin, *at)

        now, later, before = required(0.0), required(h), required(-h)
        for j in range(7):
            np.testing.assert_allclose((later[j][1] - before[j][1]) / (2 * h), now[j][2], rtol=0, atol=1e-7)


def test_shipped_arms_carry_their_tabulated_gravity_torque():
    pose = np.array([[0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3]])
    still = np.zeros((1, 7))
    found = rigid_torque(Robot.from_file("arm_a"), pose, still, still)[0]
    np.testing.assert_allclose(found, [0, 503.1249, 51.6914, -32.6241, 1.1671, 5.9695, -1.6293], atol=6e-5)
