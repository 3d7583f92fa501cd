"""The innovations of a recording as linear equations, row by row: what came instead of the prediction, and what would.

    e = sum theta_j x_j + w        x_j: response of the filter to column j, w: white up to a short autoregression

The base holds errors of the core's own numbers, delays and the first travel after a reversal, by linearisation; the
core is moved by what the base says until nothing is left of it. Columns of effects are formed from states that the
filter predicts, from the past alone: a regressor that knows the innovation's future would explain noise.
Source: docs/equations/innovations.md (K9) to (K12).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hd_control.core.arrays import BoolArray, FloatArray
from hd_control.drive.effect import (
    COULOMB,
    DAMPING_TIME,
    GAUGE,
    JOINT_SENSOR,
    LINK,
    MOTOR,
    ROTOR_INERTIA,
    STIFFNESS,
    TRANSMISSION,
    VISCOUS,
    ZERO,
    Columns,
    DriveStates,
    Effect,
    Shape,
)
from hd_control.drive.link import OwnLink
from hd_control.drive.shapes import approach
from hd_control.lab.balances.channels import Base, Channel, JointEquations
from hd_control.lab.balances.states import count_tone, few_counts, noise_density
from hd_control.lab.innovations.core import MOTOR_SENSOR, SENSORS, Core, Numbers, Readings
from hd_control.lab.innovations.noise import fast_power, sensor_variance
from hd_control.lab.signals.filters import Band
from hd_control.lab.signals.joint_signals import JointSignals, quantum

ROUNDS = 2
SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
SHARE_MARGIN = 0.02
"""nats per sample: of shares that are equally good the largest is taken."""
COMMAND_DELAY = 0.03
"""Standard deviation of an undeclared delay of the motor torque, over the period of the recording."""
SENSOR_DELAY = 1e-3
"""s, standard deviation of delays between the sensors; never a claim."""
TRAVELS = (1e-3, 4e-3)
"""rad over which friction may build up after a reversal; never a claim."""
MARGIN_S = 0.02
"""s around presliding that are left out: there the force on the rotor is not known."""
CLEAN_SHARE = 0.1
"""Share of noise in the fast motor torque up to which the recorded torque may stand in a column."""
STAMPED = 0.2
"""Delay over the period by which a held torque would act before its stamp, from which on it is a sampled one."""
RIGID_HZ = 100.0
"""Resonance of a joint whose stiffness nobody knows."""


@dataclass(frozen=True)
class Innovations(JointEquations):
    """`JointEquations` whose channels are the sensors: left sides are white innovations, columns are responses.

    `held`: the motor torque is held from its stamp to the next; else it is a sample of a smooth one.
    """

    core: Core | None = None
    held: bool = True
    fitting: _Fitting | None = None

    @property
    def filter_core(self) -> Core:
        """The filter."""
        assert self.core is not None
        return self.core

    @property
    def damping_time(self) -> float:
        """d of the core, s."""
        return self.filter_core.numbers.damping_time

    def offset(self, channel: str, name: str) -> float:
        """The core's own value of a base coefficient, which is fitted as its change."""
        n = self.filter_core.numbers
        own = {
            (MOTOR, COULOMB): n.coulomb,
            (MOTOR, VISCOUS): n.viscous,
            (TRANSMISSION, "torsional_compliance"): 1.0 / n.stiffness,
            (TRANSMISSION, ZERO): n.zero,
        }
        return own.get((channel, name), 0.0)

    def rows_of(self, columns: Columns, reads: str = "") -> dict[str, FloatArray]:
        """Responses (rows, k) by sensor; what a sensor only reads wrong is a column of that sensor."""
        return self.filter_core.responses(acting(columns, reads))

    def beside(self, change: Mapping[tuple[str, str], float], effects: Sequence[tuple[Columns, str]]) -> Innovations:
        """The same recording at the core's numbers moved by `change`, its states predicted beside `effects`: what each
        adds, (n, 1), and which signal it only reads wrong."""
        assert self.fitting is not None
        core = self.filter_core
        return self.fitting.at(core.with_numbers(core.numbers.moved(change)), effects)


def acting(columns: Columns, reads: str) -> Columns:
    """The columns of an effect where it acts: on balances, or on the one sensor that reads wrong."""
    if reads == GAUGE:
        return {GAUGE: columns[LINK]}
    if reads == JOINT_SENSOR:
        return {JOINT_SENSOR: columns[TRANSMISSION]}
    return columns


