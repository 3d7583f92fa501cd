"""The filter against a dense solve, and columns against a perturbed simulation of the same core."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from hd_control._innovations import Filter, Joint
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION
from hd_control.lab.innovations.core import SENSORS, Core, Numbers, Readings

INERTIA, LINK_INERTIA, STIFFNESS, DAMPING, PERIOD = 1.3, 2.1, 9000.0, 6.0, 1e-3
SPREAD = [1e-2, 2.0, 1e-2, 2.0]
NOISE = np.array([2e-6, 1e-5, 0.05])
FORCES = np.array([0.3, 0.02])
SAMPLES = 60


def continuous(link: float) -> np.ndarray:
    k, c = STIFFNESS, DAMPING
    rotor, load = np.array([-k, -c, k, c]) / INERTIA, np.array([k, c, -k, -c]) / link
    return np.array([[0, 1, 0, 0], rotor, [0, 0, 0, 1], load])


def discrete(link: float) -> tuple[np.ndarray, np.ndarray]:
    whole = np.zeros((6, 6))
    whole[:4, :4] = continuous(link)
    whole[1, 4], whole[3, 5] = 1.0 / INERTIA, 1.0 / link
    moved = expm(PERIOD * whole)
    return moved[:4, :4], moved[:4, 4:]


def sensors() -> np.ndarray:
    return np.array([[1, 0, 0, 0], [0, 0, 1, 0], [STIFFNESS, DAMPING, -STIFFNESS, -DAMPING]])


def links(varying: bool) -> np.ndarray:
    return LINK_INERTIA * (1.0 + (0.3 * np.sin(np.arange(SAMPLES) / 9.0) if varying else np.zeros(SAMPLES)))


def made(varying: bool = False, there: tuple[bool, ...] = (True,) * 3, valid: np.ndarray | None = None) -> Filter:
    joint = Joint(INERTIA, STIFFNESS, DAMPING, PERIOD)
    variance = np.where(np.array(there), NOISE**2, np.inf) * np.ones((SAMPLES, 1))
    inertia = links(varying) if varying else links(False)[:1]
    seen = np.ones(SAMPLES, dtype=bool) if valid is None else valid
    return Filter(joint, inertia, variance, np.tile(FORCES**2, (SAMPLES, 1)), seen, SPREAD)


def simulated(force: np.ndarray, varying: bool = False) -> np.ndarray:
    """Readings (n, 3) without noise of a joint at rest that `force` (n, 2) moves."""
    x, found = np.zeros(4), np.empty((SAMPLES, 3))
    for k, link in enumerate(links(varying)):
        f, g = discrete(link)
        found[k] = sensors() @ x
        x = f @ x + g @ force[k]
    return found


def given(readings: np.ndarray, there: tuple[bool, ...] = (True,) * 3) -> dict[str, np.ndarray]:
    names = ("motor_sensor", "joint_sensor", "torque_sensor")
    return {name: np.ascontiguousarray(readings[:, i : i + 1]) for i, name in enumerate(names) if there[i]}


@pytest.mark.parametrize("link", [0.05, 2.1, 40.0])
def test_a_step_is_the_matrix_exponential(link: float) -> None:
    for stiffness_period in (1e-3, 1e-2):
        joint = Joint(INERTIA, STIFFNESS, DAMPING, stiffness_period)
        whole = np.zeros((6, 6))
        whole[:4, :4] = continuous(link)
        whole[1, 4], whole[3, 5] = 1.0 / INERTIA, 1.0 / link
        moved = expm(stiffness_period * whole)
        f, g = joint.step(link)
        assert np.allclose(f, moved[:4, :4], rtol=1e-9, atol=1e-9 * np.abs(moved[:4, :4]).max())
        assert np.allclose(g, moved[:4, 4:], rtol=1e-9, atol=1e-9 * np.abs(moved[:4, 4:]).max())


@pytest.mark.parametrize("there", [(True, True, True), (True, False, True), (False, True, False), (True, True, False)])
@pytest.mark.parametrize("varying", [False, True])
def test_innovations_are_readings_whitened_by_their_dense_covariance(there: tuple[bool, ...], varying: bool) -> None:
    count = sum(there)
    c, noise = sensors()[list(there)], NOISE[list(there)]
    states = [np.diag(np.array(SPREAD) ** 2)]
    maps = [discrete(link) for link in links(varying)]
    cross = np.zeros((SAMPLES, SAMPLES, 4, 4))
    for k in range(SAMPLES):
        cross[k, k] = states[-1]
        for j in range(k + 1, SAMPLES):
            cross[j, k] = maps[j - 1][0] @ cross[j - 1, k]
            cross[k, j] = cross[j, k].T
        f, g = maps[k]
        states.append(f @ states[-1] @ f.T + g @ np.diag(FORCES**2) @ g.T)
    covariance = np.einsum("ai,jkil,bl->jakb", c, cross, c).reshape(SAMPLES * count, -1)
    covariance += np.diag(np.tile(noise**2, SAMPLES))
    draw = np.linalg.cholesky(covariance) @ np.random.default_rng(3).standard_normal(SAMPLES * count)
    readings = np.zeros((SAMPLES, 3))
    readings[:, list(there)] = draw.reshape(SAMPLES, count)
    found = made(varying, there).respond([1.0], 1, True, **given(readings, there))[:, :, 0].T
    wanted = np.linalg.solve(np.linalg.cholesky(covariance), draw).reshape(SAMPLES, count)
    assert np.abs(found - wanted).max() < 1e-4
    assert np.abs(wanted).max() > 1.0


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("balance", [0, 1])
def test_a_force_adds_what_a_simulation_with_it_adds(balance: int, varying: bool) -> None:
    force = np.zeros((SAMPLES, 2))
    force[:, balance] = np.sin(np.arange(SAMPLES) / 5.0)
    column = {("rotor", "link")[balance]: np.ascontiguousarray(force[:, balance : balance + 1])}
    found = made(varying).respond([1.0], 1, False, **column)
    wanted = made(varying).respond([1.0], 1, True, **given(simulated(force, varying)))
    assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_many_columns_are_each_alone_and_sums_of_rows_are_low_passed() -> None:
    columns = np.random.default_rng(0).standard_normal((SAMPLES, 13))
    together = made().respond([0.25, 0.5, 0.25], 2, False, rotor=columns)
    for i in range(13):
        alone = made().respond([0.25, 0.5, 0.25], 2, False, rotor=np.ascontiguousarray(columns[:, i : i + 1]))
        assert np.array_equal(together[:, :, i], alone[:, :, 0])
    fast = made().respond([1.0], 1, False, rotor=columns)
    by_hand = 0.25 * fast[:, 3:-3:2] + 0.5 * fast[:, 4:-2:2] + 0.25 * fast[:, 5:-1:2]
    assert np.allclose(together[:, 2 : 2 + by_hand.shape[1]], by_hand, atol=1e-12)


def test_a_column_of_a_sensor_is_brought_from_the_middle_of_a_sample_to_its_stamp() -> None:
    middle = np.arange(SAMPLES, dtype=float)[:, None]
    stamps = np.concatenate([middle[:1], 0.5 * (middle[1:] + middle[:-1])])
    found = made().respond([1.0], 1, False, joint_sensor=middle)
    assert np.allclose(found, made().respond([1.0], 1, True, joint_sensor=stamps), atol=1e-9)


def test_without_a_measurement_nothing_is_corrected() -> None:
    readings, gap = np.zeros((SAMPLES, 3)), np.ones(SAMPLES, dtype=bool)
    readings[20:30], gap[20:30] = 5.0, False
    after = made(valid=gap).respond([1.0], 1, True, **given(readings))[:, 30:]
    assert np.abs(after).max() < 1e-9


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ValueError):
        Joint(-1.0, STIFFNESS, DAMPING, PERIOD)
    with pytest.raises(ValueError):
        made().respond([0.5, 0.5], 1, False, rotor=np.zeros((SAMPLES, 1)))
    with pytest.raises(ValueError):
        made().respond([1.0], 1, False, rotor=np.zeros((SAMPLES, 1)), link=np.zeros((SAMPLES, 2)))
    with pytest.raises(ValueError):
        made().respond([1.0], 1, False, rotor=np.zeros((SAMPLES - 1, 1)))


def core(readings: np.ndarray, torque: np.ndarray, zero: float = 0.0) -> Core:
    n = len(readings)
    yes = np.ones(n, dtype=bool)
    inertia, rest = np.full(n, LINK_INERTIA), np.zeros(n)
    variance = np.tile(NOISE**2, (n, 1))
    data = Readings(PERIOD, readings, variance, torque, 0.0, inertia, rest, yes, yes, 30.0)
    return Core(data, Numbers(INERTIA, STIFFNESS, DAMPING / STIFFNESS, 0.0, 0.0, zero), 1.0, True)


def test_a_joint_that_the_core_knows_leaves_nothing() -> None:
    torque = 5.0 * np.sin(np.arange(SAMPLES) / 4.0)
    readings = simulated(np.column_stack([torque, np.zeros(SAMPLES)]))
    found = core(readings, torque).fast(np.zeros(SAMPLES))[0]
    assert np.abs(found).max() < 1e-6
    state = core(readings, torque).predicted(np.zeros(SAMPLES), {})
    assert np.allclose(state[:, 0], readings[:, 0], atol=1e-9)


def test_columns_of_balances_and_sensors_act_with_the_signs_of_the_effects() -> None:
    """A torque that resists is less torque, an angle of the transmission is a zero, a reading is a reading."""
    torque = 5.0 * np.sin(np.arange(SAMPLES) / 4.0)
    readings, still = simulated(np.column_stack([torque, np.zeros(SAMPLES)])), np.zeros(SAMPLES)
    column = np.cos(np.arange(SAMPLES) / 7.0)[:, None]
    plain = core(readings, torque)

    def left(force: np.ndarray, also: np.ndarray | float = 0.0) -> np.ndarray:
        moved = simulated(np.column_stack([torque, np.zeros(SAMPLES)]) + force) + also
        return np.stack([core(moved, torque).innovations(still)[n] for n in SENSORS])

    for balance, force in ((MOTOR, [-1.0, 0.0]), (LINK, [0.0, -1.0])):
        found = plain.responses({balance: column})
        wanted = left(column * np.array(force))
        assert np.allclose(np.stack([found[n][:, 0] for n in SENSORS]), wanted, atol=1e-6 * np.abs(wanted).max())
    found = plain.responses({TRANSMISSION: np.full((SAMPLES, 1), 1e-4)})
    with_zero = core(readings, torque, zero=1e-4).innovations(still)
    for name in SENSORS:  # the recording less a zero that is not there
        assert np.allclose(with_zero[name], plain.innovations(still)[name] - found[name][:, 0], atol=1e-6)
    assert set(plain.responses({"temperature": column})) == set()


def test_numbers_move_by_what_a_fit_says_and_stay_physical() -> None:
    numbers = Numbers(1.0, 1e4, 1e-3, 2.0, 3.0)
    change = {
        (MOTOR, "inertia_correction"): 0.1,
        (LINK, "inertia_correction"): -0.2,
        (TRANSMISSION, "torsional_compliance"): 1e-5,
        (MOTOR, "coulomb_torque"): 0.5,
        (MOTOR, "viscous"): -0.5,
        (TRANSMISSION, "transmission_zero"): 1e-5,
    }
    found = numbers.moved(change)
    assert found.rotor_inertia == pytest.approx(1.1) and found.link_scale == pytest.approx(0.8)
    assert 1.0 / found.stiffness == pytest.approx(1e-4 + 1e-5)
    assert (found.coulomb, found.viscous, found.zero) == pytest.approx((2.5, 2.5, 1e-5))
    wild = {(MOTOR, "inertia_correction"): -3.0, (TRANSMISSION, "torsional_compliance"): -1.0}
    assert numbers.moved(wild).rotor_inertia > 0.0 and numbers.moved(wild).stiffness > 0.0
    assert numbers.moved({(TRANSMISSION, "torsional_damping"): -1.0}).damping_time == 0.0
    assert numbers.near(replace(numbers, stiffness=1.001e4), 2e-3)
    assert not numbers.near(replace(numbers, link_scale=1.01), 2e-3)
