"""Commands and sensors of the world: limit, delay, lag, counts, bits, gauge bridge, temperature, noise, forks."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.gauge_bridge import bridge_gain, bridge_output, gauge_strains, torsional_strain
from oracles.plant_runs import flywheel

from hd_sim.plant import Plant
from hd_sim.plant_config import PlantConfig
from hd_sim.sensors import misalignment_ripple, noise_key

TURN = 2.0 * np.pi


def shaken(config: PlantConfig, ticks: int = 300) -> np.ndarray:
    """Torques that move every joint, (ticks, n)."""
    time = config.period * np.arange(ticks)[:, None]
    gravity = Plant(config).gravity_torque(config.start_position)
    return gravity + 0.3 * config.drives["rated_torque"] * np.sin(12.0 * time + np.arange(config.joints))


def columns_equal(one, other) -> bool:
    return all(np.array_equal(one.samples[name], other.samples[name]) for name in one.samples)


def test_torque_limit_acts_and_is_reported():
    limited, plain = Plant(flywheel(torque_limit=50.0)), Plant(flywheel(torque_limit=50.0))
    limited.step([1e6])
    plain.step([50.0])
    assert limited.sample().motor_torque_applied[0] == 50.0
    assert np.array_equal(limited.state.array, plain.state.array)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_no_number_counts_as_zero(value):
    plant, zero = Plant(flywheel()), Plant(flywheel())
    plant.step([value])
    zero.step([0.0])
    assert np.array_equal(plant.state.array, zero.state.array)


def test_current_loop_is_first_order():
    """After t at constant command the torque is u (1 - exp(-t/T))."""
    plant = Plant(flywheel(current_time_constant=2e-3))
    for k in range(1, 8):
        plant.step([10.0])
        assert plant.state.current_torque[0] == pytest.approx(10.0 * -np.expm1(-k * 0.5), rel=1e-12)


@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_declared_delay_shifts_the_motion_and_the_report(ticks):
    config = PlantConfig.from_file("arm_a")
    commands = shaken(config)
    prompt, late = Plant(config), Plant(replace(config, extra_delay_samples=ticks))
    hold = np.tile(late.state.commands[:, 0], (ticks, 1))
    shifted = np.vstack([hold, commands[:-ticks]])
    assert columns_equal(late.step_many(commands), prompt.step_many(shifted))


def test_hidden_delay_shifts_the_motion_but_not_the_report():
    config = PlantConfig.from_file("arm_a")
    commands = shaken(config)
    late, prompt = Plant(config.with_settings(command_delay=2e-3)), Plant(config)
    hold = np.tile(late.state.commands[:, 0], (2, 1))
    hidden, shifted = late.step_many(commands), prompt.step_many(np.vstack([hold, commands[:-2]]))
    assert np.array_equal(hidden.samples["motor_shaft_position"], shifted.samples["motor_shaft_position"])
    assert np.array_equal(hidden.samples["motor_torque_applied"], commands)


def test_hidden_delay_may_end_inside_a_tick():
    """0.4 ms at 5 substeps: the new command acts for three of five substeps, so the rotor gains 3/5 of the impulse."""
    moved = []
    for delay in (0.0, 4e-4):
        plant = Plant(flywheel(command_delay=delay, stiffness_linear=1e-6, torsional_damping=0.0))
        plant.step([10.0])
        moved.append(plant.state.motor_velocity[0])
    assert moved[1] / moved[0] == pytest.approx(0.6, rel=1e-9)


def test_report_is_the_torque_of_the_coming_tick_once_latched():
    plant = Plant(flywheel())
    plant.step([3.0])
    assert plant.sample().motor_torque_applied[0] == 3.0  # held until a new one comes
    plant.latch([4.0])
    assert plant.sample().motor_torque_applied[0] == 4.0


def test_encoder_and_resolver_round_to_counts():
    config = PlantConfig.from_file("arm_a")
    plant = Plant(config)
    record = plant.step_many(shaken(config), truth=True)
    rotor = config.drives["gear_ratio"] * record.truth["motor_position"]
    for seen, exact, count in (
        (record.samples["motor_shaft_position"], rotor, TURN / 4000),
        (record.samples["joint_position"], record.truth["joint_position"], TURN / 2**16),
    ):
        assert np.abs(seen - exact).max() <= 0.5 * count * (1 + 1e-9)
        assert np.abs(seen / count - np.round(seen / count)).max() < 1e-6
        assert len(np.unique(seen[:, 0])) > 3


def test_quantisation_does_not_touch_the_motion():
    config = PlantConfig.from_file("arm_a")
    coarse = config.with_settings(encoder_counts=100.0, resolver_bits=8.0)
    commands = shaken(config)
    runs = [Plant(each).step_many(commands, truth=True).truth["joint_position"] for each in (config, coarse)]
    assert np.array_equal(*runs)


@pytest.mark.parametrize(("degrees", "percent"), [(0.5, 0.218), (1.0, 0.436), (2.0, 0.8725), (5.0, 2.18)])
def test_misalignment_ripple_of_the_exact_bridge_and_of_the_world(degrees, percent):
    """Psi_0 = 100, eps_R = 200 microstrain: the four-arm bridge, Hashimoto (13) and the kernel show the same ripple."""
    turn, angle, rated = np.linspace(0.0, TURN, 721), np.deg2rad(degrees), 2e-4
    exact = [bridge_output(2.1, 1.0, gauge_strains(b, rated, 1e-4, angle)) / (2.1 * rated) - 1.0 for b in turn]
    assert 100 * (np.max(exact) - np.min(exact)) / 2 == pytest.approx(percent, rel=3e-3)
    ripple = misalignment_ripple(angle, 1e-4, rated)
    assert 100 * ripple.amplitude == pytest.approx(percent, rel=3e-3)
    assert np.abs(exact - ripple.amplitude * np.sin(2 * turn + ripple.phase)).max() < 1e-5
    plant = Plant(flywheel(gauge_misalignment_deg=degrees, gauge_modulation_strain=1e-4, gauge_rated_strain=rated))
    shown = []
    for theta in turn:
        state = plant.state
        state.motor_position = state.joint_position = state.torsion = theta / plant.config.drives["gear_ratio"]
        state.torsion = 0.0
        plant.restore(state)
        shown.append(plant.sample().gauge_torque[0] / plant.config.drives["rated_torque"][0])
    assert np.abs(np.array(shown) - exact).max() < 1e-5


def test_bridge_constants_of_the_paper():
    """K_R = 50.74 microvolt per N m, 25.4 mV after the amplifier, 322 microstrain at 40 N m."""
    strain = torsional_strain(1.0, 0.39e-3, 15.8e-3, 24.85e-3, 8.3e10)
    assert strain == pytest.approx(8.05e-6, rel=1e-3)
    assert 1e6 * bridge_gain(2.1, 3.0, strain) == pytest.approx(50.74, abs=0.01)
    assert 500e3 * bridge_gain(2.1, 3.0, strain) == pytest.approx(25.4, abs=0.05)


def test_gauge_gain_offset_drift_and_temperature():
    plant = Plant(flywheel(
        gauge_gain_error=0.1, gauge_offset=0.5, gauge_offset_drift=2.0, gauge_gain_temperature=0.01,
        gauge_offset_temperature=0.03, reference_temperature=20.0, ambient_temperature=30.0, thermal_time_constant=0.0,
    ))  # fmt: skip
    plant.external_torque(joint=[-20.0], motor=[20.0])
    plant.step_many(np.zeros((2000, 1)))
    shown, torque = plant.sample().gauge_torque[0], plant.true_state().joint_torque[0]
    assert torque == pytest.approx(20.0, rel=1e-3)
    assert shown == pytest.approx(1.1 * 1.1 * torque + 0.5 + 0.3 + 2.0 * 2.0, rel=1e-12)


def test_gauge_amplifier_is_a_low_pass():
    """A torque that steps is seen after one time constant at 63 %; without a time constant at once."""
    plant = Plant(flywheel(gauge_time_constant=0.02, torsional_damping=400.0))
    plant.external_torque(joint=[-20.0], motor=[20.0])
    for _ in range(20):
        plant.step([0.0])
    assert plant.sample().gauge_torque[0] / plant.true_state().joint_torque[0] == pytest.approx(
        -np.expm1(-1.0), abs=0.1
    )


def test_gauge_angle_can_turn_with_the_joint():
    """beta = theta_m - q: over one joint turn the ripple has 2 (N - 1) periods instead of 2 N."""
    plant = Plant(flywheel(gauge_joint_turn=-1.0, extra_ripple_sine=1.0))
    state = plant.state
    state.motor_position = state.joint_position = 0.3
    plant.restore(state)
    ratio = plant.config.drives["gear_ratio"][0]
    assert plant.sample().gauge_torque[0] == pytest.approx(np.sin(2.0 * (ratio - 1.0) * 0.3), abs=1e-9)


def test_temperature_rises_to_its_closed_form():
    """Copper only: T = T_0 + c u^2 (1 - exp(-t/T_th)), by steps of one tick; the brake keeps the rotor still."""
    plant = Plant(flywheel(copper_heating=0.02, friction_heating=0.0, thermal_time_constant=10.0, coulomb_torque=90.0))
    for _ in range(5000):
        plant.step([30.0])
    assert plant.sample().motor_temperature[0] == pytest.approx(22.0 - 18.0 * np.expm1(-0.5), abs=2e-3)


def test_friction_follows_temperature():
    """Viscous friction at 10 K above reference with -2 % per kelvin: steady speed rises by 1/0.8."""
    warm = dict(ambient_temperature=35.0, reference_temperature=25.0, viscous_temperature_slope=-0.02)
    plant = Plant(flywheel(viscous_positive=20.0, copper_heating=0.0, friction_heating=0.0, **warm))
    plant.step_many(np.full((10_000, 1), 10.0), samples=False)
    assert plant.state.motor_velocity[0] == pytest.approx(10.0 / 16.0, rel=1e-9)


def test_noise_has_its_size_and_streams_do_not_move_each_other():
    config = PlantConfig.from_file("arm_a")
    still = np.tile(Plant(config).gravity_torque(config.start_position), (4000, 1))
    plain = Plant(config, seed=5).step_many(still, truth=True)
    noise = plain.samples["gauge_torque"] - plain.truth["joint_torque"]
    assert noise.std(0) == pytest.approx(config.drives["gauge_noise"], rel=0.05)
    assert np.abs(np.corrcoef(noise.T) - np.eye(7)).max() < 0.06
    assert np.abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.06
    assert np.mean(np.abs(noise / noise.std(0)) > 2.0) == pytest.approx(0.0455, abs=0.006)  # tails of a normal law
    noisy = config.with_settings(resolver_noise=1e-4, sampling_jitter=1e-5)
    other = Plant(noisy, seed=5).step_many(still, truth=True)
    assert np.array_equal(plain.samples["gauge_torque"], other.samples["gauge_torque"])
    assert not np.array_equal(plain.samples["joint_position"], other.samples["joint_position"])
    assert noise_key(5, "resolver") != noise_key(6, "resolver") != noise_key(6, "gauge_bridge")


def test_same_inputs_give_the_same_bits_and_seeds_differ():
    config = PlantConfig.from_file("arm_b")
    commands = shaken(config)
    first, again, other = (Plant(config, seed).step_many(commands) for seed in (1, 1, 2))
    assert columns_equal(first, again)
    assert not columns_equal(first, other)


def test_a_forked_run_continues_bit_for_bit():
    """The state is complete: also with laws that have memory, delay, brake and every stream of noise."""
    config = PlantConfig.from_file("arm_a").with_settings(
        friction_law="bristle", command_delay=1.4e-3, sampling_jitter=1e-5, gauge_time_constant=1e-3, link_coulomb=2.0,
        link_presliding_distance=1e-4, resonance_inertia=0.01, resonance_frequency=18.0, slip_stiffness=1e4,
        slip_yield=1.0,
    )  # fmt: skip
    commands = shaken(config, 400)
    plant = Plant(config, seed=3)
    plant.step_many(commands[:200])
    plant.brake(True)
    plant.step_many(commands[200:220])
    twin = Plant(config, seed=3)
    twin.restore(plant.state)
    assert columns_equal(plant.step_many(commands[220:]), twin.step_many(commands[220:]))
    assert np.array_equal(plant.state.array, twin.state.array)


def test_step_sample_and_step_many_agree():
    config = PlantConfig.from_file("arm_a")
    commands = shaken(config, 50)
    together, singly = Plant(config), Plant(config)
    record = together.step_many(commands)
    for k, command in enumerate(commands):
        singly.latch(command)
        sample = singly.sample()
        for name in record.samples:
            assert np.array_equal(record.samples[name][k], sample.view(name))
        singly.advance()
