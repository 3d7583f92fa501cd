"""How much a campaign does: `hd test --long G8 --count 50` sets HD_COUNT; a campaign that does less says so."""

import os

SEED = int(os.environ.get("HD_SEED", "20240229"))


def count(usual: int) -> int:
    """The number of cases, runs or repeats: what was asked for, else the goal's own."""
    return int(os.environ.get("HD_COUNT", usual))


def enough(done: int, usual: int) -> str:
    """Words behind a figure when fewer were run than the goal asks for."""
    return "" if done >= usual else f" ({usual} asked for)"
