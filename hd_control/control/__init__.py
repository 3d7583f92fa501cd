"""Control laws, trajectories, goal checks and the safety gate. Pure: no clock, no ROS, no files."""