@dataclass(frozen=True)
class Given:
    """What the innovations need beside the balances: signals, own link (None: not known), the model's values by base
    number, the delay s of the motor torque that it knows, and its other effects with their coefficients."""

    signals: JointSignals
    link: OwnLink | None
    base: Mapping[str, float]
    command_delay: float = 0.0
    known: tuple[tuple[type[Effect], Shape, FloatArray], ...] = ()

    def effects(self, states: DriveStates) -> list[tuple[Columns, str]]:
        """What the known effects add, (n, 1), and what each only reads wrong."""
        found = []
        for effect, shape, coefficients in self.known:
            columns = {name: column @ coefficients for name, column in effect.columns(states, shape).items()}
            finite = {name: np.nan_to_num(column)[:, None] for name, column in columns.items()}
            found.append((finite, effect.reads))
        return found


def readings_of(given: Given, equations: JointEquations) -> tuple[Readings, float]:
    """What the filter is given, and the angle, rad, that its sensors count from."""
    signals, own = given.signals, given.link
    filled, derived, period = equations.derived.filled, equations.derived, signals.period
    recorded = (signals.motor_shaft_position, signals.joint_position, signals.gauge_torque)
    values = (filled["motor_position"], filled["joint_position"], filled.get("gauge_torque"))
    speeds = (derived.motor_velocity, derived.joint_velocity)
    sensors, variance = np.zeros((signals.time.size, 3)), np.full((signals.time.size, 3), np.inf)
    origin = float(values[0][0] if recorded[0] is not None else values[1][0])
    use = derived.usable & derived.sliding
    for i, (raw, value) in enumerate(zip(recorded, values, strict=True)):
        if raw is None or value is None:
            continue
        sensors[:, i] = value - (origin if i < 2 else 0.0)
        density, count = max(noise_density(value, period), 1e-12), quantum(value)
        if i < 2:
            variance[:, i] = sensor_variance(value, speeds[i], use, density, count)
        else:
            variance[:, i] = max(density**2, count**2 / 12.0)
    torque = filled.get("motor_torque")
    if torque is not None:
        torque = late(torque, given.command_delay / period)
    readings = Readings(
        period=period,
        sensors=sensors,
        variance=variance,
        torque=torque,
        torque_noise=0.0 if torque is None else noise_density(torque, period),
        inertia=None if own is None else own.inertia,
        rest=None if own is None else own.rest,
        usable=derived.usable,
        sliding=derived.sliding,
        scale=equations.states.torque_scale,
    )
    return readings, origin


def late(torque: FloatArray, samples: float) -> FloatArray:
    """Mean over each sample of a held torque (n,) that acts `samples` later."""
    whole = int(np.floor(samples + 1e-9))
    part = max(samples - whole, 0.0)
    padded = np.concatenate([np.full(whole + 1, torque[0]), torque])
    return np.asarray((1.0 - part) * padded[1 : torque.size + 1] + part * padded[: torque.size])


def first_numbers(base: Mapping[str, float], readings: Readings, states: DriveStates) -> Numbers:
    """The model's values, or what stands for them where the model has none."""
    link = readings.scale / 30.0 if readings.inertia is None else float(np.mean(readings.inertia))
    rotor = base.get(ROTOR_INERTIA, 0.0) or 0.5 * link
    stiffness = base.get(STIFFNESS, 0.0) or (1.0 / states.torsional_compliance if states.torsional_compliance else 0.0)
    if stiffness <= 0.0:
        resonance = 2.0 * np.pi * min(RIGID_HZ, 0.2 / readings.period)
        stiffness = resonance**2 * rotor * link / (rotor + link)
    damping = base.get(DAMPING_TIME, 0.0) or 1e-4
    return Numbers(rotor, stiffness, damping, base.get(COULOMB, 0.0), base.get(VISCOUS, 0.0))


def innovations(given: Given, equations: JointEquations, unknown: frozenset[str] = frozenset()) -> Innovations:
    """The innovations of one joint, its core fitted to the recording.

    `unknown`: balances (rotor, link) of which the motion shows too little; their forces are taken as unknown.
    """
    readings, origin = readings_of(given, equations)
    if MOTOR in unknown:
        readings = replace(readings, torque=None)
    if LINK in unknown:
        readings = replace(readings, inertia=None, rest=None)
    numbers = first_numbers(given.base, readings, equations.states)
    states = equations.states
    if len(readings.present) == len(SENSORS):
        lag = readings.sensors[:, 1] - readings.sensors[:, 0] + states.joint_torque / numbers.stiffness
        numbers = replace(numbers, zero=float(np.median(lag[readings.usable])))
    fitting = _Fitting(readings, equations, origin, given.effects(states))
    found, delay = fitting.fitted(numbers, True)
    if delay < -STAMPED * readings.period:
        found, _ = fitting.fitted(numbers, False)
    return found


