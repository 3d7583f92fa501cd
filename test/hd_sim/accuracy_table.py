"""Prints the table of docs/world.md: largest rotor error over one second for some numbers of substeps per millisecond.

PYTHONPATH=test python test/hd_sim/accuracy_table.py
"""

import numpy as np
from test_plant_accuracy import PROFILES, limit, rotor_motion

SUBSTEPS = (5, 10, 20)


def main() -> None:
    """One line per motion; the limit is that of the first-order scheme, extrapolated."""
    for name in PROFILES:
        errors = (np.abs(rotor_motion(name, count) - limit(name)).max() for count in SUBSTEPS)
        print(f"| {name.replace('_', '-')} | " + " | ".join(f"{error:.2e}" for error in errors) + " |")


if __name__ == "__main__":
    main()
