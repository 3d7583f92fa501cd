"""Codecs of the message types with a fixed layout, and the few variable ones through rosbags; no rclpy.

    codec = JointStateCodec(joint_names, RUN_ID_LENGTH, position=True, velocity=True)
    payload = codec.encode(stamp_ns, run_id, position=q, velocity=qd)
    if codec.matches(payload):
        stamp_ns, arrays = codec.decode(payload)     # arrays["position"], (joints,)

`frame_id` of every JointState of this package carries the run id of its publisher, `RUN_ID_LENGTH` characters.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from hd_control.record.fixed_cdr import ENCAPSULATION, Buffer, FixedCodec, Template

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

RUN_ID_LENGTH = 16
JOINT_FIELDS = ("position", "velocity", "effort")
JOINT_STATE = "sensor_msgs/msg/JointState"
TEMPERATURE = "sensor_msgs/msg/Temperature"
VALUES = "std_msgs/msg/Float64MultiArray"
NUMBER = "std_msgs/msg/Float64"
CLOCK = "rosgraph_msgs/msg/Clock"


class JointStateCodec(FixedCodec):
    """sensor_msgs/JointState with fixed names; fields switched off are empty arrays in the message."""

    def __init__(
        self,
        joint_names: Sequence[str],
        frame_id_length: int = RUN_ID_LENGTH,
        position: bool = True,
        velocity: bool = False,
        effort: bool = False,
    ) -> None:
        template, places = Template(), {}
        stamp_at = template.put(bytes(8), fixed=False)
        frame_at = template.text(b" " * frame_id_length, fixed=False)
        template.count(len(joint_names))
        for name in joint_names:
            template.text(name.encode("utf-8"))
        for field, present in zip(JOINT_FIELDS, (position, velocity, effort), strict=True):
            number = len(joint_names) if present else 0
            template.count(number)
            at = template.doubles(number)
            if number:
                places[field] = (at, number)
        super().__init__(JOINT_STATE, template, places, stamp_at, (frame_at, frame_id_length))
        self.joint_names = tuple(joint_names)


class TemperatureCodec(FixedCodec):
    """sensor_msgs/Temperature of one joint, `frame_id` fixed; fields `temperature` [°C] and `variance`."""

    def __init__(self, frame_id: str) -> None:
        template = Template()
        stamp_at = template.put(bytes(8), fixed=False)
        frame_at = template.text(frame_id.encode("utf-8"))
        places = {"temperature": (template.doubles(1), 1), "variance": (template.doubles(1), 1)}
        super().__init__(TEMPERATURE, template, places, stamp_at, (frame_at, len(frame_id.encode("utf-8"))))
        self._frame_id = self.joint_name = frame_id


class ValuesCodec(FixedCodec):
    """std_msgs/Float64MultiArray without dimensions: introspection values; field `data`."""

    def __init__(self, count: int) -> None:
        template = Template()
        template.count(0)
        template.count(0)
        template.count(count)
        super().__init__(VALUES, template, {"data": (template.doubles(count), count)})


class NumberCodec(FixedCodec):
    """std_msgs/Float64: one number without a stamp; field `data`."""

    def __init__(self) -> None:
        template = Template()
        super().__init__(NUMBER, template, {"data": (template.doubles(1), 1)})


class ClockCodec(FixedCodec):
    """rosgraph_msgs/Clock; the time is the stamp."""

    def __init__(self) -> None:
        template = Template()
        stamp_at = template.put(bytes(8), fixed=False)
        super().__init__(CLOCK, template, {}, stamp_at)


def codec_of(type_name: str, buffer: Buffer) -> FixedCodec | None:
    """The codec with the layout of this message; None if the type has no fixed layout or the bytes are not valid.

    Used on recordings, where names and lengths are known from the first message only. Reads nothing outside `buffer`.
    """
    make = _MAKERS.get(type_name)
    if make is None or bytes(buffer[:2]) != ENCAPSULATION[:2]:
        return None
    try:
        codec = make(_Cursor(buffer))
    except (IndexError, UnicodeDecodeError):
        return None
    return codec if codec.matches(buffer) else None


class _Cursor:
    """Reads CDR with every length checked against the bytes that are left; raises IndexError beyond them."""

    def __init__(self, buffer: Buffer) -> None:
        self.buffer, self.at = bytes(buffer), 4

    def skip(self, size: int, align: int = 1) -> bytes:
        start = self.at + (-(self.at - 4) % align)
        if start + size > len(self.buffer):
            raise IndexError("message ends early")
        self.at = start + size
        return self.buffer[start : self.at]

    def count(self) -> int:
        return int.from_bytes(self.skip(4, 4), "little")

    def text(self) -> str:
        return self.skip(self.count())[:-1].decode("utf-8")

    def doubles(self) -> int:
        number = self.count()
        if number:
            self.skip(8 * number, 8)
        return number


def _joint_state_of(cursor: _Cursor) -> FixedCodec:
    cursor.skip(8)
    frame_length = cursor.count() - 1
    cursor.skip(frame_length + 1)
    names = [cursor.text() for _ in range(min(cursor.count(), len(cursor.buffer)))]
    present = [cursor.doubles() > 0 for _ in JOINT_FIELDS]
    if frame_length < 0:
        raise IndexError("text without its end")
    return JointStateCodec(names, frame_length, *present)


def _temperature_of(cursor: _Cursor) -> FixedCodec:
    cursor.skip(8)
    return TemperatureCodec(cursor.text())


def _values_of(cursor: _Cursor) -> FixedCodec:
    cursor.skip(8, 4)
    return ValuesCodec(cursor.doubles())


def _number_of(cursor: _Cursor) -> FixedCodec:
    cursor.skip(8, 8)
    return NumberCodec()


def _clock_of(cursor: _Cursor) -> FixedCodec:
    cursor.skip(8)
    return ClockCodec()


_MAKERS: dict[str, Callable[[_Cursor], FixedCodec]] = {
    JOINT_STATE: _joint_state_of,
    TEMPERATURE: _temperature_of,
    VALUES: _values_of,
    NUMBER: _number_of,
    CLOCK: _clock_of,
}


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """The ROS 2 Jazzy message types of rosbags."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def encode_message(type_name: str, message: Any) -> bytes:
    """A rosbags message object (`message_class`) as CDR bytes; for types without a fixed layout."""
    return bytes(typestore().serialize_cdr(message, type_name))


def decode_message(type_name: str, buffer: Buffer) -> Any:
    """A rosbags message object from CDR bytes. Raises ValueError with the type for bytes that do not fit it."""
    try:
        return typestore().deserialize_cdr(bytes(buffer), type_name)
    except Exception as error:  # the library leaks struct.error, UnicodeDecodeError, KeyError, …
        raise ValueError(f"not a {type_name}: {type(error).__name__}: {error}") from None


def message_class(type_name: str) -> Any:
    """The rosbags class of a type, to be filled and given to `encode_message`."""
    return typestore().types[type_name]


def encode_text(text: str) -> bytes:
    """A std_msgs/String, without the library of types: loops call this, and loading that takes hundreds of ticks."""
    data = text.encode() + b"\0"
    return ENCAPSULATION + struct.pack("<I", len(data)) + data


def decode_text(buffer: Buffer) -> str:
    """The text of a std_msgs/String. Raises ValueError."""
    return str(decode_message("std_msgs/msg/String", buffer).data)


def new_run_id() -> str:
    """A run id: `RUN_ID_LENGTH` hexadecimal characters from the system's random source."""
    import secrets

    return secrets.token_hex(RUN_ID_LENGTH // 2)
