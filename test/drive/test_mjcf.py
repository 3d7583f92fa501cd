"""Export of a model to MuJoCo: values at their places, what is left out, and the physics where MuJoCo is installed."""

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from hd_control.cli.main import main
from hd_control.core.errors import ConfigError
from hd_control.core.robot import Robot
from hd_control.drive.mjcf import mjcf_text
from hd_control.drive.model import JointModel, Model, ModelValue
from hd_control.drive.model_file import load_model


def alone(**more):
    """A model of one joint without a robot description."""
    effects = {
        "rotor_inertia": {"rotor_inertia": 28.0},
        "torsional_stiffness": {"torsional_stiffness": 2.9e5, "damping_time": 1e-3},
        "coulomb_friction": {"coulomb_torque": 24.0},
        "viscous_friction": {"viscous": 300.0},
        "link_dynamics": {"inertia": 40.0, "gravity_cosine": 30.0, "gravity_sine": -120.0},
    } | more
    values = {name: {key: ModelValue(value) for key, value in given.items()} for name, given in effects.items()}
    return Model(None, {"elbow": JointModel(120.0, effects=values)})


def hinges(text):
    """Attributes of every joint element by name."""
    return {joint.get("name"): joint.attrib for joint in ElementTree.fromstring(text).iter("joint")}


def test_every_value_is_at_its_place():
    found = hinges(mjcf_text(alone(kinematic_error={"cosine_2": 1e-4})))
    motor, torsion = found["elbow_motor"], found["elbow_torsion"]
    assert [float(motor[key]) for key in ("armature", "frictionloss", "damping")] == [28.0, 24.0, 300.0]
    assert [float(torsion[key]) for key in ("stiffness", "damping")] == [2.9e5, 290.0]
    rigid = hinges(mjcf_text(alone(), rigid=True))
    assert list(rigid) == ["elbow"] and "stiffness" not in rigid["elbow"]


def test_what_mujoco_does_not_have_is_named():
    text = mjcf_text(alone(kinematic_error={"cosine_2": 1e-4}, asymmetric_friction={"friction_offset": 1.0}))
    assert "left out: kinematic_error, asymmetric_friction" in text
    assert "left out: nothing" in mjcf_text(alone())


def test_an_arm_is_a_chain_of_its_bodies():
    model = load_model("arm_a")
    root = ElementTree.fromstring(mjcf_text(model, "arm_a"))
    names = [body.get("name") for body in root.iter("body")]
    assert names == [f"joint_{n}_link" for n in range(1, 8)] and len(root.findall("worldbody/body")) == 1
    assert [motor.get("joint") for motor in root.iter("motor")] == [f"joint_{n}_motor" for n in range(1, 8)]
    two = ElementTree.fromstring(mjcf_text(model, joints=["joint_3", "joint_5"]))
    assert len(two.findall("worldbody/body")) == 2


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (alone(link_dynamics={}), "needs the link's inertia"),
        (alone(torsional_stiffness={}), "no torsional_stiffness; export it with --rigid"),
        (alone(rotor_inertia={}), "no rotor_inertia"),
    ],
)
def test_a_model_that_cannot_be_simulated_is_refused(model, words):
    with pytest.raises(ConfigError, match=words):
        mjcf_text(model)


def test_the_command_writes_the_file(tmp_path, capsys):
    target = tmp_path / "arm.xml"
    assert main(["export", "arm_a", "-o", str(target)]) == 0
    assert ElementTree.parse(target).getroot().get("model") == "arm"
    assert main(["export", "no_model", "-o", str(tmp_path / "b.xml")]) == 2
    assert main(["export", "arm_a", "-o", str(target), "--joint", "elbow", "--force"]) == 2
    assert not (tmp_path / "b.xml").exists() and "elbow" in capsys.readouterr().err


def loaded(text):
    """Model and data of MuJoCo; the test is skipped where it is not installed."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    return mujoco, model, mujoco.MjData(model)


@pytest.mark.parametrize("angle", [-0.7, 0.0, 1.2])
def test_mujoco_feels_the_same_link(angle):
    mujoco, model, data = loaded(mjcf_text(alone(coulomb_friction={}), rigid=True))
    data.qpos[0] = angle
    mujoco.mj_forward(model, data)
    assert data.qfrc_bias[0] == pytest.approx(30.0 * math.cos(angle) - 120.0 * math.sin(angle), abs=1e-9)
    data.ctrl[0] = 200.0
    mujoco.mj_forward(model, data)
    assert data.qacc[0] == pytest.approx((200.0 - data.qfrc_bias[0]) / (28.0 + 40.0), rel=1e-9)


def test_mujoco_feels_the_same_arm():
    import pinocchio

    mujoco, model, data = loaded(mjcf_text(load_model("arm_a")))
    robot = Robot.from_file("arm_a")
    q = np.array([0.2, 0.5, -0.6, 1.0, -0.5, 0.4, 0.3])
    data.qpos[::2] = q
    mujoco.mj_forward(model, data)
    inner = robot.pinocchio_model()
    gravity = pinocchio.computeGeneralizedGravity(inner, inner.createData(), q)
    np.testing.assert_allclose(data.qfrc_bias[::2], gravity, atol=1e-9)
    np.testing.assert_allclose(data.qfrc_bias[1::2], gravity, atol=1e-9)


def test_mujoco_carries_the_torsion():
    """A constant load twists the flexspline by load / stiffness once the joint rests on its friction."""
    mujoco, model, data = loaded(mjcf_text(alone(coulomb_friction={"coulomb_torque": 1e4})))
    for _ in range(4000):
        mujoco.mj_step(model, data)
    load = 30.0 * math.cos(data.qpos.sum()) - 120.0 * math.sin(data.qpos.sum())
    assert data.qpos[1] == pytest.approx(-load / 2.9e5, rel=1e-3)
