"""Joint torque and motion control of robots with harmonic drives, and a workbench that explains their error."""

__version__ = "0.1.0"
