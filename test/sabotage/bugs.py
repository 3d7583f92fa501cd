"""Hand-made bugs of the safety code: (name, file, text as it is, text with the bug, tests of which one must turn red).

Tests are a file, or a file and ` -k expression`. Missing of the thirty: S25 and S26 need a CAN bridge, S30 a studio.
"""

GATE = "hd_control/cpp/safety.hpp"
GUARD = "hd_control/safety/guard.py"
STAGE = "hd_control/chain/torque_stage.py"
SEAM = "hd_sim/drive_side.py"
SENSORS = "hd_control/safety/sensor_monitors.py"
T_GATE, T_GUARD = "test/safety/test_safety_gate.py", "test/safety/test_guard.py"
T_SENSORS, T_FAULTS = "test/safety/test_sensor_monitors.py", "test/hd_sim/test_fault_campaign.py"
T_SEAM, T_LONG_WAY = "test/hd_sim/test_drive_seam.py", "test/safety/test_monitors_long_way.py"
T_MOTION, T_BOX = "test/chain/test_degraded.py", "test/chain/test_black_box.py"
QUICK = ("S1", "S2", "S3", "S4", "S8", "S9", "S10")
"""Names of those that the quick lane tries as well."""
OUT_OF_SCOPE = {"S25": "no CAN bridge yet", "S26": "no CAN bridge yet", "S30": "no studio yet"}