@dataclass(frozen=True)
class _Fitting:
    """Brings a core to the numbers that the recording asks for."""

    readings: Readings
    equations: JointEquations
    origin: float
    known: list[tuple[Columns, str]]

    def fitted(self, numbers: Numbers, held: bool) -> tuple[Innovations, float]:
        """The innovations at the fitted numbers, and the delay of the motor torque that the last fit found, s."""
        share, delay = 1.0, 0.0
        for round_ in range(ROUNDS):
            found = self.at(Core(self.readings, numbers, share, held))
            numbers = numbers.moved(change_of(found))
            delay = change_of(found, any_delay=True).get((MOTOR, "command_delay"), 0.0)
            if round_ == 0 and self.readings.torque is not None:
                share = self._share(numbers, held, max(0.0, delay))
        return self.at(Core(self.readings, numbers, share, held)), delay

    def _share(self, numbers: Numbers, held: bool, delay: float) -> float:
        """Share of the torque's fast part that the rotor does not feel: the largest of those that explain best.

        `delay` s with which the torque acts: a late torque is no noise.
        """
        use, torque = self.readings.usable & self.readings.sliding, self.readings.torque
        assert torque is not None
        readings = replace(self.readings, torque=late(torque, delay / self.readings.period))
        losses = {}
        for share in SHARES:
            white, scale = Core(readings, numbers, share, held).fast(self._friction(numbers, self.equations.states))
            power = sum(fast_power(row, readings.period, use) for row in white)
            losses[share] = power - 2.0 * float(np.log(scale[use]).mean(axis=0).sum())
        return max(share for share, loss in losses.items() if loss < min(losses.values()) + SHARE_MARGIN)

    def _friction(self, numbers: Numbers, states: DriveStates) -> FloatArray:
        return numbers.coulomb * states.motor_direction + numbers.viscous * states.motor_velocity

    def at(self, core: Core, effects: Sequence[tuple[Columns, str]] = ()) -> Innovations:
        """The innovations at the core's numbers; the states are predicted beside these effects, or the model's own."""
        added: Columns = {}
        for columns, reads in effects or self.known:
            for name, column in acting(columns, reads).items():
                added[name] = added.get(name, 0.0) + column
        first = core.predicted(self._friction(core.numbers, self.equations.states), added)
        states = self._states(core, first)
        return Innovations(
            joint=self.equations.joint,
            states=states,
            derived=self.equations.derived,
            spectral=self.equations.spectral,
            channels=self._channels(core, states),
            inertia=core.numbers.rotor_inertia,
            link_scale=core.numbers.link_scale,
            core=core,
            held=core.held,
            fitting=self,
        )

    def _channels(self, core: Core, states: DriveStates) -> dict[str, Channel]:
        """Innovations of every sensor with the columns of the base."""
        columns = base_columns(core, states)
        rows = core.responses_of([c for _, _, c in columns])
        valid, found = self._valid(core), {}
        top = 0.5 / (core.stride * core.readings.period)
        for name, left in core.innovations(self._friction(core.numbers, states)).items():
            found[name] = Channel(
                name=name,
                band=Band(0.8 * top, top, core.stride),
                spectral=self.equations.spectral,
                time=states.time[:: core.stride],
                valid=valid,
                left=left,
                base=tuple(Base(k[1], rows[name][:, i], p, owner=k[0]) for i, (k, p, _) in enumerate(columns)),
                scale=None,
                snr=np.inf,
                noisy=self._noisy(name, core, valid),
            )
        return found

    def _valid(self, core: Core) -> BoolArray:
        """Rows (rows,) that see neither a gap nor presliding."""
        bad = (
            ~(self.readings.usable & self.readings.sliding)
            if self.readings.torque is not None
            else ~self.readings.usable
        )
        margin = len(core.taps) // 2 + round(MARGIN_S / core.readings.period)
        count, index = np.concatenate([[0], np.cumsum(bad)]), np.arange(0, bad.size, core.stride)
        low, high = np.maximum(index - margin, 0), np.minimum(index + margin + 1, bad.size)
        return np.asarray(count[high] == count[low])

    def _noisy(self, name: str, core: Core, valid: BoolArray) -> BoolArray | None:
        """Rows at which the counts of an angle are no white noise; None if that were most of them."""
        if name not in SENSORS[:2]:
            return None
        i, derived, period = SENSORS.index(name), self.equations.derived, core.readings.period
        reading = core.readings.sensors[:, i]
        velocity = derived.motor_velocity if name == MOTOR_SENSOR else derived.joint_velocity
        count = quantum(reading)
        rows = (few_counts(reading, count, period) | count_tone(velocity, count, period, TONE_HZ))[:: core.stride]
        return rows if valid.any() and rows[valid].mean() < MOST_NOISY else None

    def _states(self, core: Core, predicted: FloatArray) -> DriveStates:
        """The states in the middle of each sample, from the prediction at its beginning."""
        n, r, old = core.numbers, core.readings, self.equations.states
        half = 0.5 * r.period
        phi, omega, q, w = predicted.T
        spring, rate = n.stiffness * (phi + n.zero - q), n.stiffness * (omega - w)
        torque = spring + n.damping * (omega - w)
        rotor, link = _change(omega, r.period), _change(w, r.period)
        return replace(
            old,
            motor_position=phi + half * omega + self.origin,
            motor_velocity=omega + half * rotor,
            motor_acceleration=rotor,
            joint_position=q + half * w + self.origin,
            joint_velocity=w + half * link,
            joint_acceleration=link,
            joint_torque=torque + half * rate,
            joint_torque_rate=rate,
            gauge_torque=torque + half * rate,
            spring_torque=spring + half * rate,
            motor_torque=self._torque(core, n.rotor_inertia * rotor + torque + self._friction(n, old)),
            torsional_compliance=1.0 / n.stiffness,
            damping_time=n.damping_time,
            link_inertia_torque=old.link_inertia_torque if r.inertia is None else n.link_scale * r.inertia * link,
        )

    def _torque(self, core: Core, balance: FloatArray) -> FloatArray:
        """The motor torque as columns may hold it: as recorded if it is clean, else what the motion asks for."""
        torque = core.readings.torque
        if torque is None:
            return np.full(balance.size, np.nan)
        if core.share > CLEAN_SHARE:
            return balance
        return torque if core.held else 0.5 * (torque + np.append(torque[1:], torque[-1]))


