"""hd reproduce gandhi: the quick rows meet their targets, and each part of the comparison does what it says."""

import numpy as np
import pytest

from hd_control.papers import gandhi
from hd_control.papers.gandhi_runs import Experiment, law_values, reference, run, turned
from hd_control.papers.rows import document, load_constants


@pytest.fixture(scope="module")
def quick():
    return {row.id: row for row in gandhi.rows(True, 0, print, seeds=1)}


def test_targets_are_met(quick):
    assert quick["gandhi.error_deg"].met and quick["gandhi.error_deg"].target == 1e-4
    assert quick["gandhi.ratio_to_eq31"].met and quick["gandhi.ratio_to_eq31"].target == 3000
    assert quick["gandhi.eq31.error_deg"].ours > 0.5


def test_rows_name_what_was_chosen(quick):
    found = document(list(quick.values()), 0)
    assert found["schema"] == "hd.reproduce/1"
    for row in found["rows"]:
        assert any("stiffness_linear K = 10000 N m/rad" in text for text in row["chosen"])
        assert not any("rotor_inertia" in text for text in row["chosen"])


def test_prediction_helps_at_every_period(quick):
    for period in ("0p5ms", "1ms"):
        names = [f"gandhi.period.{period}{tag}.error_deg" for tag in ("", ".unpredicted")]
        assert quick[names[0]].ours < quick[names[1]].ours


def test_each_slow_term_lowers_the_error():
    errors = [run(Experiment(c, period=1e-4)).largest_deg for c in ("comparison", "tau_0", "tau_1", "all")]
    assert errors == sorted(errors, reverse=True)
    assert errors[1] > 50 * errors[2] > 50 * 5 * errors[3]


def test_kinematic_error_known_is_absorbed_wherever_it_stands():
    """The law gets the assembly phase; with another one it fails."""
    turned_gear = Experiment(period=1e-4, phase=2.0)
    wrong = {name: value[0] for name, value in law_values(load_constants("gandhi"), Experiment()).items()
             if name.startswith("kinematic")}  # fmt: skip
    assert run(turned_gear).largest_deg < 3e-4
    assert run(Experiment(period=1e-4, phase=2.0, law=tuple(wrong.items()))).largest_deg > 0.05


def test_the_full_model_costs_little(quick):
    """Fig. 6: C-2 is hardly different, beside the plain law."""
    full = run(Experiment(nonlinear=True)).largest_deg
    assert quick["gandhi.error_deg"].ours < full < 0.05 < quick["gandhi.eq31.error_deg"].ours / 10


def test_a_law_that_knows_the_spring_beats_c2():
    c = load_constants("gandhi")
    spring = tuple((name, c[name]) for name in ("stiffness_cubic", "stiffness_quintic"))
    blind, knowing = (run(Experiment(period=1e-4, nonlinear=True, law=law)).largest_deg for law in ((), spring))
    assert knowing < 3e-4 < 0.05 < blind


def test_quantised_encoders_leave_most_of_the_gain():
    ours, plain = gandhi.sensor_rows(0, 1)
    assert ours.ours < 0.04 and plain.ours > 8.0


def test_a_run_repeats_bit_for_bit():
    experiment = Experiment(period=1e-3, phase=gandhi.phases(7, 1)[0])
    first = run(experiment)
    run.cache_clear()
    np.testing.assert_array_equal(first.measured, run(experiment).measured)


def test_reference_derivatives_belong_together():
    c, step = load_constants("gandhi"), 1e-5
    rows = reference(c, np.array([1.0 - step, 1.0, 1.0 + step]))
    slopes = (rows[2] - rows[0]) / (2 * step)
    for lower, upper in ((0, 1), (1, 2), (2, 3), (3, 4), (5, 6), (6, 7)):
        assert slopes[lower] == pytest.approx(rows[1, upper], rel=1e-6, abs=1e-6)


def test_turned_series_is_the_same_series(rng):
    cosine, sine, angle, n = rng.normal(size=4), rng.normal(size=4), 0.7, np.arange(1, 5)
    a, b = turned(cosine, sine, 0.4)
    wanted = cosine @ np.cos(n * (angle + 0.4)) + sine @ np.sin(n * (angle + 0.4))
    assert a @ np.cos(n * angle) + b @ np.sin(n * angle) == pytest.approx(wanted, rel=1e-12)


def test_wrong_parameters_stay_within_their_share():
    right = {name: value[0] for name, value in law_values(load_constants("gandhi"), Experiment()).items()
             if isinstance(value, list) and isinstance(value[0], float)}  # fmt: skip
    wrong = dict(gandhi.wrong_parameters(3))
    assert wrong != dict(gandhi.wrong_parameters(4))
    for name, value in wrong.items():
        assert abs(value - right[name]) <= 0.1 * abs(right[name]) + 1e-15
    changed = [name for name in wrong if right[name] != 0.0]
    assert all(wrong[name] != right[name] for name in changed) and len(changed) >= 9


def test_quick_figures_have_series():
    for title, figure in gandhi.figures(True, 0, print):
        assert title.startswith("Fig.") and len(figure.data) >= 3
        assert all(len(series.x) > 100 for series in figure.data)
