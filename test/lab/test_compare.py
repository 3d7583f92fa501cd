"""Numbers of a comparison: on residuals that are made, and of models that are right, wrong, or without an effect."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import NAME, PLAIN, joint_model, link_of, model, recording, signals
from test_balance_equations import noise_of

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.drive.model import Model, ModelValue
from hd_control.lab.balances.link import LinkSide
from hd_control.lab.balances.torsion import BANDS
from hd_control.lab.diagnosis.task import task_of
from hd_control.lab.maps.orders import lines_of, order_spectrum
from hd_control.lab.models.answers import compare_task, joint_task
from hd_control.lab.models.compare import (
    NUISANCES,
    ChannelComparison,
    JointComparison,
    compare,
    horizons,
    noises_of,
    with_wide_transmission,
)

TIME = np.arange(1000) * 0.008


def made(residual: np.ndarray, measured: np.ndarray, used: np.ndarray | None = None) -> ChannelComparison:
    """A channel with a floor of 0.1."""
    rows = np.ones(TIME.size, bool) if used is None else used
    return ChannelComparison(LINK, TIME, rows, measured, residual, 0.5 * residual, 0.1)


def test_numbers_of_a_made_residual() -> None:
    """A sine of amplitude 2 has RMS sqrt(2); the left side's RMS is about its mean; the rest is simple shares."""
    wave, measured = 2.0 * np.sin(2.0 * np.pi * 1.25 * TIME), 7.0 + 4.0 * np.cos(2.0 * np.pi * 0.25 * TIME)
    found = made(wave, measured)
    assert found.rms_error == pytest.approx(np.sqrt(2.0)) and found.rms_error_refitted == pytest.approx(np.sqrt(0.5))
    assert found.rms_measured == pytest.approx(4.0 / np.sqrt(2.0)), "the mean is no motion"
    assert found.structured_fraction == pytest.approx(1.0 - 0.01 / 2.0)
    as_json = found.json()
    assert as_json["error_percent"] == pytest.approx(50.0) and as_json["max_error"] == pytest.approx(2.0)
    assert (as_json["unit"], as_json["noise_floor"], as_json["worst"]) == ("N m", 0.1, [])


def test_only_rows_that_count_count() -> None:
    used = TIME < 4.0
    found = made(np.where(used, 1.0, 100.0), np.where(used, np.sin(TIME), 1e3), used)
    assert found.rms_error == 1.0 and found.json()["max_error"] == 1.0
    assert found.rms_measured == pytest.approx(np.sin(TIME[used]).std())
    nothing = made(np.ones(TIME.size), np.ones(TIME.size), np.zeros(TIME.size, bool))
    assert np.isnan(nothing.rms_error) and np.isnan(nothing.rms_measured) and nothing.structured_fraction == 0.0
    assert nothing.json()["error_percent"] is None and nothing.json()["max_error"] == 0.0


def test_at_or_below_the_floor_nothing_is_structured() -> None:
    assert made(np.full(TIME.size, 0.05), TIME).structured_fraction == 0.0
    assert made(np.zeros(TIME.size), TIME).structured_fraction == 0.0


@lru_cache(maxsize=4)
def compared(about: str = "right") -> JointComparison:
    """The plain joint against a model: right, with a stiffness 10 % too large, or without a payload that is there."""
    held, changes = model(), Changes()
    if about == "stiff":
        value = {**joint_model().effects["torsional_stiffness"],
                 "torsional_stiffness": ModelValue(1.1 * PLAIN.stiffness, "N m/rad")}  # fmt: skip
        held = held.with_effect(NAME, "torsional_stiffness", value)
    if about == "load":
        changes = Changes(link=_load)
    task = joint_task(recording(signals(changes)), held, NAME)
    return compare_task(task, held, NAME, noises_of(task) if about != "stiff" else compared().noises)


def _load(q: float, w: float) -> float:
    return 5.0 * float(np.sin(q))