TONE_HZ, MOST_NOISY = 30.0, 0.6


def _change(values: FloatArray, period: float) -> FloatArray:
    """Rate over the sample before."""
    return np.diff(values, prepend=values[0]) / period


BaseColumn = tuple[tuple[str, str], float, Columns]
"""(balance, name), standard deviation of the prior, columns (n, 1)."""


def base_columns(core: Core, s: DriveStates) -> list[BaseColumn]:
    """What every core may be wrong in: its numbers, delays, friction after reversals."""
    r, found = core.readings, list[BaseColumn]()

    def put(balance: str, name: str, column: FloatArray, prior: float = np.inf, sensor: str = "") -> None:
        found.append(((balance, name), prior, {sensor or balance: column[:, None]}))

    if r.torque is not None:
        put(MOTOR, COULOMB, s.motor_direction)
        put(MOTOR, VISCOUS, s.motor_velocity)
        put(MOTOR, "inertia_correction", core.numbers.rotor_inertia * s.motor_acceleration)
        put(MOTOR, "command_delay", _change(s.motor_torque, r.period), COMMAND_DELAY * r.period)
        for travel in TRAVELS:
            built_up = approach(s.motor_position, 1.0 / travel, 0.1 * travel)
            put(MOTOR, f"travel_{travel:g}", built_up - s.motor_direction)
    if len(r.present) >= 2:
        put(TRANSMISSION, "torsional_compliance", -s.joint_torque)
        put(TRANSMISSION, "torsional_damping", s.joint_torque_rate)
    if len(r.present) == len(SENSORS):
        put(TRANSMISSION, ZERO, np.ones(s.time.size))
    if r.inertia is not None and (r.torque is not None or GAUGE in r.present):
        put(LINK, "inertia_correction", s.link_inertia_torque)
    if {MOTOR_SENSOR, JOINT_SENSOR} <= set(r.present):
        put(JOINT_SENSOR, "joint_delay", -s.joint_velocity, SENSOR_DELAY)
    if GAUGE in r.present:
        put(GAUGE, "torque_delay", -s.joint_torque_rate, SENSOR_DELAY)
    return found


def change_of(found: Innovations, any_delay: bool = False) -> dict[tuple[str, str], float]:
    """Least squares of the base alone, with its priors: the change of every base coefficient.

    `any_delay`: the delay of the motor torque has no prior.
    """
    channels = list(found.channels.values())
    base = channels[0].base
    keys = [(one.owner, one.name) for one in base]
    free = "command_delay" if any_delay else ""
    precision = np.array([0.0 if one.name == free else one.prior**-2.0 for one in base])
    x = np.concatenate([c.base_matrix[c.fitted] for c in channels])
    y = np.concatenate([c.left[c.fitted] for c in channels])
    norm = np.sqrt((x**2).sum(axis=0)) + 1e-300
    gram = (x / norm).T @ (x / norm) + np.diag(precision / norm**2) + 1e-9 * np.eye(norm.size)
    return dict(zip(keys, (np.linalg.solve(gram, (x / norm).T @ y) / norm).tolist(), strict=True))
