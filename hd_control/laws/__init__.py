"""Estimate, required torque, motor torque, trajectories and goals. Pure: no clock, no ROS, no files."""
