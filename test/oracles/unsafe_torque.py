"""Which torque samples are unsafe, written down apart from the gate: conditions a, b, c, f and g of the safety rules.

Plain lists and fractions; shares no code and no array with what it judges. `judge` looks at one sample of one robot.
"""

from fractions import Fraction

EMITTING = ("ACTIVE", "DEGRADED", "STOPPING", "HOLDING")
# The emitted torque is a rounded sum of two floats; exact arithmetic sees that rounding. 1e-12 of the sizes involved.
ROUNDING = Fraction(1, 10**12)
CLEAR = 1.0 - 1e-6


def judge(torque, before, torque_limit, torque_step, state="ACTIVE", ages=None, age_limit=None, ticks=None, used=None):
    """Letters of every violated condition, with the joint: [("c", 2), ...]. Lists of one number per joint."""
    found = []
    for joint, value in enumerate(torque):
        if value != value or value in (float("inf"), float("-inf")):
            found.append(("a", joint))
            continue
        near = torque_limit[joint] * CLEAR
        if (
            state in EMITTING
            and ages is None
            and abs(value) < near
            and abs(value - before[joint]) < torque_step[joint] * CLEAR
        ):
            continue  # so far inside that no rounding matters
        exact = Fraction(value)
        if abs(exact) > Fraction(torque_limit[joint]):
            found.append(("b", joint))
        if state not in EMITTING:
            if exact != 0:
                found.append(("g", joint))
            continue
        slack = ROUNDING * (abs(exact) + abs(Fraction(before[joint])) + Fraction(torque_step[joint]))
        if abs(exact - Fraction(before[joint])) > Fraction(torque_step[joint]) + slack:
            found.append(("c", joint))
        if ages is not None and exact != 0 and (ages[joint] >= age_limit or ticks[joint] <= used[joint]):
            found.append(("f", joint))
    return found
