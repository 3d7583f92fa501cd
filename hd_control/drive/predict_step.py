"""One step of a free run for all windows at once. Source: docs/equations/prediction.md (W1), (W2)."""

from __future__ import annotations

import numpy as np

from hd_control.core.arrays import FloatArray, IntArray
from hd_control.drive.effect import LINK, MOTOR, TRANSMISSION, DriveStates
from hd_control.drive.predict_plant import Plant, Term

NEWTON_ROUNDS = 2
SOFTEST = 0.02
"""Least tangent stiffness over the linear one that a transmission may have, e.g. inside a backlash gap."""


class Stepper:
    """Runs (windows,) of one plant. `phi`, `v`, `q`, `w`: motor and joint position and velocity; `tau` joint torque."""

    def __init__(self, plant: Plant, starts: IntArray) -> None:
        self.plant, self.starts = plant, starts
        s = plant.states
        self.phi, self.v, self.w = (x[starts].copy() for x in (s.motor_position, s.motor_velocity, s.joint_velocity))
        self.q = s.joint_position[starts].copy()
        self.tau = s.joint_torque[starts].copy()
        self.wave: FloatArray | None = None
        self.rate, self.acceleration, self.link_acceleration = (np.zeros(starts.size) for _ in range(3))
        self.steady = [n for n, t in enumerate(plant.terms) if t.on_transmission and not t.on_torque]
        self.follow = [n for n, t in enumerate(plant.terms) if t.on_transmission and t.on_torque]
        self.memory = [t.effect.memory_along(s, t.shape, starts) for t in plant.terms]
        # torque / k is the torsion a damping time ahead
        self._start_on_torsion(
            *(np.interp(s.time[starts] - plant.damping_time, s.time, x) for x in (s.joint_torque, s.joint_torque_rate))
        )

    def _start_on_torsion(self, tau: FloatArray, rate: FloatArray) -> None:
        """The start lies on the model's own torsion, and so does its rate where the torque rate is known: the joint
        sensor is too coarse to give the torque, and its velocity too slow at reversals."""
        k, dt = self.plant.stiffness, self.plant.states.period
        wave = self._waves(self._state(0, self.phi, self.q, self.tau))
        later = self._state(0, self.phi + dt * self.v, self.q + dt * self.w, self.tau + dt * rate)
        w = self.v - rate / k + (self._waves(later) - wave) / dt
        self.q = self.phi - tau / k + self.plant.zero + wave
        self.w = np.where(np.isfinite(w), w, self.w)

    def step(self, i: int) -> FloatArray:
        """One step from sample i; returns the mean joint torque over it."""
        plant, rows, T = self.plant, self.starts + i, self.plant.states.period
        phi, q = self.phi + 0.5 * T * self.v, self.q + 0.5 * T * self.w
        damping = plant.stiffness * plant.damping_time
        tau, tangent, waves = self._torsion(i, phi, q, damping * (self.v - self.w))
        state = self._state(i, phi, q, tau)
        resist, threshold, load = self._columns(state, waves)
        c = 0.25 * T * tangent + 0.5 * damping
        link = plant.link
        rest = 0.5 * (link.rest[rows] + link.rest[rows + 1]) + load
        rest += link.slope[rows] * (
            q - 0.5 * (plant.states.joint_position[rows] + plant.states.joint_position[rows + 1])
        )
        ease = T / (link.inertia[rows] + T * c)
        free = tau - c * ease * (tau - rest)
        push = state.motor_torque - resist - plant.viscous * self.v - free
        heavy = plant.inertia + T * (c * (1.0 - c * ease) + 0.5 * plant.viscous)
        drive = heavy * self.v + T * push
        v = np.sign(drive) * np.maximum(np.abs(drive) - T * (plant.coulomb + threshold), 0.0) / heavy
        change = v - self.v
        link_change = ease * (tau - rest + c * change)
        self.phi = self.phi + 0.5 * T * (self.v + v)
        self.q = self.q + T * (self.w + 0.5 * link_change)
        mean: FloatArray = tau + c * (change - link_change)
        self.rate, self.tau = (mean - self.tau) / T, mean
        self.v, self.w = v, self.w + link_change
        self.acceleration, self.link_acceleration = change / T, link_change / T
        return mean

    def _torsion(
        self, i: int, phi: FloatArray, q: FloatArray, damping: FloatArray
    ) -> tuple[FloatArray, FloatArray, dict[int, dict[str, FloatArray]]]:
        """Joint torque at the midpoint, tangent stiffness, and the terms that were evaluated on the way."""
        plant = self.plant
        k, known = plant.stiffness, {}
        torsion = phi - q + plant.zero
        if self.steady:
            wave = np.zeros(phi.shape)
            state = self._state(i, phi, q, self.tau)
            for n in self.steady:
                known[n], self.memory[n] = plant.terms[n].value(state, self.memory[n])
                wave = wave + known[n].get(TRANSMISSION, 0.0)
            torsion = torsion + wave
            if self.wave is not None:  # the damper also feels the waves that the motor runs over
                damping = damping + k * plant.damping_time * (wave - self.wave) / plant.states.period
            self.wave = wave
        tau, tangent = k * torsion, np.full(phi.shape, k)
        if self.follow:
            state = self._state(i, phi, q, self.tau - damping)
            tau, tangent = self._implicit(state, torsion)
            state.joint_torque[:] = tau + damping
            for n in self.follow:
                known[n], self.memory[n] = plant.terms[n].value(state, self.memory[n])
        return tau + damping, tangent, known

    def _implicit(self, state: DriveStates, torsion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Torque of the spring and tangent stiffness where the transmission itself follows the torque, by Newton."""
        k, nudge = self.plant.stiffness, 1e-3 * self.plant.states.torque_scale
        tau, tangent = state.joint_torque.copy(), np.full(torsion.shape, k)
        for _ in range(NEWTON_ROUNDS):
            here, near = (self._following(state, tau + step) for step in (0.0, nudge))
            tangent = k / np.maximum(1.0 - k * (near - here) / nudge, 1e-3)
            tangent = np.maximum(tangent, SOFTEST * k)
            tau = tau + tangent * (torsion + here - tau / k)
        return tau, tangent

    def _following(self, state: DriveStates, tau: FloatArray) -> FloatArray:
        """What the terms that depend on torque add to the joint position at this torque."""
        state.joint_torque[:] = tau
        found = np.zeros(tau.shape)
        for n in self.follow:
            found += self.plant.terms[n].value(state, self.memory[n])[0].get(TRANSMISSION, 0.0)
        return found

    def _columns(
        self, state: DriveStates, known: dict[int, dict[str, FloatArray]]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Resisting motor torque without direction, half its jump between the directions, resisting link torque."""
        resist, jump, load = (np.zeros(self.phi.shape) for _ in range(3))
        for n, term in enumerate(self.plant.terms):
            if n in known:
                values = known[n]
            elif term.on_direction:
                values, resist, jump = self._both(n, term, state, resist, jump)
            else:
                values, self.memory[n] = term.value(state, self.memory[n])
            if n in known or not term.on_direction:
                resist = resist + values.get(MOTOR, 0.0)
            load = load + values.get(LINK, 0.0)
        return resist, jump, load

    def _both(
        self, n: int, term: Term, state: DriveStates, resist: FloatArray, jump: FloatArray
    ) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
        """A term whose motor column changes with the direction: both directions, one memory."""
        state.motor_direction[:] = -1.0
        back, _ = term.value(state, self.memory[n])
        state.motor_direction[:] = 1.0
        ahead, self.memory[n] = term.value(state, self.memory[n])
        state.motor_direction[:] = 0.0
        return ahead, resist + 0.5 * (ahead[MOTOR] + back[MOTOR]), jump + 0.5 * (ahead[MOTOR] - back[MOTOR])

    def _waves(self, state: DriveStates) -> FloatArray:
        """What all terms add to the joint position; memory stays."""
        found = np.zeros(self.phi.shape)
        for term, memory in zip(self.plant.terms, self.memory, strict=True):
            found = found + term.value(state, memory)[0].get(TRANSMISSION, 0.0)
        return found

    def _state(self, i: int, phi: FloatArray, q: FloatArray, tau: FloatArray) -> DriveStates:
        """The states of all runs at step i."""
        s, rows = self.plant.states, self.starts + i
        link = self.plant.link
        return DriveStates(
            period=s.period,
            gear_ratio=s.gear_ratio,
            torque_scale=s.torque_scale,
            time=s.time[rows],
            motor_position=phi,
            motor_velocity=self.v,
            motor_acceleration=self.acceleration,
            motor_direction=np.zeros(phi.shape),
            joint_position=q,
            joint_velocity=self.w,
            joint_acceleration=self.link_acceleration,
            gauge_torque=tau,
            joint_torque=tau,
            joint_torque_rate=self.rate,
            motor_torque=s.motor_torque[rows],
            temperature=s.temperature[rows],
            link_inertia_torque=link.inertia[rows] * self.link_acceleration,
            link_bias_torque=s.link_bias_torque[rows],
            link_regressor=None if s.link_regressor is None else s.link_regressor[rows],
            tool_regressor=None if s.tool_regressor is None else s.tool_regressor[rows],
            torsional_compliance=1.0 / self.plant.stiffness,
        )
