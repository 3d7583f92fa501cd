"""A second world of one joint, written apart: own laws, integrator, sensors and clocks; docs/second_world.md."""