BUGS = [
    (
        "S1 range test lets NaN through",
        GATE,
        "if (!(std::fabs(command) < INFINITY)) {",
        "if (std::fabs(command) >= INFINITY) {",
        T_GATE + " -k f04",
    ),
    (
        "S2 lower torque limit forgotten",
        GATE,
        "if (!(-limit <= u && u <= limit)) {",
        "if (!(u <= limit)) {",
        T_GATE + " -k too_large",
    ),
    (
        "S3 rate from the requested torque",
        GATE,
        "state.last_torque[j] = out[j];",
        "state.last_torque[j] = command[j];",
        T_GATE + " -k rate_is_measured",
    ),
    (
        "S4 limits of another joint",
        GATE,
        "double limit = limits.torque_limit[j], last = reference(j);",
        "double limit = limits.torque_limit[j > 0 ? j - 1 : joints - 1], last = reference(j);",
        T_GATE + " -k each_joint_has",
    ),
    (
        "S5 sign in the envelope",
        GUARD,
        "end = self._position + velocity *",
        "end = self._position - velocity *",
        T_GUARD + " -k f40",
    ),
    (
        "S6 torque while inactive",
        GATE,
        "const bool active = state.active[0] != 0.0;",
        "const bool active = true;",
        T_GATE + " -k not_active",
    ),
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
        T_GUARD + " -k 'stays_until or strongest'",
    ),
    (
        "S9 reset after one healthy sample",
        "hd_control/safety/gate.py",
        "if not healthy >= wanted:",
        "if not healthy >= 1.0:",
        T_GATE + " -k one_healthy_sample_short",
    ),
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
        "new.last_tick, new.last_torque = self._tick, self.gate.last_torque",
        "new.last_tick, new.last_torque = self._tick, 0.0",
        T_GUARD + " -k stays_until",
    ),
    ("S13 age test one sample late", GUARD, "(ages < self._age_limit)", "(ages <= self._age_limit)", T_GUARD),
    ("S14 equal tick accepted as new", GUARD, "fresh = (ticks > self._tick)", "fresh = (ticks >= self._tick)", T_GUARD),
    (
        "S15 spike test before unwrapping",
        SENSORS,
        "    change = modular(reading - predicted, period)\n",
        "    change = reading - predicted\n",
        T_SENSORS + " " + T_LONG_WAY,
    ),
    ("S16 rejects for ever", SENSORS, "    stays = gone & (", "    stays = gone & False & (", T_SENSORS),
    (
        "S17 frozen test at standstill",
        SENSORS,
        "    found = (np.abs(position - start) > moved) & (repeats",
        "    found = (repeats",
        T_LONG_WAY,
    ),
    (
        "S19 adaptation goes on in A1",
        STAGE,
        "                    self.state.view(name)[...] = before.view(name)\n",
        "                    pass\n",
        T_FAULTS + " -k a1_freezes",
    ),
    (
        "S21 exception caught and ignored",
        STAGE,
        "            self.exception = self.exception or error\n            command = self.stopped_command\n",
        "            command = self.allowed\n",
        T_FAULTS + " -k f33",
    ),
    (
        "stop that never decelerates",
        "hd_control/safety/guard.py",
        "- limits.stop_deceleration * dt, 0.0)",
        ", 0.0)",
        T_GUARD,
    ),
    (
        "infinite inputs not looked at",
        STAGE,
        "            command = self._checked(self.output.motor_torque)\n",
        "            command = self.output.motor_torque\n",
        T_FAULTS + " -k f04_an_infinite",
    ),
    (
        "goal never dropped",
        "hd_control/chain/motion_stage.py",
        "LOST_TOLERANCE = 0.05",
        "LOST_TOLERANCE = 50.0",
        T_MOTION,
    ),
    ("speed not looked at", GUARD, "SPEED_SHARE = 1.2", "SPEED_SHARE = 12.0", T_GUARD),
    (
        "S12 watchdog reads the system clock",
        SEAM,
        "        self._ticks.fill(tick)\n        demands",
        "        import time\n\n        self._now, before = time.time(), getattr(self, '_now', time.time())\n"
        "        ages = ages + 1e3 * abs(self._now - before)\n        self._ticks.fill(tick)\n        demands",
        "test/hd_sim/test_clock_jumps.py",
    ),
    (
        "S18 lost sample taken as if it had come",
        STAGE,
        "gap = tick - self.tick - 1 if self.tick >= 0 else 0",
        "gap = 0",
        T_FAULTS + " -k f01_every_second",
    ),
    (
        "S20 compliance not projected on its bounds",
        "hd_control/cpp/torque_adaptive.hpp",
        "            project(m.torsional_compliance, c * out.compliance_drive[j], p.adaptation_gain_compliance[j],\n"
        "                    p.torsional_compliance_low[j], p.torsional_compliance_high[j], T);",
        "            m.torsional_compliance + T * p.adaptation_gain_compliance[j] * c * out.compliance_drive[j];",
        "test/laws/test_torque.py test/laws/test_torque_lyapunov.py",
    ),
    (
        "S22 parameters judged one by one",
        "hd_control/nodes/shell.py",
        "plain(self._set[change.name], change.value) for change in own})",
        "plain(self._set[change.name], change.value) for change in own[:1]})",
        "test/nodes/test_parameter_service.py",
    ),
    (
        "S23 goal limits at the points only",
        "hd_control/laws/goals.py",
        "    found = path.extrema()\n",
        "    ends = _state(path, np.diff(path.knots) * path.period)\n"
        "    found = np.stack([x for part in ends for x in (part, part)], axis=2)\n",
        "test/laws/test_goal_check.py -k f22_each_refusal",
    ),
    (
        "S24 goal joints by place instead of name",
        "hd_control/laws/trajectory.py",
        "columns = [known.index(name) for name in names]",
        "columns = list(range(len(names)))",
        "test/laws/test_trajectory.py -k permuted",
    ),
    (
        "S27 drops never written into the bag",
        "hd_control/record/recorder.py",
        "            self.bag.store_accounts()\n            self._counted",
        "            self._counted",
        "test/record/test_recorder_ends.py -k never_closed",
    ),
    (
        "S28 write error swallowed",
        "hd_control/record/recorder.py",
        "            self._fail(str(self.bag.refused(error)))\n            return 0\n",
        "            return 0\n",
        "test/record/test_recorder.py -k fills_up",
    ),
    (
        "S29 chunks read without their checksum",
        "hd_control/record/mcap_read.py",
        "    if place.crc and zlib.crc32(data) != place.crc:",
        "    if False:",
        "test/record/test_damage.py -k checksums",
    ),
    (
        "reference at full speed while degraded",
        "hd_control/chain/motion_stage.py",
        "        degraded = self.controller_mode == DEGRADED\n",
        "        degraded = False\n",
        T_MOTION,
    ),
    (
        "goals taken while degraded",
        "hd_control/chain/motion_stage.py",
        "        if remedy is not None:",
        "        if remedy is None and False:",
        T_MOTION,
    ),
    (
        "newer black boxes removed too",
        "hd_control/record/black_box_files.py",
        "there[: max(0, len(there) + 1 - KEPT)]",
        "there[: len(there) + 1 - KEPT]",
        T_BOX + " -k twenty_are_kept",
    ),
    (
        "gains without a ramp",
        "hd_control/chain/stage.py",
        "GAIN_TIME = 0.1",
        "GAIN_TIME = 0.0",
        "test/chain/test_model_ramp.py -k f21_a_gain",
    ),
    (
        "stuck position sensor expected nowhere",
        "hd_control/cpp/safety.hpp",
        "partner + twist[j] : partner - twist[j];",
        "partner + twist[j] : positions[i] - twist[j];",
        "test/safety/test_sensor_monitors.py -k f03",
    ),
]
