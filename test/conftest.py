"""Makes the slow, obvious re-statements in test/oracles importable as `oracles`."""
