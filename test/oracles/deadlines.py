"""By when must a run with these injections have stopped? The fault table's N, written down apart from the monitors."""

LOST = 10
BAD_READINGS = 3
SENSORS = ("encoder", "resolver", "gauge_bridge")
STATES = ("joint_states", "motor_states", "joint_torque_required", "motor_torque_command")


def deadline(injection, seen):
    """The last tick in which the robot may not yet have stopped, or None if the fault demands no stop.

    `seen`: the ticks in which there was something to be seen; silence is seen from its onset on.
    """
    target, kind, onset, length = injection.target, injection.kind, injection.onset, injection.length
    if kind == "ok" or target == "joint_reference":
        return None
    if (kind == "off" or (kind == "exception" and target != "torque")) and length >= LOST:
        return onset + LOST
    if kind == "not_finite" and target in SENSORS:
        return seen[BAD_READINGS - 1] + 1 if len(seen) >= BAD_READINGS else None
    if (kind == "exception" and target == "torque") or (kind == "not_finite" and target in STATES):
        return seen[0] + 1 if seen else None
    return None