def test_a_right_model_comes_down_to_the_noise_as_written_and_refitted() -> None:
    for name, channel in compared().channels.items():
        assert channel.rms_error < (1.3 if name == MOTOR else 1.1) * channel.noise_floor, "stops are rounded"
        assert channel.rms_error_refitted <= 1.001 * channel.rms_error
        if name != MOTOR:
            assert channel.noise_floor == pytest.approx(
                noise_of(compared().dictionary.equations.channels[name]), rel=0.1
            )
        assert channel.rms_measured > 30.0 * channel.rms_error


def test_a_wrong_value_is_an_error_as_written_and_none_after_refitting() -> None:
    """Stiffness 10 % too large: the torsion is wrong by a tenth of itself less a hundredth."""
    wrong = compared("stiff").channels[TRANSMISSION]
    assert wrong.rms_error == pytest.approx((1.0 - 1.0 / 1.1) * wrong.rms_measured, rel=0.01)
    assert wrong.rms_error_refitted < 1.1 * wrong.noise_floor
    right = compared().channels
    for name in (MOTOR, LINK):
        assert compared("stiff").channels[name].rms_error == pytest.approx(right[name].rms_error, rel=0.02)


def test_a_missing_effect_stays_after_refitting() -> None:
    """The gravity of a payload is not that of the nominal link, so no value of the base takes its place."""
    link = compared("load").channels[LINK]
    assert link.rms_error > 10.0 * link.noise_floor and link.rms_error_refitted > 5.0 * link.noise_floor
    assert link.structured_fraction > 0.99
    assert compared("load").channels[TRANSMISSION].rms_error < 1.2 * compared("load").channels[TRANSMISSION].noise_floor


def test_the_residual_is_the_left_side_less_what_the_model_says() -> None:
    found = compared()
    for name, channel in found.channels.items():
        balance = found.dictionary.equations.channels[name]
        by_hand = balance.left.copy()
        for base in balance.base:
            by_hand -= base.column * found.coefficients[found.dictionary.base_index(name, base.name)]
        np.testing.assert_allclose(channel.residual, by_hand, atol=1e-9 * np.abs(balance.left).max())
        np.testing.assert_array_equal(channel.measured, balance.left)
        np.testing.assert_array_equal(channel.used, balance.fitted)


def test_zero_and_small_delays_are_no_properties_of_a_model() -> None:
    """The joint sensor mounted 1 mrad off and the gauge 0.2 ms late: the right model is right all the same."""
    late = signals().gauge_torque - 2e-4 * np.gradient(signals(noisy=False).gauge_torque, 1e-3)
    moved = replace(signals(), joint_position=signals().joint_position + 1e-3, gauge_torque=late)
    task = task_of(moved, joint_model(), link_of(signals()))
    found = compare_task(task, model(), NAME, compared().noises)
    for name, channel in found.channels.items():
        assert channel.rms_error < 1.3 * channel.noise_floor, name
    fitted = dict(zip(found.dictionary.base_names, found.coefficients, strict=False))
    assert fitted[TRANSMISSION, "transmission_zero"] == pytest.approx(1e-3, rel=1e-3)
    assert fitted["", "torque_delay"] == pytest.approx(-2e-4, rel=0.15)
    held = {name for _, name in found.dictionary.base_names} - set(NUISANCES)
    assert held == {"drive_torque", "coulomb_torque", "viscous", "torsional_compliance", "torsional_damping"}


def test_a_shared_delay_does_not_follow_the_channel_that_fails() -> None:
    """A model whose friction is five times too small: alone the rotor would take 7.5 ms, the link knows better."""
    poor = {"coulomb_torque": ModelValue(0.2 * PLAIN.coulomb, "N m")}
    held = model().with_effect(NAME, "coulomb_friction", poor)
    task = joint_task(recording(signals()), held, NAME)
    found = compare_task(task, held, NAME, compared().noises)
    delay = dict(zip(found.dictionary.base_names, found.coefficients, strict=False))["", "torque_delay"]
    assert abs(delay) < 2e-4
    assert found.channels[LINK].rms_error == pytest.approx(compared().channels[LINK].rms_error, rel=0.01)
    assert found.channels[MOTOR].rms_error > 5.0 * compared().channels[MOTOR].rms_error


