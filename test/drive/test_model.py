"""Model files: what is read is what was written, and a wrong file is named by line and key."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive.drive_cases import moving
from hypothesis import given
from hypothesis import strategies as st

from hd_control.core.errors import ConfigError
from hd_control.core.resources import config_path
from hd_control.core.robot import Robot
from hd_control.drive.expression import Expression, Table
from hd_control.drive.library import library
from hd_control.drive.model import JointModel, Model, ModelValue, model_from_urdf
from hd_control.drive.model_file import load_model, model_sha256, model_text, number, parse_model, save_model
from hd_sim.plant_config import PlantConfig
from hd_sim.truth import nominal

TEXT = """
schema: hd.model/1
joints:
  shoulder:
    gear_ratio: 120
    rated_torque: 402
    effects:
      - link_dynamics: {inertia: 40, gravity_sine: -120.0}
      - kinematic_error: {cosine_2: 1e-5, sine_2: {value: 1e-5, unit: rad, source: fitted, interval: [-1e-5, 2e-5]}}
      - coulomb_friction: {coulomb_torque: {value: 24, low: 20, high: 30}}
      - expression: {name: cable, channel: link_torque, formula: "c * sin(1.5*joint_position)", parameters: {c: 3.0}}
provenance: [{command: hd add, bags: [{path: a b, sha256: 00ff}]}]
"""


def test_every_form_of_every_effect_survives() -> None:
    for name, effect in library().items():
        for values in effect.examples:
            full = {
                p: ModelValue(v, source="fitted", interval=(v - 1.0 / 3.0, v + 1e-17), low=-1e300, high=1e300)
                for p, v in values.items()
            }
            text = model_text(Model(None, {"joint_1": JointModel(100.0, None, {name: full})}))
            again = parse_model(text)
            assert model_text(again) == text
            assert again.joints["joint_1"].numbers(name) == values
            value = next(iter(again.joints["joint_1"].effects[name].values()))
            original = next(iter(full.values()))
            assert (value.interval, value.source, value.low) == (original.interval, "fitted", -1e300)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_are_exact_and_numbers_for_every_reader(value: float) -> None:
    import yaml

    text = number(value)
    assert float(text) == value
    assert yaml.safe_load(text) == value, "also for readers of the older YAML"


def test_the_written_file_is_its_own_hash(tmp_path: Path) -> None:
    written = save_model(parse_model(TEXT), tmp_path / "m.yaml", {"command": "hd add x", "program": "hd_control 0.1.0"})
    again = load_model(tmp_path / "m.yaml")
    assert again == written
    assert model_sha256(again) == hashlib.sha256((tmp_path / "m.yaml").read_bytes()).hexdigest()
    assert [step["command"] for step in again.provenance] == ["hd add", "hd add x"], "the history grows"


URDF = Robot.from_file("single_joint_3").urdf


@pytest.mark.parametrize(
    "text",
    [URDF, URDF.rstrip(), URDF + "\n", URDF.replace("\n", "\r\n"), "\n  " + URDF, URDF.replace("  ", "\t"),
     URDF.replace("<robot", "<!-- \u00e9\u2028\x85 -->\n\n \n<robot"), URDF.replace(">\n", ">  \n")],
)  # fmt: skip
def test_a_description_is_kept_letter_by_letter(text: str) -> None:
    model = replace(parse_model(TEXT), robot=text)
    assert parse_model(model_text(model)).robot == text
    robot = model.robot_description()
    assert robot is not None and robot.joint_names == ("joint_3",)


def test_a_model_written_elsewhere_takes_its_robot_along(tmp_path: Path) -> None:
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
    (tmp_path / "a" / "robot.urdf").write_text(URDF)
    model = save_model(Model("robot.urdf", parse_model(TEXT).joints), tmp_path / "a" / "m.yaml")
    assert load_model(tmp_path / "a" / "m.yaml").robot == "robot.urdf"
    save_model(model, tmp_path / "b" / "m.yaml")
    (tmp_path / "c" / "robot.urdf").write_text(URDF.replace("single", "another"))
    save_model(model, tmp_path / "c" / "m.yaml")
    (tmp_path / "a" / "robot.urdf").unlink()
    for folder in ("b", "c"):
        again = load_model(tmp_path / folder / "m.yaml")
        assert again.robot == URDF, "alone, or beside another robot of that name"
        robot = again.robot_description()
        assert robot is not None and robot.urdf == URDF


def test_a_shipped_robot_keeps_its_name(tmp_path: Path) -> None:
    save_model(Model("arm_a", parse_model(TEXT).joints), tmp_path / "m.yaml")
    again = load_model(tmp_path / "m.yaml")
    robot = again.robot_description()
    assert again.robot == "arm_a" and robot is not None and robot.joints == 7


def test_an_effect_is_added_to_a_copy() -> None:
    model = parse_model(TEXT)
    more = model.with_effect("shoulder", "gauge_offset", {"gauge_offset": ModelValue(0.4, "N m", source="fitted")})
    assert list(more.joints["shoulder"].effects) == [*model.joints["shoulder"].effects, "gauge_offset"]
    assert model_sha256(more) != model_sha256(model) and "gauge_offset" not in model.joints["shoulder"].effects
    with pytest.raises(ConfigError, match="it has shoulder"):
        model.with_effect("elbow", "gauge_offset", {})


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text("mine")
    with pytest.raises(ConfigError, match="--force"):
        save_model(parse_model(TEXT), path)
    assert path.read_text() == "mine"
    save_model(parse_model(TEXT), path, force=True)
    assert load_model(path).joints["shoulder"].number("link_dynamics", "inertia") == 40.0


def test_expressions_survive() -> None:
    table = Table("joint_position", (0.0, 0.5, 1.0), "direction")
    joint = JointModel(100.0).with_effect(
        "bump",
        {f"value_{i + 1}": ModelValue(v, "N m", source="fitted") for i, v in enumerate((0.0, 1e-3, -2.0))},
        Expression("bump", {"motor_torque": -1.0, "link_torque": 1.0}, table=table),
    )
    model = Model(None, {"a": joint})
    assert parse_model(model_text(model)) == model
    states = moving(800)
    (effect, shape, coefficients) = model.joints["a"].terms()[0]
    column = effect.columns(states, shape)["link_torque"] @ coefficients
    expected = np.interp(states.joint_position, [0, 0.5, 1], [0, 1e-3, -2.0], left=0, right=0) * states.motor_direction
    np.testing.assert_allclose(column, expected, atol=1e-12)
    np.testing.assert_allclose(effect.columns(states, shape)["motor_torque"] @ coefficients, -expected, atol=1e-12)


def test_a_formula_is_its_value() -> None:
    states = moving(400)
    effect, shape, coefficients = parse_model(TEXT).joints["shoulder"].terms()[3]
    column = effect.columns(states, shape)["link_torque"] @ coefficients
    np.testing.assert_allclose(column, 3.0 * np.sin(1.5 * states.joint_position), rtol=1e-12)


@pytest.mark.parametrize(
    "formula",
    [
        "__import__('os').system('true')", "c.real", "[c]", "c**100", "c**c", "lambda: c", "open(c)", "sin", "sin(1,2)",
        "(1).__class__", "'a'", "c if c else 2", "c := 3", "c = 3", "sin(c", "c and c", "c < 2", "True", "f'{c}'",
        "min(c)", "sin(*[c])", "sin(x=c)", "c @ c", "~c", "{}", "9**9**9", "+".join(["c"] * 300), "(" * 300,
    ],
)  # fmt: skip
def test_no_formula_is_code(formula: str) -> None:
    text = TEXT.replace('"c * sin(1.5*joint_position)"', repr(formula).replace("\\'", "''"))
    with pytest.raises(ConfigError):
        parse_model(text)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gear_ratio: 120", "gear_ratio: -120", "gear_ratio (line 5): -120"),
        ("gear_ratio: 120", "gear_ratio: fast", "is not a number"),
        ("rated_torque: 402", "rated_torque: 0", "rated_torque"),
        ("unit: rad", "unit: deg", "unit 'deg' is not 'rad'"),
        ("kinematic_error", "kinematc_error", "did you mean 'kinematic_error'"),
        ("cosine_2", "cosin_2", "did you mean 'cosine_2'"),
        ("source: fitted", "source: dream", "source 'dream'"),
        ("inertia: 40", "inertia: -40", "outside"),
        ("value: 24, low: 20", "value: 24, low: 25", "outside"),
        ("interval: [-1e-5, 2e-5]", "interval: [2e-5, -1e-5]", "is above"),
        ("interval: [-1e-5, 2e-5]", "interval: 3", "expected [low, high]"),
        ("hd.model/1", "hd.model/2", "is not hd.model/1"),
        ("coulomb_friction: {coulomb_torque: {value: 24, low: 20, high: 30}}", "coulomb_friction: {}", "missing"),
        ("coulomb_friction: {coulomb_torque: {value: 24, low: 20, high: 30}}", "backlash: {half_gap: 1}", "crossing"),
        ("channel: link_torque", "channel: torque", "is not one of"),
        ("joints:", "robot: {urdf: a.urdf, urdf_text: <robot/>}\njoints:", "either urdf"),
        ("joints:", "robot: {urdf: <robot/>}\njoints:", "robot: urdf (line 3)"),
        ("joints:", "robot: {urdf_text: 3}\njoints:", "is not text"),
        ("cosine_2: 1e-5", "cosine_2: fast", "shoulder: kinematic_error: cosine_2 (line 9): 'fast' is not a number"),
        ("command: hd add", "comand: hd add", "did you mean 'command'"),
        ("name: cable", "name: 2cable", "plain word"),
        ("      - coulomb_friction", "      - link_dynamics: {}\n      - coulomb_friction", "twice"),
        ("    rated_torque: 402", "    rated_torque: 402\n    rated_torque: 403", "duplicate key"),
        ("  shoulder:", "  &a shoulder:", "anchors"),
        ("schema: hd.model/1", "schema: hd.model/1\nphysics: true", "unknown key 'physics'"),
    ],
)
def test_a_wrong_file_is_named(old: str, new: str, words: str) -> None:
    assert old in TEXT
    with pytest.raises(ConfigError) as error:
        parse_model(TEXT.replace(old, new), "m.yaml")
    message = str(error.value)
    assert words in message and "m.yaml" in message and "\n" not in message


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"m\.yaml: no such file"):
        load_model(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    "name",
    sorted(path.stem for path in config_path("plant").glob("*_*.yaml") if path.stem.startswith(("arm", "single"))),
)
def test_shipped_models_are_the_nominal_plants(name: str) -> None:
    model, plant = load_model(name.removesuffix("_fine")), nominal(PlantConfig.from_file(name))  # only sensors differ
    robot = model.robot_description()
    assert robot is not None and robot.joint_names == plant.robot.joint_names == tuple(model.joints)
    for j, joint in enumerate(model.joints.values()):
        stiffness = plant.drives["stiffness_linear"][j]
        assert joint.gear_ratio == plant.drives["gear_ratio"][j]
        assert joint.rated_torque == plant.drives["rated_torque"][j]
        assert joint.number("rotor_inertia", "rotor_inertia") == plant.drives["rotor_inertia"][j]
        assert joint.number("torsional_stiffness", "torsional_stiffness") == stiffness
        damping = joint.number("torsional_stiffness", "damping_time") * stiffness
        assert damping == pytest.approx(plant.drives["torsional_damping"][j], rel=1e-12)
        assert joint.number("coulomb_friction", "coulomb_torque") == plant.drives["coulomb_torque"][j]
        assert joint.number("viscous_friction", "viscous") == plant.drives["viscous_positive"][j]
        assert {v.source for effect in joint.effects.values() for v in effect.values()} == {"datasheet"}


def test_a_first_model_from_a_description() -> None:
    model = model_from_urdf("arm_a", {"joint_1": 120.0, "joint_7": 160.0}, {"joint_7": 40.0})
    assert list(model.joints) == ["joint_1", "joint_7"]
    assert [(j.gear_ratio, j.rated_torque) for j in model.joints.values()] == [(120.0, None), (160.0, 40.0)]
    assert parse_model(model_text(model)) == model


def blocks(language: str) -> list[str]:
    """Code blocks of the manual."""
    text = (Path(__file__).resolve().parents[2] / "docs" / "model.md").read_text()
    return [part.partition("```")[0] for part in text.split(f"```{language}\n")[1:]]


def test_the_manuals_example_is_a_model() -> None:
    (example,) = blocks("yaml")
    model = parse_model(example, "docs/model.md")
    assert parse_model(model_text(model)) == model
    states = moving(100)
    for effect, shape, coefficients in model.joints["joint_3"].terms():
        for column in effect.columns(states, shape).values():
            assert np.isfinite(column @ coefficients).all()


def test_the_manuals_program_makes_a_model(tmp_path: Path) -> None:
    (program,) = blocks("python")
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True, timeout=60)
    joint = load_model(tmp_path / "sheet.yaml").joints["joint_3"]
    shipped = load_model("single_joint_3").joints["joint_3"]
    assert (joint.gear_ratio, joint.rated_torque) == (shipped.gear_ratio, shipped.rated_torque)
    for effect, values in shipped.effects.items():
        for name, value in values.items():
            assert joint.number(effect, name) == pytest.approx(value.value, rel=0.01), name


def test_a_damaged_file_is_an_error_or_a_model(rng: np.random.Generator) -> None:
    """Random damage to the manual's example: one clear line, or a model that goes round; nothing else."""
    (example,) = blocks("yaml")
    letters = list("abcdefghijklmnopqrstuvwxyz0123456789:{}[],-+*/() \n'\"#&|>%@!?.eE_\x00\t\u2028")
    models = 0
    for _ in range(1500):
        text = list(example)
        for _ in range(rng.choice((1, 1, 2, 4))):
            at, kind = int(rng.integers(len(text))), rng.integers(3)
            if kind == 0:
                del text[at : at + int(rng.choice((1, 3, 20)))]
            else:
                text[at : at + kind - 1] = [str(rng.choice(letters))]
        try:
            model = parse_model("".join(text))
        except ConfigError as error:
            assert "\n" not in str(error)
        else:
            models += 1
            assert parse_model(model_text(model)) == model
    assert 50 < models < 1450, "the damage must be neither harmless nor total"


def test_a_model_that_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    """A negative damping, as an unbounded fit would give it."""
    good = parse_model(TEXT)
    joint = next(iter(good.joints))
    bad = good.with_effect(joint, "viscous_friction", {"viscous": ModelValue(-2.0, "N m s", source="fitted")})
    with pytest.raises(ConfigError, match="not written, for it could not be read again: .*-2 N m s is outside"):
        save_model(bad, tmp_path / "m.yaml")
    assert not (tmp_path / "m.yaml").exists()
