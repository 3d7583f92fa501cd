"""The world: a simulated harmonic-drive arm, written apart from the model in `hd_control.drive`."""
