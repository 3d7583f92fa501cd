"""Puzzles of the second world: deterministic, sealed, as clear as they say; what the world always has is neutral."""

import json

import numpy as np
import pytest

from hd_sim.puzzles.puzzle import score_joint
from hd_sim.puzzles.recordings import FIT_S, HELD_OUT_S
from hd_sim.puzzles.second import (
    TARGETS,
    chosen_second,
    draw_second,
    make_second_pair,
    record_second,
    second_model,
    set_up_second,
)
from hd_sim.second_world.plant import JOINT, PERIOD, draw_plant, simulate
from hd_sim.second_world.visibility import BRIDGE, LINK, ROTOR, make_filter, oracle_gain


def test_a_seed_gives_the_same_pair():
    one, again = make_second_pair(12, "one"), make_second_pair(12, "one")
    assert one.case == again.case and one.truth == again.truth and one.model == again.model
    assert all(np.array_equal(one.fit[name], again.fit[name]) for name in one.fit)
    assert one.fit["time"].size == round(FIT_S / PERIOD) and one.held_out["time"].size == round(HELD_OUT_S / PERIOD)


def test_the_model_says_nothing_of_what_is_hidden():
    plain, hidden = chosen_second(5, {}), chosen_second(5, {"payload": 2.0, "gauge_gain": 2.0})
    assert second_model(plain.plant) == second_model(hidden.plant) and plain.plant.urdf() == hidden.plant.urdf()
    assert "visibility" in record_second(hidden).truth["joints"][JOINT]
    assert "visibility" not in json.dumps(second_model(hidden.plant))


def test_cases_are_drawn_in_the_shares_of_the_mix():
    cases = [draw_second(seed)[0] for seed in range(400)]
    share = [sum(case.category == name for case in cases) / 400 for name in ("none", "one", "two", "unknown", "poor")]
    assert share == pytest.approx([0.3, 0.35, 0.15, 0.1, 0.1], abs=0.06)
    assert all(len(case.names) == 1 for case in cases if case.category == "one")


def test_strengths_follow_the_gain_that_was_drawn():
    for seed in (3, 7):
        _, targets = draw_second(seed, "one")
        bench = set_up_second(seed, "one")
        gains = record_second(bench).truth["joints"][JOINT]["visibility"]
        for effect in bench.case.effects:
            assert TARGETS[0] / 20 < targets[effect.name] < TARGETS[1] * 20
            if 0.02 < effect.strength < 5.0:
                # some laws are not linear in their strength: a factor of four is allowed, the range is one of thousand
                assert targets[effect.name] / 4.0 < gains[effect.name] < 4.0 * targets[effect.name]


def answer(name, **parameters):
    given = {key: {"value": value} for key, value in parameters.items()}
    return {"verdict": "missing", "unknown": None, "effects": [{"name": name, "confidence": 0.9, "parameters": given}]}


def test_what_the_world_always_has_is_neutral_within_its_bounds_only():
    truth = {"names": [], "unknown": [], "parameters": {}}
    neutral = {"presliding": {}, "motor_cogging": {"cogging_order": (23.8, 24.2)}}
    for found, wrong in (
        (answer("presliding"), ()),
        (answer("motor_cogging", cogging_order=24.0), ()),
        (answer("motor_cogging", cogging_order=6.0), ("motor_cogging",)),
        (answer("motor_cogging"), ("motor_cogging",)),
        (answer("backlash"), ("backlash",)),
    ):
        score = score_joint(found, truth, (), neutral)
        assert score.wrong == wrong and score.false_alarm is bool(wrong)


def test_friction_that_grows_with_the_load_may_be_called_so():
    truth = {"names": [], "unknown": ["viscous_over_load"], "parameters": {}}
    tolerated = chosen_second(5, {"viscous_over_load": 1.0}).case.tolerated
    score = score_joint(answer("load_dependent_friction"), truth, tolerated)
    assert tolerated == ("load_dependent_friction",) and score.unknown_flagged and score.unknown_variable
    other = score_joint(answer("payload"), truth, tolerated)
    assert other.wrong == ("payload",) and not other.unknown_flagged


def test_the_oracle_is_the_likelihood_of_a_dense_solve():
    """Gain = 1/2 y' V^-1 y, V the covariance of all readings of a short run, built without a filter."""
    plant = draw_plant(6)
    n, rng = 40, np.random.default_rng(0)
    truths = {name: rng.standard_normal(n) * 1e-3 for name in ("set_point", "motor_velocity", "joint_torque")}
    predictor = make_filter(plant, truths)
    force = np.zeros(n)
    force[5:9] = 1.0
    for kind in (ROTOR, LINK, BRIDGE):
        dense = dense_gain(plant, truths, kind, force)
        assert oracle_gain(predictor, {kind: force}, []) == pytest.approx(dense, rel=1e-6)


def dense_gain(plant, truths, kind, force):
    from hd_sim.second_world import visibility as v

    a, b, c, q, r = v.core(plant, truths)
    row, n = v.KINDS.index(kind), force.size
    into = b[:, row] if row < 3 else np.zeros(4)
    direct = np.eye(3)[row - 3] if row >= 3 else np.zeros(3)
    readings, state = np.zeros((n, 3)), np.zeros(4)
    for k in range(n):
        readings[k] = c @ state + direct * force[k]
        state = a @ state + into * force[k]
    from scipy.linalg import solve_discrete_are

    first = solve_discrete_are(a.T, c.T, q, r)
    states = np.zeros((4 * n, 4 * n))
    covariance = first
    for i in range(n):
        block = covariance
        for j in range(i, n):
            states[4 * j : 4 * j + 4, 4 * i : 4 * i + 4] = block
            states[4 * i : 4 * i + 4, 4 * j : 4 * j + 4] = block.T
            block = a @ block
        covariance = a @ covariance @ a.T + q
    seen = np.kron(np.eye(n), c)
    total = seen @ states @ seen.T + np.kron(np.eye(n), r)
    return 0.5 * readings.ravel() @ np.linalg.solve(total, readings.ravel())


def test_the_gain_grows_with_the_square_and_shrinks_beside_its_like():
    plant = draw_plant(6)
    reference_free = {"set_point": np.zeros(200), "motor_velocity": np.zeros(200), "joint_torque": np.zeros(200)}
    predictor = make_filter(plant, reference_free)
    force = np.sin(np.arange(200) / 7.0)
    one = oracle_gain(predictor, {ROTOR: force}, [])
    assert oracle_gain(predictor, {ROTOR: 3.0 * force}, []) == pytest.approx(9.0 * one)
    assert oracle_gain(predictor, {ROTOR: force}, [{ROTOR: 0.1 * force}]) == pytest.approx(0.0, abs=1e-9 * one)
    assert 0.0 < oracle_gain(predictor, {ROTOR: force}, [{LINK: force}]) < one
    assert oracle_gain(predictor, {}, []) == 0.0


def test_a_pair_takes_no_look_at_the_library():
    import subprocess
    import sys

    code = (
        "import sys, hd_sim.second_world.hidden, hd_sim.second_world.visibility\n"
        "ours = ('hd_control.drive', 'hd_control.lab', 'hd_sim.plant')\n"
        "print([name for name in sys.modules if name.startswith(ours)])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert simulate.__module__ == "hd_sim.second_world.plant"
