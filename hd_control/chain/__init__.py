"""The chain on arrays: each law at its place between topics, with its gate and its trajectory. Knows no ROS, no clock.

Nodes, the composed `chain` and the runner without ROS all run these objects; that is why they agree bit for bit.
"""
