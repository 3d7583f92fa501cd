"""The story of the project on hidden effects: compare, diagnose, add, and the error falls on data not used for fitting.

Every joint is another random drive; nothing but its recordings and its data sheet reaches the analysis.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from hd_control.drive.model import Model
from hd_control.lab.diagnosis.verdict import ADEQUATE, CANNOT_TELL, MISSING, UNKNOWN
from hd_control.lab.models.answers import compare_joint, diagnose_joint, joint_task
from hd_control.lab.models.fit_model import fit_joint
from hd_control.lab.models.ladder import REFIT, JointLadder, Split, _Judge, _refit, climb
from hd_control.lab.signals.joint_signals import Recording
from hd_sim.puzzles.campaign import nominal_model, recording
from hd_sim.puzzles.draw import chosen_case
from hd_sim.puzzles.recordings import Pair, record_pair

SEED = 4200
WITHIN = 1.1
"""Held-out error over the noise floor that a model with the right effect reaches."""
KNOWN = {
    "kinematic_error": ("transmission", 1.0),
    "joint_sensor_eccentricity": ("transmission", 1.0),
    "stribeck_friction": ("motor_torque", 1.0),
    "motor_cogging": ("motor_torque", 1.0),
    "gauge_ripple": ("link_torque", 1.0),
    "payload": ("link_torque", 1.0),
}
"""Effect -> channel that shows it, strength."""
QUICK = ("kinematic_error", "stribeck_friction", "gauge_ripple")
"""One for each channel; the others run in the long lane (hd test --long STORY)."""


def opened(pair: Pair) -> tuple[Split, Model, str]:
    """What a user has: two recordings, a model, a joint."""
    joint = str(pair.model["joint"])
    fit, held_out = (recording(columns, joint, pair.period) for columns in (pair.fit, pair.held_out))
    return Split.of(fit, held_out), nominal_model(pair.model), joint


def hidden(effect: str, strength: float, motion: str = "general") -> Pair:
    """A pair of recordings of a random drive that hides an effect; every effect gets another drive."""
    number = sum(map(ord, effect))
    return record_pair(chosen_case(SEED + number, {effect: strength} if effect else {}, motion))


@pytest.mark.parametrize("effect", [pytest.param(e, marks=[pytest.mark.slow] * (e != QUICK[0])) for e in QUICK])
def test_the_missing_effect_is_named_added_and_the_error_falls(effect: str) -> None:
    channel, strength = KNOWN[effect]
    split, model, joint = opened(hidden(effect, strength))
    ladder = climb(split, model, joint)
    refit = next(rung for rung in ladder.rungs if rung.effect == REFIT)
    assert [rung.effect for rung in ladder.rungs[2:]] == [effect], ladder.stopped_because
    assert ladder.diagnosis is not None and ladder.diagnosis.verdict == ADEQUATE
    assert [rung.parameters_count for rung in ladder.rungs] == sorted(rung.parameters_count for rung in ladder.rungs)
    assert refit.ratio(channel) > 1.2
    assert ladder.rungs[-1].ratio(channel) <= WITHIN, errors(ladder)


@pytest.mark.slow
def test_a_refit_never_raises_the_error_of_what_it_was_fitted_to() -> None:
    """Beside a large offset of the friction the best fit of the acceleration has an inertia that explains no torque."""
    split, model, joint = opened(hidden("asymmetric_friction", 8.0))
    judge = _Judge(split.train, joint)
    plain = replace(model, joints={joint: fit_joint(judge.task(model), model.joint(joint)).model})
    kept = replace(model, joints={joint: _refit(judge, model, joint).model})
    given, wild, tame = (
        {name: channel.rms_error for name, channel in judge.compare(each).channels.items()}
        for each in (model, plain, kept)
    )
    assert wild["motor_torque"] > 1.2 * given["motor_torque"], "else this test says nothing"
    assert all(tame[name] <= (1.0 + 1e-6) * given[name] for name in given)
    assert tame["transmission"] < given["transmission"], "the other channels keep their fit"


def errors(ladder: JointLadder) -> str:
    """The ladder in short, for a failing test."""
    return "; ".join(f"{r.effect}: " + ", ".join(f"{n} {r.ratio(n):.3f}" for n in r.held_out) for r in ladder.rungs)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7003, 7008])
def test_a_large_ripple_of_the_gauge_leaves_nothing_unknown(seed: int) -> None:
    """The damper of the spring drags the torsion that the ripple would mean, the more the faster it turns."""
    split, model, joint = opened(record_pair(chosen_case(seed, {"gauge_ripple": 5.0}, "general")))
    found = diagnose_joint(split.train, model, joint)
    assert ([effect.name for effect in found.effects], found.unknown) == (["gauge_ripple"], None)


@pytest.mark.slow
def test_hysteresis_is_named_and_its_law_leaves_little() -> None:
    """Its reversals are seen through the band of the gauge, so that it does not come down to the noise as others do."""
    split, model, joint = opened(hidden("torsional_hysteresis", 1.0))
    ladder = climb(split, model, joint)
    assert [rung.effect for rung in ladder.rungs[2:]] == ["torsional_hysteresis"]
    assert ladder.rungs[-1].held_out["transmission"] < 0.5 * ladder.rungs[1].held_out["transmission"]


@pytest.mark.slow
def test_a_drive_without_hidden_effect_stays_adequate() -> None:
    split, model, joint = opened(hidden("", 0.0))
    found = diagnose_joint(split.train, model, joint)
    assert (found.verdict, found.effects, found.unknown) == (ADEQUATE, (), None)
    report = compare_joint(split.train, model, joint)
    for channel in report.comparison.channels.values():
        assert channel.rms_error > 1.1 * channel.noise_floor, "data-sheet values are wrong by per cents"
        assert channel.rms_error_refitted <= WITHIN * channel.noise_floor, "a wrong value is not a missing effect"


@pytest.mark.parametrize(
    ("effect", "variable", "channel"),
    [
        ("tooth_defect", "joint_position", "transmission"),
        pytest.param("friction_step", "time", "motor_torque", marks=pytest.mark.slow),
    ],
)
def test_an_effect_outside_the_library_is_called_unknown(effect: str, variable: str, channel: str) -> None:
    split, model, joint = opened(hidden(effect, 1.5))
    found = diagnose_joint(split.train, model, joint)
    assert found.verdict == UNKNOWN, [e.name for e in found.effects]
    assert found.unknown is not None
    assert variable in found.unknown.variables
    assert found.unknown.channel == channel


@pytest.mark.parametrize("motion", ["short", "slow_only", "saturated", "production"])
def test_a_poor_recording_is_refused_with_an_experiment(motion: str) -> None:
    pair = hidden("kinematic_error", 1.0, motion)
    _, model, joint = opened(pair)
    found = diagnose_joint(recording(pair.fit, joint, pair.period), model, joint)
    assert found.verdict == CANNOT_TELL
    assert not found.effects
    assert found.experiments and all(e.purpose and e.how for e in found.experiments)


@pytest.mark.slow
def test_values_found_are_those_of_the_world_and_inside_their_intervals() -> None:
    pair = hidden("kinematic_error", 1.0)
    split, model, joint = opened(pair)
    fitted = fit_joint(joint_task(split.train, model, joint), model.joint(joint), "kinematic_error")
    true = pair.truth["joints"][joint]["parameters"]["kinematic_error"]
    amplitude = max(map(abs, true.values()))
    found = fitted.model.effects["kinematic_error"]
    for name, value in true.items():
        assert abs(found[name].value - value) < 0.02 * amplitude
        interval = found[name].interval
        assert interval is not None and interval[0] < interval[1] and interval[1] - interval[0] < 0.2 * amplitude


def test_the_joint_is_judged_by_its_own_recording_only() -> None:
    """A diagnosis of the second recording names the same effect: nothing leaks from the first."""
    split, model, joint = opened(hidden("kinematic_error", 1.5))
    found = diagnose_joint(split.held_out, model, joint)
    assert found.verdict == MISSING
    assert [effect.name for effect in found.effects] == ["kinematic_error"]


def test_without_motor_torque_the_other_channels_still_answer() -> None:
    split, model, joint = opened(hidden("kinematic_error", 1.0))
    signals = replace(split.train.joints[joint], motor_torque=None)
    found = diagnose_joint(Recording("", "", {joint: signals}), model, joint)
    assert set(found.channels) == {"transmission", "link_torque"}
    assert [effect.name for effect in found.effects] == ["kinematic_error"]


@pytest.mark.slow
def test_a_held_out_run_without_the_channel_of_the_effect_says_so() -> None:
    """The model has an effect of the motor side then; a recording without motor torque must still be compared."""
    split, model, joint = opened(hidden("asymmetric_friction", 1.0))
    blind = replace(split.held_out.joints[joint], motor_torque=None)
    ladder = climb(replace(split, held_out=replace(split.held_out, joints={joint: blind})), model, joint)
    assert [rung.effect for rung in ladder.rungs[2:]] == []
    assert "does not show motor_torque, so asymmetric_friction cannot be judged" in ladder.stopped_because
