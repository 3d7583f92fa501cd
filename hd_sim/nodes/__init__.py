"""ROS 2 shells of the simulated world."""
