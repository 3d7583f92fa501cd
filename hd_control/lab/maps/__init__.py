"""Where a residual is large: over speed, load, position and frequency."""
