"""Hand-made bugs of the safety code: (name, file, text as it is, text with the bug, tests of which one must turn red).

Tests are a file, or a file and ` -k expression`. Missing of the thirty: S25 and S26 need a CAN bridge, S30 a studio.
"""

GATE = "hd_control/cpp/safety.hpp"
GUARD = "hd_control/cpp/guard.hpp"
SENSORS = "hd_control/cpp/sensor_watch.hpp"
TICK = "hd_control/cpp/chain.hpp"
SIDE = "hd_sim/cpp/drive_side.hpp"
T_GATE, T_GUARD = "test/safety/test_safety_gate.py", "test/safety/test_guard.py"
T_SENSORS, T_LIMITS = "test/safety/test_sensor_monitors.py", "test/safety/test_sensor_limits.py"
T_SIDE, T_FAULTS = "test/hd_sim/test_drive_seam.py", "test/hd_sim/test_fault_campaign.py"
T_BRAKES = "test/hd_sim/test_brakes.py"
T_MOTION, T_BOX = "test/chain/test_degraded.py", "test/chain/test_black_box.py"
QUICK = ("S7", "S8", "S16")
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
        "const double end = seen.joint_position[j] + v *",
        "const double end = seen.joint_position[j] - v *",
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
        SIDE,
        "        guard.step(command.data(), ages, ticks_.data(), applied.data(), rows);\n",
        "        std::copy(command.begin(), command.end(), applied.begin());\n",
        T_SIDE,
    ),
    (
        "S8 latch clears when the fault ends",
        GUARD,
        "        if (controlled()) {\n            controlled_stop(out, said);\n        } else {",
        "        state.controlled[0] = controlled() && action >= kControlledStop ? 1.0 : 0.0;\n"
        "        if (controlled()) {\n"
        "            controlled_stop(out, said);\n"
        "        } else {",
        T_GUARD + " -k 'stays_until or strongest'",
    ),
    (
        "S9 reset after one healthy sample",
        GUARD,
        "if (!(state.healthy[0] >= limits.reset_samples[0]))",
        "if (!(state.healthy[0] >= 1.0))",
        T_GATE + " -k one_healthy_sample_short",
    ),
    (
        "S10 weaker action replaces a stronger one",
        GUARD,
        "        if (gate.active[0] == 0.0 || gate.stopped[0] != 0.0) return;\n        const int cause",
        "        const int cause",
        T_GUARD,
    ),
    (
        "S11 restart from zero torque",
        GUARD,
        "for (int j = 0; j < n; ++j) gate.last_tick[j] = state.last_tick[j];",
        "for (int j = 0; j < n; ++j) gate.last_tick[j] = state.last_tick[j], gate.last_torque[j] = 0.0;",
        T_GUARD + " -k stays_until",
    ),
    (
        "S13 age test one sample late",
        GUARD,
        "ages[j] < limits.age_limit[0]",
        "ages[j] <= limits.age_limit[0]",
        T_GUARD,
    ),
    (
        "S14 equal tick accepted as new",
        GUARD,
        "if (!(ticks[j] > state.last_tick[j] &&",
        "if (!(ticks[j] >= state.last_tick[j] &&",
        T_GUARD,
    ),
    (
        "S15 spike test before unwrapping",
        SENSORS,
        "const double change = modular(reading - predicted, period);",
        "const double change = reading - predicted;",
        T_SENSORS,
    ),
    (
        "S16 rejects for ever",
        SENSORS,
        "const bool stays = gone && std::fabs(",
        "const bool stays = gone && false && std::fabs(",
        T_SENSORS,
    ),
    (
        "S17 frozen test at standstill",
        SENSORS,
        "if (std::fabs(position[j] - start_[at(0, j)]) > moved_limit_[at(0, j)] &&\n                repeats_",
        "if (repeats_",
        T_LIMITS,
    ),
    (
        "S19 adaptation goes on in A1",
        TICK,
        "if (keep) estimates(false);",
        "if (keep) estimates(true);",
        T_FAULTS + " -k a1_freezes",
    ),
    (
        "S21 exception caught and ignored",
        TICK,
        "if (failed.load(std::memory_order_acquire) && !guard.stopped()) wanted = no_command();",
        "if (failed.load(std::memory_order_acquire) && !guard.stopped()) wanted = allowed.data();",
        T_FAULTS + " -k f33",
    ),
    (
        "stop that never decelerates",
        GUARD,
        "std::fmax(std::fabs(before) - step, 0.0)",
        "std::fmax(std::fabs(before) - 0.0 * step, 0.0)",
        T_GUARD,
    ),
    (
        "infinite inputs not looked at",
        TICK,
        "all_finite(reference.data(), wanted)) return command.data();",
        "all_finite(reference.data(), wanted)) return command.data();\n        if (used > 0) return command.data();",
        T_FAULTS + " -k f04_an_infinite",
    ),
    (
        "goal never dropped",
        TICK,
        "kLostTolerance = 0.05;",
        "kLostTolerance = 50.0;",
        T_MOTION,
    ),
    (
        "speed not looked at",
        GUARD,
        "kSpeedShare = 1.2;",
        "kSpeedShare = 12.0;",
        T_GUARD,
    ),
    (
        "S12 watchdog reads the system clock",
        SIDE,
        "        const double* ages = no_age_.data();\n",
        "        static const auto begin = ::time(nullptr);\n"
        "        const double* ages = ::time(nullptr) < begin ? ages_.data() : no_age_.data();\n",
        "test/hd_sim/test_clock_jumps.py",
    ),
    (
        "S18 lost sample taken as if it had come",
        TICK,
        "const double gap = tick >= 0 ? static_cast<double>(now - tick - 1) : 0.0;",
        "const double gap = 0.0;",
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
        TICK,
        "const bool degraded = mode.load(std::memory_order_relaxed) == kDegraded;",
        "const bool degraded = false;",
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
        "hd_control/cpp/parameter_ramp.hpp",
        "kGainTime = 0.1;",
        "kGainTime = 0.0;",
        "test/chain/test_model_ramp.py -k f21_a_gain",
    ),
    (
        "stuck position sensor expected nowhere",
        GATE,
        "partner + twist[j] : partner - twist[j];",
        "partner + twist[j] : positions[i] - twist[j];",
        T_SENSORS + " -k f03",
    ),
    (
        "age of the inputs always zero",
        TICK,
        "std::fill(ages_.begin(), ages_.end(), input_age(static_cast<double>(now)));",
        "std::fill(ages_.begin(), ages_.end(), 0.0);",
        "test/chain/test_input_ages.py",
    ),
    (
        "a start of the law clears the latch",
        TICK,
        "        guard.deactivate();\n        gate_open = false;\n",
        "        guard.deactivate();\n        guard.gate.stopped[0] = 0.0;\n        gate_open = false;\n",
        "test/chain/test_latched_stops.py",
    ),
    (
        "commands of the future taken",
        SIDE,
        "        if (tick > now_) {",
        "        if (false) {",
        T_SIDE + " -k f44",
    ),
    (
        "a wild stamp leaves the others behind",
        "hd_control/cpp/message_join.hpp",
        "        return far && !confirmed;",
        "        return false;",
        "test/nodes/test_loop_parts.py -k f44",
    ),
    (
        "commands of another run id taken",
        "hd_control/cpp/message_join.hpp",
        "            return kForeign;",
        "            input.run_id = std::string(run_id);",
        "test/nodes/test_foreign_messages.py -k f24",
    ),
    (
        "the drive side does not hear of a second source",
        "hd_control/cpp/timed.hpp",
        "        if (commands_.stranger != nullptr) commands_.stranger(commands_.context);\n",
        "",
        "test/nodes/test_foreign_messages.py -k f24",
    ),
    (
        "armed while two sources send",
        SIDE,
        " && stranger_left_ == 0 ? healthy + 1 : 0;",
        " ? healthy + 1 : 0;",
        T_BRAKES + " -k another_source_of",
    ),
    (
        "the brakes open for any torque",
        SIDE,
        "const bool carried = brake_closed && through && carries();",
        "const bool carried = brake_closed && through;",
        T_BRAKES + " -k f46",
    ),
    (
        "motion after the brakes opened is not looked at",
        SIDE,
        "        if (slip_left_ > 0) slip();\n",
        "",
        T_BRAKES + " -k f47",
    ),
    (
        "the drives' guard does not see speed",
        SIDE,
        "            guard.seen.joint_velocity[j] = velocities[at(n + j)];\n",
        "            guard.seen.joint_velocity[j] = 0.0;\n",
        T_SIDE + " test/hd_sim/test_drive_side_oracle.py",
    ),
    (
        "temperatures straight into the gauge",
        TICK,
        "        watch.temperatures(in, dt, rows);\n",
        "",
        "test/safety/test_temperatures.py",
    ),
    (
        "temperatures in kelvin",
        "hd_sim/cpp/sensors.hpp",
        "        out.motor_temperature[j] = s.temperature[0][j];\n",
        "        out.motor_temperature[j] = s.temperature[0][j] + 273.15;\n",
        "test/hd_sim/test_plant_signals.py -k temperature",
    ),
    (
        "nobody looks whether the drive obeys",
        TICK,
        "        if (compares_applied) obedience(in);\n",
        "",
        "test/chain/test_obedience.py",
    ),
    (
        "live values go anywhere",
        "hd_control/core/parameters.py",
        "            if not low <= item <= high:",
        "            if False:",
        "test/laws/test_live_reach.py -k 'legal or both_ends or small'",
    ),
    (
        "huge goals are read before they are refused",
        "hd_control/nodes/goals.py",
        "            check_bytes(len(data))\n",
        "",
        "test/nodes/test_trajectory_action.py -k f22",
    ),
]
