"""From a recording to the signals of each joint in SI units on one time base, and whether they can be believed."""
