"""Random drives: the world agrees with its data sheet, follows the reference, and repeats; cases and worlds vary."""

from dataclasses import replace

import numpy as np
import pytest

from hd_control.core.errors import ConfigError
from hd_sim.hidden_effects import OUTSIDE, VOCABULARY
from hd_sim.plant import Plant
from hd_sim.puzzles.draw import (
    CATEGORIES,
    FEATURES,
    SUBSTITUTES,
    UNKNOWN,
    chosen_case,
    draw_case,
    draw_drive,
    draw_features,
    stream,
)
from hd_sim.puzzles.random_motion import MOTIONS, POOR
from hd_sim.puzzles.recordings import _later, hidden_truth, make_pair, nominal_model, record_pair, room_of, set_up
from hd_sim.truth import PARAMETERS


@pytest.mark.parametrize("seed", range(20))
def test_the_drawn_link_is_the_one_in_the_description(seed):
    """Gravity and inertia of numbers and URDF agree to rounding; the user's gravity is right, his inertia is not."""
    drive = draw_drive(seed)
    plant = Plant(drive.config)
    for angle in (-1.0, 0.0, 0.7):
        expected = drive.true.gravity(np.array(angle))
        assert plant.gravity_torque([angle])[0] == pytest.approx(expected, abs=1e-9 * drive.true.rated_torque)
    inertia = plant._kernel.accelerate([0.3], [0.0], [0.0], [0.0])[1][0, 0]
    assert inertia == pytest.approx(drive.true.link_inertia, rel=1e-9)
    assert 0.0 < abs(drive.nominal.link_inertia / drive.true.link_inertia - 1.0) <= 0.03
    assert drive.nominal.gravity_torque == drive.true.gravity_torque


@pytest.mark.parametrize("seed", range(30, 42))
def test_a_good_recording_follows_its_reference_and_warms_up(seed):
    """RMS error below 25 mrad (coarse encoders force low gains), no saturation, 8 K and 30 % of the rated torque."""
    pair = make_pair(seed, "none", judge=False)
    fit, rated = pair.fit, pair.model["rated_torque"]
    error = fit["joint_position"] - fit["reference_position"]
    assert np.sqrt(np.mean(error**2)) < 0.025
    bench = set_up(pair.case)
    assert np.abs(fit["motor_torque"]).max() < bench.drive.true.torque_limit
    assert np.ptp(fit["temperature"]) >= 8.0
    assert np.ptp(fit["gauge_torque"]) >= 0.3 * rated
    assert fit["time"].size == 60000 and pair.held_out["time"].size == 24000
    assert all(np.all(np.isfinite(column)) for column in fit.values())


def test_general_motions_visit_both_directions_and_a_wide_range_of_speeds():
    for seed in range(20):
        room = room_of(draw_drive(seed))
        reference = MOTIONS["general"](stream(seed, "test"), room, 60.0)
        assert np.ptp(reference.position) >= 1.0
        assert reference.velocity.max() > 0.85 and reference.velocity.min() < -0.85
        assert np.abs(np.diff(reference.velocity)).max() < 0.05, "no jumps of speed"


@pytest.mark.parametrize("motion", POOR)
def test_poor_recordings_run_and_differ_from_each_other(motion):
    case = chosen_case(7, {"stribeck_friction": 1.0}, motion)
    first, second = record_pair(case).fit, set_up(case).record(motion, 1, 5.0)
    assert all(np.all(np.isfinite(column)) for column in first.values())
    assert np.ptp(first["temperature"]) < 30.0
    short = min(first["time"].size, second["time"].size)
    assert not np.array_equal(first["joint_position"][:short], second["joint_position"][:short])


