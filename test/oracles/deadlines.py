"""By when must a run with these injections have stopped? The fault table's N, written down apart from the monitors."""

LOST = 10
BAD_READINGS = 3
SENSORS = ("encoder", "resolver", "gauge_bridge")
STATES = ("joint_states", "motor_states", "joint_torque_required", "motor_torque_command")


def deadline(injection):
    """The last tick in which the robot may not yet have stopped, or None if the fault demands no stop."""
    target, kind, onset, length = injection.target, injection.kind, injection.onset, injection.length
    if kind == "ok" or target == "joint_reference":
        return None
    if kind == "off" and length >= LOST:
        return onset + LOST
    if kind == "exception" and target == "torque":
        return onset + 1
    if kind == "exception" and length >= LOST:
        return onset + LOST
    if kind == "not_finite":
        if target in SENSORS:
            return onset + BAD_READINGS if length >= BAD_READINGS else None
        return onset + 1 if target in STATES else None
    return None
