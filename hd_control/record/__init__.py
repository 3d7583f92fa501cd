"""Recording and reading: CDR bytes, MCAP bags, columns. Pure: no ROS needed."""
