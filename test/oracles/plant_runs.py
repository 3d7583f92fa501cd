"""Plants, torque profiles and energy books for the tests of the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio

from hd_control.core.robot import Robot
from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig

ORDERS = np.arange(1, 5)

FLYWHEEL = """<robot name="flywheel"><link name="base"/><link name="wheel"><inertial><mass value="1.0"/>
<inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint_1" type="continuous"><parent link="base"/><child link="wheel"/><axis xyz="0 0 1"/></joint></robot>"""

REVOLUTE = FLYWHEEL.replace('type="continuous"', 'type="revolute"').replace(
    "<axis", '<limit lower="-9" upper="9" velocity="9" effort="9"/><axis'
)


def arm_c(substeps_per_ms: int, scheme: str = "reversals_resolved") -> PlantConfig:
    """The plant of the integrator tests."""
    return replace(PlantConfig.from_file("arm_c"), substeps_per_ms=substeps_per_ms, scheme=scheme)


def flywheel(inertia: float = 1.0, **settings) -> PlantConfig:
    """One CSF-20 joint about a vertical axis without gravity; friction, noise, kinematic error as given, else none."""
    single = PlantConfig.from_file("single_joint_7")
    none = dict.fromkeys(
        "friction_offset load_friction_linear load_friction_quadratic hysteresis_stiffness hysteresis_rate gauge_noise "
        "kinematic_cosine kinematic_sine coulomb_torque viscous_positive viscous_negative current_time_constant "
        "resolver_bits encoder_counts".split(),
        0.0,
    )
    config = replace(single, robot=Robot.from_urdf(REVOLUTE.format(inertia)))
    return config.with_settings(**{**none, "stribeck_ratio": 1.0, **settings})


def start_on_spring(plant: Plant) -> None:
    """Arm C's documented start: rotors at the pose, torsion gravity over m1, links from the kinematic error, h = 0."""
    config, state = plant.config, plant.state.copy()
    p, pose = config.drives, config.start_position
    gravity = pinocchio_gravity(config, pose)
    angle = np.outer(p["gear_ratio"] * pose, np.ones(4)) * ORDERS
    kinematic = (p["kinematic_cosine"] * np.cos(angle) + p["kinematic_sine"] * np.sin(angle)).sum(1)
    torsion = gravity / p["stiffness_linear"]
    state.motor_position, state.joint_position = pose, pose + kinematic - torsion
    state.torsion, state.current_torque = torsion, gravity
    plant.restore(state)


def pinocchio_gravity(config: PlantConfig, pose: np.ndarray) -> np.ndarray:
    """Gravity torque by Pinocchio, (n,) N m."""
    model = config.robot.pinocchio_model()
    return np.array(pinocchio.computeGeneralizedGravity(model, model.createData(), pose))


def profile(name: str, config: PlantConfig, ticks: int) -> np.ndarray:
    """Motor torques (ticks, n) of the integrator tests: gravity plus a multiple of Coulomb friction."""
    time, joint = 1e-3 * np.arange(ticks)[:, None], np.arange(config.joints)
    friction = config.drives["coulomb_torque"]
    wave = {
        "in_phase": 6.0 * np.sin(2.0 * np.pi * time) + 0.0 * joint,
        "phased": 6.0 * np.sin(2.0 * np.pi * time + joint),
        "square": 3.0 * np.sign(np.sin(6.0 * np.pi * time + 0.3 * joint)),
    }[name]
    return pinocchio_gravity(config, config.start_position) + friction * wave


class EnergyBook:
    """Energy of a plant from its state, with formulas of its own: kinetic, gravity, spring and stored in hysteresis."""

    def __init__(self, config: PlantConfig) -> None:
        self.p, self.model = config.drives, config.robot.pinocchio_model()
        self.data = self.model.createData()

    def energy(self, state) -> float:
        """Total energy, J, the hysteresis advanced to the end of the step."""
        p, q, w = self.p, state.joint_position.copy(), state.joint_velocity.copy()
        angle = np.outer(p["gear_ratio"] * state.motor_position, np.ones(4)) * ORDERS
        kinematic = (p["kinematic_cosine"] * np.cos(angle) + p["kinematic_sine"] * np.sin(angle)).sum(1)
        x = state.motor_position + kinematic - q
        spring = p["stiffness_linear"] * x**2 / 2 + p["stiffness_cubic"] * x**4 / 4 + p["stiffness_quintic"] * x**6 / 6
        rotor = 0.5 * p["rotor_inertia"] * state.motor_velocity**2
        links = pinocchio.computeKineticEnergy(self.model, self.data, q, w)
        height = pinocchio.computePotentialEnergy(self.model, self.data, q)
        return float(links + height + (spring + rotor + self.hysteresis(state, x)).sum())

    def hysteresis(self, state, x: np.ndarray) -> np.ndarray:
        """Work on the hysteresis so far, J, with the last part-step from mid-step to torsion x."""
        step, rate = x - state.torsion, self.p["hysteresis_rate"]
        limit = np.sign(step) * self.p["hysteresis_stiffness"] / rate
        travel = rate * np.abs(step) + 1e-300
        return (
            state.hysteresis_work + limit * step - (state.hysteresis_torque - limit) * step * np.expm1(-travel) / travel
        )

    def balance(self, state) -> float:
        """Work put in minus losses, J."""
        return float((state.motor_work - state.friction_work - state.damping_work).sum())
