"""The monitors in two forms, compiled and plain, driven in the same way: readings in, faults and used readings out.

The compiled ones stand inside the ticks of fusion and torque law; the laws are made transparent here (gear ratio 1, no
corrections), and every limit is wide until a test narrows it.
"""

from __future__ import annotations

import numpy as np
from oracles import loop_monitors_law, stages_law

from hd_control import _chain
from hd_control.core.blocks import Block
from hd_control.laws import fusion, torque
from hd_control.safety.gate import faults_of
from hd_control.safety.limits import SafetyLimits, guard_layout, limits_layout

FORMS = ("plain", "compiled")
N, DT = 2, 1e-3
STIFFNESS = 2.0**13
"""N m/rad, without rounding."""
COUNTS = ("degrade_gap_samples", "recover_samples", "brake_samples", "rejected_samples", "disagree_samples",
          "frozen_samples", "rail_degrade_samples", "rail_samples")  # fmt: skip


def wide(**narrow) -> SafetyLimits:
    """Limits that nothing meets, but for those that are given."""
    guard = guard_layout(N).zeros()
    guard.array[:] = 1e9
    guard.motor_temperature_low = -1e9
    gate = limits_layout(N).pack({"age_limit": 10.0, "rate_excess_limit": 20.0, "reset_samples": 5.0,
                                  "standstill_velocity": 0.01, "torque_limit": 1e9, "torque_step": 1e9})  # fmt: skip
    for name, value in narrow.items():
        guard.view(name)[...] = value
    return SafetyLimits(gate, guard)


class Sensors:
    """Encoder, resolver and gauge behind the fusion law's monitors. Positions in rad at the output side.

    `periods`: encoder and resolver wrap at these (n,) rad of their own, 0: never; `gear`: rotor turns per joint turn.
    Ticks are multiples of four, in which the sensors are compared with each other too.
    """

    def __init__(self, form: str, periods=(0.0, 0.0), gear=1.0, **narrow) -> None:
        params = fusion.layout("FusionParams", N).zeros()
        params.derivative_cutoff, params.crossover = 100.0, 10.0
        params.gear_ratio, params.gauge_gain = gear, 1.0
        params.torsional_stiffness = STIFFNESS
        params.encoder_period, params.resolver_period = periods
        limits = wide(**narrow)
        if form == "plain":
            self._stage = stages_law.FusionStage(params, DT, limits)
            self.sample = self._stage.sample
        else:
            self._stage = _chain.FusionTick(N, DT, limits.guard.array, [0] * params.array.size)
            self._stage.offer(params.array)
            self._stage.start()
            self.sample = Block(fusion.layout("FusionSample", N), self._stage.sample)
        self.form, self.gear, self.tick = form, gear, -4

    def send(self, encoder, resolver, gauge, ticks=4):
        """One sample; its faults."""
        self.tick += ticks
        readings = np.multiply(encoder, self.gear), resolver, gauge
        for name, values in zip(("motor_shaft_position", "joint_position", "gauge_torque"), readings, strict=True):
            self.sample.view(name)[:] = values
        with np.errstate(all="ignore"):
            self._stage.act(self.tick)
        return list(self._stage.found) if self.form == "plain" else faults_of(self._stage.rows)

    @property
    def used(self):
        """The readings (3, n) that the law got."""
        s = self.sample
        return np.stack([s.motor_shaft_position / self.gear, s.joint_position, s.gauge_torque])

    @property
    def withheld(self):
        """Is the joint torque (n,) withheld?"""
        output = self._stage.output
        output = output if self.form == "plain" else Block(fusion.layout("FusionOutput", N), output)
        return np.isnan(output.joint_torque)

    @property
    def mean(self):
        """Mean residual (n,) N m of the last whole turn."""
        return self._stage.redundancy.mean.copy() if self.form == "plain" else self._stage.residual_mean.copy()

    @property
    def ripple(self):
        """Its 2 beta amplitude (n,) N m."""
        return self._stage.redundancy.ripple.copy() if self.form == "plain" else self._stage.residual_ripple.copy()

    @property
    def missed(self):
        """Motion (n,) rad that a position sensor missed."""
        return self._stage.missed_motion.copy()


class Loop:
    """The monitors around the torque law, with the arguments of `oracles.loop_monitors_law`."""

    def __init__(self, form: str) -> None:
        self._plain = form == "plain"

    def _tick(self, limits, dt=DT, params=None):
        params = torque.layout("TorqueParams", N).zeros() if params is None else params
        bounds = np.concatenate([np.full(N, -1e9), np.full(2 * N, 1e9)])
        gate, guard, kinds = limits.gate.array, limits.guard.array, [0] * params.array.size
        tick = _chain.TorqueTick(N, dt, 0, gate, guard, bounds, 1, 1, kinds, [], [])
        tick.offer(params.array)
        tick.start()
        return tick

    @staticmethod
    def _faults(tick, name):
        return [fault for fault in faults_of(tick.rows) if fault.code.name == name]

    def lost_ticks(self, gap, level, limits):
        """F01: the new level and faults."""
        if self._plain:
            return loop_monitors_law.lost_ticks(gap, level, limits)
        tick = self._tick(limits)
        tick.lost, tick.tick, tick.warm = level, 100, _chain.WARM_TICKS
        tick.act(101 + gap)
        return tick.lost, self._faults(tick, "FRAME_LOST")

    def gauge_rail(self, joint_torque, run, limits):
        """F08: the new run lengths and faults. `limits`: those of the guard."""
        if self._plain:
            return loop_monitors_law.gauge_rail(joint_torque, run, limits)
        tick = self._tick(SafetyLimits(wide().gate, limits))
        Block(torque.layout("TorqueSample", N), tick.sample).joint_torque = joint_torque
        tick.railed[:] = run
        tick.act(1)
        return tick.railed.copy(), self._faults(tick, "GAUGE_RAIL")

    def watch(self, memory, state, params, sample, reference, limits, dt):
        """F34: the new memory and faults of a look, `dt` s after the one before."""
        if self._plain:
            return loop_monitors_law.watch(memory, state, params, sample, reference, limits, dt)
        tick = self._tick(SafetyLimits(wide().gate, limits), dt / stages_law.WATCH_TICKS, params)
        for own, given in ((tick.state, state), (tick.sample, sample), (tick.reference, reference)):
            own[:] = given.array
        tick.adaptation[:], tick.has_state, tick.tick = memory.array, True, stages_law.WATCH_TICKS - 1
        tick.act(stages_law.WATCH_TICKS)
        return Block(memory.layout, tick.adaptation.copy()), self._faults(tick, "ADAPTATION")
