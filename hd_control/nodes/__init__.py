"""ROS 2 shells around the laws: the only places, with `hd_sim/nodes`, that know rclpy. No arithmetic lives here."""
