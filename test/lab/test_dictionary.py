"""The dictionary of one joint: folds that do not leak, noise that is known, columns in their units."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from oracles.simple_joint import PERIOD
from plain_joint import equations
from test_balance_equations import noise_of

from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.balances.noise import ORDER, Noise, with_history
from hd_control.lab.balances.torsion import with_damping
from hd_control.lab.diagnosis.candidates import Candidate, Curve
from hd_control.lab.diagnosis.dictionary import RIDGE_CURVE, RIDGE_LIBRARY, SHARED, Blocks, Dictionary, base_of, build

ROWS = equations().states.time.size


def columns(seed: int, width: int = 2) -> np.ndarray:
    """Smooth columns (n, width) that no balance has."""
    time, random = np.arange(ROWS) * PERIOD, np.random.default_rng(seed)
    waves = [np.sin(2.0 * np.pi * random.uniform(0.2, 8.0) * time + random.uniform(0.0, 6.0)) for _ in range(width)]
    return np.stack(waves, axis=1)


CANDIDATES = (
    Candidate("rotor only", {MOTOR: columns(1)}),
    Candidate("everywhere", {MOTOR: columns(2, 1), TRANSMISSION: 1e-6 * columns(3, 1), LINK: columns(4, 1)}),
)


@lru_cache(maxsize=1)
def plain() -> Dictionary:
    """The plain joint with two candidates."""
    return build(equations(), CANDIDATES)


def test_every_row_has_one_fold_and_blocks_go_round() -> None:
    blocks = Blocks(length=0.5, guard=0.1, folds=3)
    time = np.arange(0.0, 6.0, 0.01)
    block, fold = blocks.of(time)
    np.testing.assert_array_equal(block, np.floor(time / 0.5 + 1e-9))
    inside = fold >= 0
    np.testing.assert_array_equal(fold[inside], block[inside] % 3)
    within = np.mod(time, 0.5)
    guard = (within < 0.05 - 1e-9) | (within > 0.45 + 1e-9)
    assert not inside[guard].any() and inside[(within > 0.051) & (within < 0.449)].all()


def test_what_is_held_out_is_never_next_to_what_is_fitted() -> None:
    """Rows of different folds lie apart by the guard, for all rows of a real dictionary."""
    for part in plain().rows.values():
        order = np.flatnonzero(part.fold >= 0)
        changes = np.diff(part.fold[order]) != 0
        assert np.diff(part.time[order])[changes].min() >= Blocks().guard
        assert set(part.fold.tolist()) == {-1, *range(Blocks().folds)}
        assert 0.04 < np.mean(part.fold < 0) < 0.12, "the guards cost 0.05 of 0.66 s"


def test_columns_have_unit_norm_and_their_physical_size_is_the_norm() -> None:
    """Over all channels together, for a coefficient that acts on several is one."""
    found = plain()
    squares = np.zeros(found.size)
    for part in found.rows.values():
        np.add.at(squares, part.index, (part.columns**2).sum(axis=0))
    np.testing.assert_allclose(squares, 1.0, rtol=1e-9)
    (_, everywhere) = found.groups
    for name, candidate in CANDIDATES[1].columns.items():
        part = found.rows[name]
        at = int(np.flatnonzero(part.index == everywhere.index[0])[0])
        np.testing.assert_allclose(
            part.columns[:, at] * found.norm[everywhere.index[0]],
            found.whitened({name: candidate})[name][:, 0],
            rtol=1e-6,
        )


def test_rows_are_the_whitened_rows_of_the_balance() -> None:
    found = plain()
    for name, part in found.rows.items():
        white = part.noise.whiten(part.channel.left)[part.usable] * part.weight
        np.testing.assert_allclose(part.left, white)
        np.testing.assert_allclose(part.weight, 1.0 / part.noise.level(
            equations().states.motor_velocity[:: part.channel.band.step][part.usable]))  # fmt: skip
        history = with_history(part.channel.valid)
        np.testing.assert_array_equal(part.usable, part.channel.fitted & history)
        index = base_of(part.channel, found.base_names)
        raw = part.noise.whiten(part.channel.base_matrix)[part.usable] * part.weight[:, None]
        np.testing.assert_allclose(
            part.columns[:, : index.size] * found.norm[index], raw, atol=1e-9 * np.abs(raw).max()
        )
        assert name == part.channel.name


def test_a_delay_of_the_gauge_is_one_number_in_two_balances() -> None:
    found = plain()
    shared = found.base_index(MOTOR, "torque_delay")
    assert shared is not None and shared == found.base_index(LINK, "torque_delay")
    assert found.base_names[shared] == (SHARED, "torque_delay")
    assert found.base_index(MOTOR, "drive_torque") != found.base_index(LINK, "drive_torque")
    assert found.base_index(TRANSMISSION, "torque_delay") == shared and found.base_index(MOTOR, "nothing") is None
    np.testing.assert_array_equal(found.base, np.arange(len(found.base_names)))


def test_priors_are_precisions_in_physical_units() -> None:
    found = plain()
    by_name = dict(zip(found.base_names, found.precision, strict=False))
    assert by_name[MOTOR, "command_delay"] == pytest.approx(1.0 / 3e-5**2)
    assert by_name[SHARED, "torque_delay"] == pytest.approx(1.0 / 5e-4**2)
    assert by_name[MOTOR, "drive_torque"] == 0.0, "nothing is known of a"
    assert (found.precision[len(found.base_names) :] == 0.0).all()


def test_curves_get_a_ridge_and_laws_hardly_any() -> None:
    knots = np.linspace(0.0, 1.0, 4)
    plain_curve = Curve("c", ("time",), lambda s: {MOTOR: columns(5)}, knots, "time")
    bent = Curve("d", ("time", "speed"), lambda s: {MOTOR: columns(6)}, knots, "time", "with speed")
    more = [Candidate(c.name, {MOTOR: columns(k)}, curve=c) for k, c in ((5, plain_curve), (6, bent))]
    found = build(equations(), [CANDIDATES[0], *more])
    law, first, second = (found.ridge[group.index] for group in found.groups)
    assert (law == RIDGE_LIBRARY).all() and (first == RIDGE_CURVE["plain"]).all() and (second > first.max()).all()


def test_the_noise_is_that_of_the_sensors() -> None:
    """The richest model leaves white sensor noise: its RMS in the band within 6 %, and unit variance when whitened."""
    found = build(equations(), ())
    for name in (TRANSMISSION, LINK):
        noise = found.rows[name].noise
        assert noise.deviation == pytest.approx(noise_of(equations().channels[name]), rel=0.06)
        part = found.rows[name]
        white = part.left - part.columns @ np.linalg.lstsq(part.columns, part.left, rcond=None)[0]
        assert np.mean(white**2) == pytest.approx(1.0, abs=0.1)
    # On the rotor the corners at stops stay beside the noise.
    assert 1.0 < found.rows[MOTOR].noise.deviation / noise_of(equations().channels[MOTOR]) < 1.2


@pytest.mark.parametrize("level", [1e-3, 1.0])
def test_a_missing_effect_raises_the_noise_only_until_its_column_is_there(level: float) -> None:
    """What the dictionary can explain is no noise, however large it is."""
    wave = columns(7, 1)
    there = equations().channels[LINK]
    moving = replace(there, left=there.left + level * there.rows_of(wave)[:, 0])
    spoiled = replace(equations(), channels={**equations().channels, LINK: moving})
    missing, explained = build(spoiled, ()), build(spoiled, [Candidate("wave", {LINK: wave})])
    true = noise_of(there)
    assert explained.rows[LINK].noise.deviation == pytest.approx(true, rel=0.07)
    assert (missing.rows[LINK].noise.deviation > 3.0 * true) == (level > 0.5)


def test_given_noises_are_taken_as_they_are() -> None:
    noises = {name: Noise(np.zeros(ORDER), 2.0, 2.0) for name in equations().channels}
    found = build(equations(), CANDIDATES, noises=noises)
    assert found.noises == noises
    part = found.rows[LINK]
    np.testing.assert_allclose(part.left, part.channel.left[part.usable] / 2.0)


def same(a: Dictionary, b: Dictionary, tolerance: float = 1e-9) -> None:
    """Two dictionaries with the same rows in the same units."""
    np.testing.assert_allclose(a.norm, b.norm, rtol=tolerance)
    assert a.rows.keys() == b.rows.keys()
    for name, part in a.rows.items():
        other = b.rows[name]
        np.testing.assert_array_equal(part.index, other.index)
        np.testing.assert_allclose(part.left, other.left, atol=tolerance * np.abs(other.left).max())
        np.testing.assert_allclose(part.columns, other.columns, atol=tolerance)
        np.testing.assert_array_equal(part.fold, other.fold)
        assert part.noise.scale == pytest.approx(other.noise.scale)
        assert part.noise.deviation == pytest.approx(other.noise.deviation)


def test_candidates_that_come_later_stand_as_if_they_had_been_there() -> None:
    early = build(equations(), CANDIDATES, noises=plain().noises)
    late = build(equations(), CANDIDATES[:1], noises=plain().noises).with_candidates(CANDIDATES[1:])
    same(late, early, 1e-5)  # columns of one call are filtered in single precision together
    assert [g.name for g in late.groups] == [g.name for g in early.groups]
    np.testing.assert_array_equal(late.groups[1].index, early.groups[1].index)
    assert late.ridge.size == late.precision.size == late.size


def test_in_the_units_of_a_fit_columns_grow_and_the_white_left_side_stays() -> None:
    """left / a in noise / a is the same white row; a column per left side weighs a times more."""
    scales = {MOTOR: 1.25, LINK: 0.8}
    found = plain().rescaled(scales)
    for name, part in found.rows.items():
        factor, old = scales.get(name, 1.0), plain().rows[name]
        np.testing.assert_allclose(part.left, old.left)
        np.testing.assert_allclose(
            part.columns * found.norm[part.index], factor * old.columns * plain().norm[old.index], rtol=1e-9, atol=1e-12
        )
        assert part.noise.scale == pytest.approx(old.noise.scale / factor)
    # As if it had been built from the rescaled balances.
    noises = {name: noise.divided(scales.get(name, 1.0)) for name, noise in plain().noises.items()}
    same(found, build(equations().with_scales(scales), CANDIDATES, noises=noises))


def test_louder_noise_makes_every_row_smaller() -> None:
    found = plain().louder({MOTOR: 2.0})
    noises = {**plain().noises, MOTOR: plain().noises[MOTOR].divided(0.5)}
    same(found, build(equations(), CANDIDATES, noises=noises))
    np.testing.assert_allclose(found.rows[MOTOR].left, plain().rows[MOTOR].left / 2.0)


def test_rows_that_are_left_out_are_gone_everywhere() -> None:
    blind = np.zeros(plain().rows[LINK].channel.time.size, bool)
    blind[500:900] = True
    found = plain().without_rows({LINK: blind})
    part, old = found.rows[LINK], plain().rows[LINK]
    keep = ~blind[old.usable]
    assert 0 < keep.size - keep.sum() <= 400
    for name in ("left", "time", "fold", "block", "weight"):
        np.testing.assert_array_equal(getattr(part, name), getattr(old, name)[keep])
    np.testing.assert_array_equal(part.usable, old.usable & ~blind)
    physical = part.columns * found.norm[part.index]
    np.testing.assert_allclose(physical, (old.columns * plain().norm[old.index])[keep], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(found.rows[MOTOR].left, plain().rows[MOTOR].left)


def test_another_damping_changes_the_columns_of_the_torsion_only() -> None:
    moved = with_damping(equations(), 2e-3)
    found = plain().with_base(moved, TRANSMISSION)
    same(found, build(moved, CANDIDATES, noises=plain().noises))
    old = plain().rows[TRANSMISSION]
    assert np.abs(found.rows[TRANSMISSION].columns - old.columns).max() > 1e-4
    np.testing.assert_allclose(found.rows[MOTOR].columns, plain().rows[MOTOR].columns, atol=1e-12)


def test_what_the_model_holds_joins_the_base() -> None:
    found = build(equations(), CANDIDATES[1:], fixed=[CANDIDATES[0], Candidate("nowhere", {})])
    assert [g.name for g in found.known] == ["rotor only"] and [g.name for g in found.groups] == ["everywhere"]
    assert found.base.size == len(found.base_names) + 2 and set(found.known[0].index) <= set(found.base)
    assert found.rows_touched(found.known[0]) == found.rows[MOTOR].left.size
    assert found.rows_touched(found.groups[0]) == sum(part.left.size for part in found.rows.values())
