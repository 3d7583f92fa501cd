"""Kalman filter of one joint and the responses of its innovations (hd_control/cpp/innovations_module.cpp)."""

from collections.abc import Sequence

from hd_control.core.arrays import BoolArray, FloatArray

class Joint:
    def __init__(self, rotor_inertia: float, stiffness: float, damping: float, period: float) -> None: ...
    def step(self, link_inertia: float) -> tuple[FloatArray, FloatArray]: ...

class Filter:
    present: int
    which: list[int]
    def __init__(
        self,
        joint: Joint,
        link_inertia: FloatArray,
        sensor_variance: FloatArray,
        force_variance: FloatArray,
        valid: BoolArray,
        start: Sequence[float],
    ) -> None: ...
    def predict(
        self,
        rotor: FloatArray | None = None,
        link: FloatArray | None = None,
        angle: FloatArray | None = None,
        motor_sensor: FloatArray | None = None,
        joint_sensor: FloatArray | None = None,
        torque_sensor: FloatArray | None = None,
    ) -> FloatArray: ...
    def whitening(self) -> FloatArray: ...
    def respond(
        self,
        taps: Sequence[float],
        stride: int,
        stamped: bool = False,
        rotor: FloatArray | None = None,
        link: FloatArray | None = None,
        angle: FloatArray | None = None,
        motor_sensor: FloatArray | None = None,
        joint_sensor: FloatArray | None = None,
        torque_sensor: FloatArray | None = None,
    ) -> FloatArray: ...
