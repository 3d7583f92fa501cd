"""Limits, gate, guard and monitors: what may stop the robot. The last layers before a command leaves."""