def test_without_written_values_the_refit_stands_for_both() -> None:
    task = joint_task(recording(signals()), model(), NAME)
    found = compare(task, None, compared().noises)
    for channel in found.channels.values():
        np.testing.assert_array_equal(channel.residual, channel.refitted)
    np.testing.assert_array_equal(found.coefficients, found.refit.coefficients)


def test_the_wide_transmission_is_the_same_torsion_over_more_hertz() -> None:
    """For order spectra: the fit's band ends at 60 Hz here, the wide one at 122 Hz."""
    narrow = compared().dictionary.equations
    wide = with_wide_transmission(narrow)
    assert narrow.channels[TRANSMISSION].band.zero < wide.channels[TRANSMISSION].band.zero == BANDS[0][1]
    assert wide.channels[MOTOR] is narrow.channels[MOTOR]
    assert with_wide_transmission(wide) is wide
    torsion = narrow.derived.filled["joint_position"] - narrow.derived.filled["motor_position"]
    channel = wide.channels[TRANSMISSION]
    np.testing.assert_allclose(channel.left, narrow.spectral.filter(torsion, channel.band))
    assert not (channel.valid & channel.blurred(~narrow.derived.usable)).any()


def test_a_wave_of_the_gear_is_an_order_of_the_residual() -> None:
    """Kinematic error of order 2, 3e-5 rad: at its order, with its amplitude, in the residual as written."""
    wavy = Changes(kinematic=lambda x: (3e-5 * float(np.cos(2.0 * x)), -6e-5 * float(np.sin(2.0 * x))))
    task = joint_task(recording(signals(wavy)), model(), NAME)
    found = compare_task(task, model(), NAME, compared().noises)
    line, *_ = lines_of(order_spectrum([found.order_record(TRANSMISSION)], 100.0))
    assert line.order == pytest.approx(2.0, abs=line.resolution)
    assert line.amplitude == pytest.approx(3e-5, rel=0.1)


def test_a_free_run_of_the_right_model_follows_the_recording() -> None:
    """0.5 s from measured states with the recorded torque; holding the start values is wrong fifty times as much."""
    task = joint_task(recording(signals()), model(), NAME)
    side = LinkSide(model(), {NAME: signals()})
    found = horizons(task, signals(), joint_model(), side)
    assert found.why_not == "" and set(found.json()) == {f"{length:g}" for length in found.runs}
    short = found.json()["0.5"]
    assert short["windows"] > 10
    for name in ("motor_position", "joint_position"):
        assert short[name]["unit"] == "rad"
        assert short[name]["rms_error"] < 0.02 * short[name]["rms_error_hold"]
    run = found.runs[0.5]
    assert short["joint_torque"]["rms_error"] == float(run.rms_joint_torque[-1])


def test_a_free_run_says_what_it_needs() -> None:
    task = joint_task(recording(signals()), model(), NAME)
    bare = Model(None, {NAME: joint_model(without=("link_dynamics",))})
    found = horizons(task, signals(), joint_model(), LinkSide(bare, {NAME: signals()}))
    assert found.runs == {} and "neither robot description nor link inertia" in found.why_not
    blind = replace(signals(), motor_shaft_position=None)
    side = LinkSide(model(), {NAME: signals()})
    silent = task_of(replace(signals(), motor_torque=None), joint_model(), None)
    assert (
        horizons(silent, signals(), joint_model(), side).why_not == "a free run needs motor torque and motor position"
    )
    assert horizons(task, blind, joint_model(), side).why_not == "a free run needs motor torque and motor position"
    short = replace(
        task.equations, derived=replace(task.equations.derived, usable=task.equations.derived.usable & False)
    )
    assert horizons(replace(task, equations=short), signals(), joint_model(), side).why_not != ""
