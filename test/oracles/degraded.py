"""What a degraded robot may do (A1), written down apart from the stages: estimates stand, the reference is slow."""

SETTLE_TICKS = 200
"""Ticks within which the reference must have slowed down."""
SHARE = 0.25


class DegradedOracle:
    """`look` once per tick, after it; `found` lists (tick, "A1", joint). `velocity_limit` rad/s per joint."""

    def __init__(self, velocity_limit):
        self.velocity_limit = [float(limit) for limit in velocity_limit]
        self.since, self.estimates = None, None
        self.found = []

    def look(self, tick, mode, reference_velocity, estimates):
        """The mode that the law reports, the reference of this tick, the estimates as bytes."""
        if mode != "DEGRADED":
            self.since = self.estimates = None
            return
        if self.since is None:
            self.since, self.estimates = tick, estimates
        if estimates != self.estimates:
            self.found.append((tick, "A1 estimate", -1))
        if tick - self.since > SETTLE_TICKS:
            for joint, limit in enumerate(self.velocity_limit):
                if not abs(float(reference_velocity[joint])) <= SHARE * limit * (1.0 + 1e-9):
                    self.found.append((tick, "A1 speed", joint))