def test_a_seed_repeats_bit_for_bit_and_another_does_not():
    first, again, other = (make_pair(seed, "one").held_out["gauge_torque"] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_hidden_effects_change_the_recording_but_not_the_model():
    plain, hidden = (record_pair(chosen_case(5, effects)) for effects in ({}, {"gauge_offset": 1.0}))
    shift = np.mean(hidden.fit["gauge_torque"] - plain.fit["gauge_torque"])
    assert abs(shift) == pytest.approx(0.011 * hidden.model["rated_torque"], rel=0.1)
    assert plain.model == hidden.model
    assert hidden.truth["joints"]["joint_1"]["parameters"]["gauge_offset"]["gauge_offset"] == pytest.approx(
        shift, rel=0.1
    )


def test_the_mix_has_its_shares():
    """1000 draws: each category within four standard deviations of its share."""
    counts = {name: 0 for name in CATEGORIES}
    judges = 0
    for seed in range(1000):
        case = draw_case(seed)
        counts[case.category] += 1
        judges += bool(case.features)
        assert len(case.names) == {"none": 0, "one": 1, "two": 2}.get(case.category, len(case.names))
        assert (case.motion != "general") == (case.category == "poor")
    for name, share in (("none", 0.30), ("one", 0.35), ("two", 0.15), ("unknown", 0.10), ("poor", 0.10)):
        assert abs(counts[name] - 1000 * share) < 4.0 * np.sqrt(1000 * share * (1.0 - share))
    assert 400 < judges < 600


def test_every_known_effect_has_its_parameters_and_every_unknown_one_an_answer():
    assert set(PARAMETERS) == set(VOCABULARY)
    assert set(UNKNOWN) <= set(OUTSIDE)
    for name in VOCABULARY:
        bench = set_up(chosen_case(11, {name: 1.0}))
        assert hidden_truth(bench)["joints"]["joint_1"]["parameters"][name], name


def test_a_wrong_effect_or_category_is_refused():
    with pytest.raises(ConfigError, match="unknown effect"):
        chosen_case(1, {"gremlins": 1.0})
    with pytest.raises(ConfigError, match="category"):
        draw_case(1, "three")


def test_a_declared_current_lag_is_in_the_model():
    seed = next(s for s in range(200) if "current_lag" in draw_case(s, "none", judge=True).features)
    bench = set_up(draw_case(seed, "none", judge=True))
    lag = float(bench.world.drives["current_time_constant"][0])
    assert nominal_model(bench.drive)["effects"]["actuation_delay"]["delay"] == pytest.approx(lag, rel=0.2)


def test_a_late_channel_is_delayed_by_the_part_of_a_sample():
    time = np.arange(4000) * 1e-3
    wave = np.sin(2 * np.pi * 3.0 * time) + 0.2 * time
    late = np.sin(2 * np.pi * 3.0 * (time - 3e-4)) + 0.2 * (time - 3e-4)
    np.testing.assert_allclose(_later(wave, 0.3)[100:-100], late[100:-100], atol=2e-4)


@pytest.mark.parametrize("feature", FEATURES)
def test_every_feature_of_the_judge_changes_the_recording_and_keeps_the_right_name(feature):
    """The same drive and noise with and without one feature; the hidden effect keeps its name in the vocabulary."""
    name = {"other_laws": "torsional_hysteresis", "kinematic": "kinematic_error"}.get(feature, "backlash")
    seed = next(s for s in range(300) if feature in draw_features(s, (name,), True))
    case = chosen_case(seed, {name: 1.0}, "short")
    value = draw_features(seed, (name,), True)[feature]
    effects = tuple(replace(e, name=SUBSTITUTES.get(e.name, e.name)) for e in case.effects)
    judged = replace(case, features={feature: value}, effects=effects if feature == "other_laws" else case.effects)
    plain, other = set_up(case).record("short"), set_up(judged).record("short")
    assert any(not np.array_equal(plain[key], other[key]) for key in plain)
    assert hidden_truth(set_up(judged))["joints"]["joint_1"]["names"] == [name]
    error = other["joint_position"] - other["reference_position"]
    assert np.sqrt(np.mean(error**2)) < 0.025


def test_late_angles_stay_on_the_counts_of_their_sensors():
    case = chosen_case(21, {}, "short")
    bench = set_up(replace(case, features={"skew": {"channel": "motor_shaft_position", "delay": 3e-4}}))
    counts = bench.drive.config.drives["encoder_counts"][0] / (2.0 * np.pi)
    readings = bench.record("short")["motor_shaft_position"] * counts
    np.testing.assert_allclose(readings, np.round(readings), atol=1e-6)
