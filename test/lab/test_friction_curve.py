"""Friction curves of joints whose friction is known: by direction, load and temperature, for all sets of signals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from oracles.simple_joint import Changes
from plain_joint import PLAIN, equations, known, link_of, signals

from hd_control.lab.balances.channels import JointEquations
from hd_control.lab.balances.equations import build_equations
from hd_control.lab.maps.friction_curve import FrictionCurve, friction_curves, speed_edges
from hd_control.lab.signals.joint_signals import JointSignals

RATE = 200.0
INERTIA, GRAVITY = 0.7, 12.0


def recorded(
    friction: Callable[[np.ndarray], np.ndarray],
    signal: str = "gauge_torque",
    seconds: float = 120.0,
    noise: float = 0.02,
    late: int = 0,
    tones: tuple[float, ...] = (0.11, 0.23, 0.61, 1.3),
) -> JointSignals:
    """One torque sensor and an angle: inertia, gravity of one link and `friction(velocity)`."""
    time = np.arange(round(seconds * RATE)) / RATE
    omega = 2.0 * np.pi * np.array(tones)[:, None]
    q = (0.25 / np.array(tones)[:, None] ** 0.5 * np.sin(omega * time + omega)).sum(axis=0)
    v = (0.25 / np.array(tones)[:, None] ** 0.5 * omega * np.cos(omega * time + omega)).sum(axis=0)
    a = -(0.25 / np.array(tones)[:, None] ** 0.5 * omega**2 * np.sin(omega * time + omega)).sum(axis=0)
    random = np.random.default_rng(1)
    torque = np.roll(INERTIA * a + GRAVITY * np.sin(q) + friction(v), late) + noise * random.standard_normal(time.size)
    position = q + 1e-6 * random.standard_normal(time.size)
    return JointSignals("j", time, 1.0 / RATE, np.ones(time.size, bool), joint_position=position, **{signal: torque})


def balances(recording: JointSignals) -> JointEquations:
    return build_equations(recording, known(), None)


def inside(curve: FrictionCurve, direction: int, true: Callable[[float], float]) -> float:
    """Share of the points whose interval holds the truth at their speed."""
    points = [p for p in curve.of(direction) if np.isfinite(p.low)]
    assert points
    return float(np.mean([p.low - 0.01 <= true(p.speed) <= p.high + 0.01 for p in points]))


def coulomb_viscous(v: np.ndarray) -> np.ndarray:
    return 4.0 * np.sign(v) + 1.5 * v


@pytest.mark.parametrize("signal", ["gauge_torque", "motor_torque"])
def test_one_torque_and_an_angle_give_the_curve(signal: str) -> None:
    """No gravity is known: it is fitted. The motor torque is held, half a sample late, which the interval allows."""
    (curve,) = friction_curves(balances(recorded(coulomb_viscous, signal)))
    assert curve.signal == signal and any("gravity fitted" in text for text in curve.removed)
    assert len(curve.of(0)) >= 6
    for direction in (-1, 0, 1):
        assert inside(curve, direction, lambda v: 4.0 + 1.5 * v) >= 0.8
    for point in curve.of(0):
        assert point.torque == pytest.approx(4.0 + 1.5 * point.speed, rel=0.05)


def test_a_stribeck_shape_is_followed_where_no_model_has_it() -> None:
    def friction(v: np.ndarray) -> np.ndarray:
        return np.sign(v) * (3.0 + 2.0 * np.exp(-((v / 0.15) ** 2)))

    (curve,) = friction_curves(balances(recorded(friction)))
    found = {p.speed: p.torque for p in curve.of(0)}
    slow, fast = min(found), max(found)
    assert found[slow] == pytest.approx(3.0 + 2.0 * np.exp(-((slow / 0.15) ** 2)), abs=0.12)
    assert found[fast] == pytest.approx(3.0, abs=0.1)


def test_an_offset_is_no_friction_where_gravity_is_fitted() -> None:
    (plain,) = friction_curves(balances(recorded(coulomb_viscous)))
    (moved,) = friction_curves(balances(recorded(lambda v: coulomb_viscous(v) + 0.8)))
    for a, b in zip(plain.of(1), moved.of(1), strict=True):
        assert b.torque == pytest.approx(a.torque, abs=1e-6)


def test_directions_stay_apart() -> None:
    found = friction_curves(equations(Changes(rotor=lambda _p, v, _t, _s: 1.0)))
    motor = next(curve for curve in found if curve.signal == "motor_torque")
    pairs = [(f, b) for f in motor.of(1) for b in motor.of(-1) if 0.95 < f.speed / b.speed < 1.05]
    assert pairs, "the same bins both ways"
    for forward, backward in pairs:
        assert 0.5 * (forward.torque - backward.torque) == pytest.approx(1.0, abs=0.15)


def test_with_a_gauge_the_motor_side_is_left_and_the_link_side_is_clean() -> None:
    """The plain joint: 4 N m and 8 N m s before the gauge, none behind it."""
    motor, gauge = friction_curves(equations())
    assert (motor.signal, gauge.signal) == ("motor_torque", "gauge_torque")
    assert "gauge torque subtracted" in motor.removed
    for point in motor.of(0):
        assert point.torque == pytest.approx(PLAIN.coulomb + PLAIN.viscous * point.speed, rel=0.04)
    assert any("rigid-body torque subtracted" in text for text in gauge.removed)
    for point in gauge.of(0):
        assert abs(point.torque) < 0.15


def test_load_and_temperature_split_the_curve() -> None:
    def coulomb(_v: float, tau: float, t: float) -> float:
        return 0.1 * abs(tau) - 0.03 * t

    changes = Changes(coulomb=coulomb, temperature=lambda t: 25.0 + 0.4 * t)
    motor, _ = friction_curves(equations(changes))
    by_load = [g for g in motor.groups if g.variable == "load"]
    by_heat = [g for g in motor.groups if g.variable == "temperature"]
    assert len(by_load) == len(by_heat) == 3 and (by_load[0].unit, by_heat[0].unit) == ("N m", "deg C")

    def middle(group: object) -> float:
        points = [p for p in motor.groups[group] if p.direction == 0]  # type: ignore[index]
        return float(np.mean([p.torque - PLAIN.viscous * p.speed for p in points]))

    light, _, heavy = map(middle, by_load)
    load = 0.5 * (by_load[2].low + by_load[2].high - by_load[0].low - by_load[0].high)
    assert heavy - light == pytest.approx(0.1 * load, rel=0.3)
    cold, _, warm = map(middle, by_heat)
    assert warm < cold


def test_a_delay_bends_the_curve_and_a_measured_one_is_taken_out() -> None:
    wrong = balances(recorded(coulomb_viscous, late=10))
    (bent,) = friction_curves(wrong)
    (mended,) = friction_curves(wrong, {"gauge_torque": (10.0 / RATE, 1e-3)})
    assert "gauge_torque taken 50 ms earlier, as measured" in mended.removed
    off = max(abs(p.torque - 4.0 - 1.5 * p.speed) for p in bent.of(0))
    assert max(abs(p.torque - 4.0 - 1.5 * p.speed) for p in mended.of(0)) < 0.15 * off
    assert bent.per_ms > 0.0, "and how much a millisecond does is said"


def test_intervals_grow_with_noise_and_allow_for_half_a_sample() -> None:
    quiet, loud = (friction_curves(balances(recorded(coulomb_viscous, noise=n)))[0] for n in (0.02, 2.0))
    width = [np.nanmedian([p.high - p.low for p in curve.of(0)]) for curve in (quiet, loud)]
    assert width[1] > 1.5 * width[0]
    for point in quiet.of(0):
        assert not point.high - point.low < 0.0


def test_nothing_that_slides_or_one_direction_gives_no_curve() -> None:
    still = recorded(coulomb_viscous)
    still = replace(still, joint_position=1e-7 * np.sin(still.time), gauge_torque=still.gauge_torque * 0.0 + 1.0)
    assert friction_curves(balances(still)) == ()
    one_way = recorded(coulomb_viscous)
    one_way = replace(one_way, joint_position=0.2 * one_way.time, gauge_torque=np.full(one_way.time.size, 4.3))
    assert friction_curves(balances(one_way)) == (), "a constant torque one way may be gravity"
    short = replace(
        one_way, time=one_way.time[:60], valid=one_way.valid[:60], joint_position=one_way.joint_position[:60],
        gauge_torque=one_way.gauge_torque[:60],
    )  # fmt: skip
    assert friction_curves(balances(short)) == ()


def test_the_json_holds_every_point() -> None:
    motor, _ = friction_curves(equations())
    document = motor.json()
    assert json.loads(json.dumps(document)) == document
    assert [p["torque"] for p in document["points"]] == [p.torque for p in motor.points]
    assert set(document["points"][0]) == {"direction", "speed", "torque", "low", "high", "seconds"}


def test_edges_are_logarithmic_and_hold_the_speeds() -> None:
    speed = np.geomspace(0.02, 2.0, 5000)
    edges = speed_edges(speed, 8, 14)
    assert edges.size == 15 and np.allclose(np.diff(np.log(edges)), np.log(edges[1] / edges[0]))
    assert edges[0] < np.quantile(speed, 0.02) and edges[-1] > np.quantile(speed, 0.99)
    assert speed_edges(np.full(50, 0.3), 8, 14).size == 2


def test_links_that_are_known_are_taken_out_with_their_scale() -> None:
    """The gauge of the plain joint reads 1.1 times too much: the rest is no friction."""
    whole = signals()
    wrong = replace(whole, gauge_torque=1.1 * whole.gauge_torque)
    _, gauge = friction_curves(build_equations(wrong, known(), link_of(wrong)))
    assert max(abs(p.torque) for p in gauge.of(0)) < 0.3
