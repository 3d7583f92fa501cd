"""Hand-made bugs of the safety code: (name, file, text as it is, text with the bug, tests of which one must turn red)."""

# ruff: noqa: E501 - pieces of code are quoted as they stand

GATE = "hd_control/control/safety_gate.py"
GUARD = "hd_control/control/guard.py"
STAGE = "hd_control/stages/torque_stage.py"
SEAM = "hd_sim/drive_seam.py"
SENSORS = "hd_control/sensing/sensor_monitors.py"
T_GATE, T_GUARD = "test/control/test_safety_gate.py", "test/control/test_guard.py"
T_SENSORS, T_FAULTS = "test/sensing/test_sensor_monitors.py", "test/hd_sim/test_fault_campaign.py"
T_SEAM = "test/hd_sim/test_drive_seam.py"

BUGS = [
    ("S1 range test lets NaN through", GATE, "if not abs(command) < math.inf:", "if abs(command) >= math.inf:", T_GATE),
    ("S2 lower torque limit forgotten", GATE, "if not -limit <= u <= limit:", "if not u <= limit:", T_GATE),
    (
        "S3 rate from the requested torque",
        GATE,
        "    state.last_torque = out\n",
        "    state.last_torque = command\n",
        T_GATE,
    ),
    (
        "S4 limits of another joint",
        GATE,
        "limit, step, last = float(limits.torque_limit[j])",
        "limit, step, last = float(limits.torque_limit[j - 1])",
        T_GATE,
    ),
    ("S5 sign in the envelope", GUARD, "end = position + velocity *", "end = position - velocity *", T_GUARD),
    ("S6 torque while inactive", GATE, "    active = bool(state.active != 0.0)\n", "    active = True\n", T_GATE),
    (
        "S7 drive side passes everything",
        SEAM,
        "torque, faults = self.guard.step(self.command, ages, self._ticks, demands)",
        "torque, faults = self.command.copy(), []",
        T_SEAM,
    ),
    (
        "S8 latch clears when the fault ends",
        GUARD,
        "        if self.controlled:\n            out, gate_faults",
        "        self.controlled = self.controlled and action >= Action.CONTROLLED_STOP\n"
        "        if self.controlled:\n            out, gate_faults",
        T_GUARD,
    ),
    ("S9 reset after one healthy sample", GATE, "if not healthy >= wanted:", "if not healthy >= 1.0:", T_GATE),
    (
        "S10 weaker action replaces a stronger one",
        GUARD,
        "        if self.gate.active == 0.0 or self.gate.stopped != 0.0:\n            return\n",
        "",
        T_GUARD,
    ),
    (
        "S11 restart from zero torque",
        GUARD,
        "        new.last_torque = applied\n        return gate.activate(new, self.limits.gate, applied)",
        "        return gate.activate(new, self.limits.gate, 0.0 * applied)",
        T_GUARD,
    ),
    ("S13 age test one sample late", GUARD, "(ages < self._age_limit)", "(ages <= self._age_limit)", T_GUARD),
    ("S14 equal tick accepted as new", GUARD, "fresh = (ticks > self._tick)", "fresh = (ticks >= self._tick)", T_GUARD),
    (
        "S15 spike test before unwrapping",
        SENSORS,
        "    change = modular(reading - predicted, period)\n",
        "    change = reading - predicted\n",
        T_SENSORS,
    ),
    ("S16 rejects for ever", SENSORS, "    stays = gone & (", "    stays = gone & False & (", T_SENSORS),
    ("S17 frozen test at standstill", SENSORS, "    found = moved & (repeats", "    found = (repeats", T_SENSORS),
    (
        "S19 adaptation goes on in A1",
        STAGE,
        "                    self.state.view(name)[...] = before.view(name)\n",
        "                    pass\n",
        T_FAULTS,
    ),
    (
        "S21 exception caught and ignored",
        STAGE,
        "            self.exception = self.exception or error\n            command = self.stopped_command\n",
        "            command = self.allowed\n",
        T_FAULTS,
    ),
    (
        "stop that never decelerates",
        "hd_control/control/controlled_stop.py",
        "- limits.stop_deceleration * dt, 0.0)",
        ", 0.0)",
        T_GUARD,
    ),
    (
        "infinite inputs not looked at",
        STAGE,
        "            command = self._checked(self.output.motor_torque)\n",
        "            command = self.output.motor_torque\n",
        T_FAULTS,
    ),
    (
        "goal never dropped",
        "hd_control/stages/motion_stage.py",
        "LOST_TOLERANCE = 0.05",
        "LOST_TOLERANCE = 50.0",
        T_FAULTS,
    ),
    ("speed not looked at", GUARD, "SPEED_SHARE = 1.2", "SPEED_SHARE = 12.0", T_GUARD),
]
