"""Codecs of the message types with a fixed layout, and the few variable ones through rosbags; no rclpy.

    codec = JointStateCodec(joint_names, RUN_ID_LENGTH, position=True, velocity=True)
    payload = codec.encode(stamp_ns, run_id, position=q, velocity=qd)
    if codec.matches(payload):
        stamp_ns, arrays = codec.decode(payload)     # arrays["position"], (joints,)

`frame_id` of every JointState of this package carries the run id of its publisher, `RUN_ID_LENGTH` characters.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hd_control.core.arrays import ByteArray, FloatArray, IntArray
from hd_control.core.topics import JOINT_STATE_TYPE, TEMPERATURE_TYPE, VALUES_TYPE

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


# ---- A fixed layout: written into a template, read as numpy columns --------------------------------
#
# CDR is little-endian XCDR1 with the four-byte encapsulation header `00 01 00 00`; alignment counts from the byte after
# it. Once joint names and the length of `frame_id` are fixed, every message of a topic has the same layout, so a
# message is the template with some bytes replaced, and a whole recording is one 2-D byte array.
#
# rclpy leaves the padding bytes uninitialised and appends up to 8 unused bytes after a JointState with empty arrays;
# both are ignored here and written as zeros, respectively not at all.


Buffer = bytes | bytearray | memoryview

ENCAPSULATION = b"\x00\x01\x00\x00"
SURPLUS = 15
"""Unused bytes tolerated after a message: serialisers round the length up."""

_SECOND = 1_000_000_000
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")


class Template:
    """Builds the bytes of a message and the mask of those that never change."""

    def __init__(self) -> None:
        self.data, self.mask = bytearray(ENCAPSULATION), bytearray(b"\xff\xff\x00\x00")

    def align(self, size: int) -> None:
        self.put(bytes(-(len(self.data) - 4) % size), fixed=False)

    def put(self, data: bytes, fixed: bool = True) -> int:
        """Appends bytes; returns where they start."""
        self.data += data
        self.mask += (b"\xff" if fixed else b"\x00") * len(data)
        return len(self.data) - len(data)

    def count(self, value: int) -> None:
        self.align(4)
        self.put(_COUNT.pack(value))

    def text(self, value: bytes, fixed: bool = True) -> int:
        self.count(len(value) + 1)
        start = self.put(value, fixed)
        self.put(b"\x00")
        return start

    def doubles(self, number: int) -> int:
        if number:
            self.align(8)
        return self.put(bytes(8 * number), fixed=False)


@dataclass(frozen=True)
class MessageColumns:
    """Many messages of one topic. Each array in `values` is (n, numbers); `frame_ids` is (n,) bytes or None."""

    stamps_ns: IntArray | None
    frame_ids: NDArray[np.bytes_] | None
    values: Mapping[str, FloatArray]


class FixedCodec:
    """Bytes of one message type whose layout never changes.

    `type_name` is the ROS type, `size` the exact length in bytes, `fields` the number of doubles of each field.
    `encode` reuses one template: a codec belongs to one thread.
    """

    def __init__(
        self,
        type_name: str,
        template: Template,
        places: Mapping[str, tuple[int, int]],
        stamp_at: int | None = None,
        frame: tuple[int, int] | None = None,
    ) -> None:
        self.type_name, self.size = type_name, len(template.data)
        self.fields = {name: number for name, (_, number) in places.items()}
        self._mask = int.from_bytes(template.mask, "little")
        self._fixed = int.from_bytes(template.data, "little") & self._mask
        self._stamp_at, self._frame, self._places = stamp_at, frame, dict(places)
        self._first = min((at for at, _ in places.values()), default=self.size)
        self._doubles = (self.size - self._first) // 8
        starts = {name: ((at - self._first) // 8, number) for name, (at, number) in places.items()}
        self._slices = {name: slice(start, start + number) for name, (start, number) in starts.items()}
        self.fixed_bytes = self._fixed.to_bytes(self.size, "little")
        self.mask_bytes = self._mask.to_bytes(self.size, "little")
        self._message = template.data
        self._targets = {name: np.frombuffer(self._message, "<f8", n, at) for name, (at, n) in places.items()}
        self._frame_id: str | None = None

    @property
    def places(self) -> dict[str, tuple[int, int]]:
        """Byte offset and number of doubles of each field."""
        return dict(self._places)

    @property
    def stamp_place(self) -> int:
        """Byte offset of the stamp. Raises ValueError for a type without one."""
        if self._stamp_at is None:
            raise ValueError(f"{self.type_name} has no stamp")
        return self._stamp_at

    @property
    def frame_place(self) -> tuple[int, int]:
        """Byte offset and length of the frame_id; (0, 0) for a type without one."""
        return self._frame or (0, 0)

    def encode(self, stamp_ns: int = 0, frame_id: str = "", **values: ArrayLike) -> bytes:
        """One message. `values` are arrays of the lengths in `fields`; a field not given is zero.

        Raises ValueError for a wrong length or field, or a `frame_id` of another length than fixed.
        """
        if self._stamp_at is not None:
            _STAMP.pack_into(self._message, self._stamp_at, *divmod(stamp_ns, _SECOND))
        if self._frame is not None and frame_id != self._frame_id:
            self._set_frame_id(frame_id)
        for name, target in self._targets.items():
            target[...] = values.get(name, 0.0)
        if len(values) > len(self._targets) or any(name not in self._targets for name in values):
            raise ValueError(f"{self.type_name} here has the fields {', '.join(self.fields)}, not {', '.join(values)}")
        return bytes(self._message)

    def _set_frame_id(self, frame_id: str) -> None:
        assert self._frame is not None
        at, length = self._frame
        self._message[at : at + length] = self._frame_bytes(frame_id)
        self._frame_id = frame_id

    def _frame_bytes(self, frame_id: str) -> bytes:
        assert self._frame is not None
        data = frame_id.encode("utf-8")
        if len(data) != self._frame[1]:
            raise ValueError(f"frame_id {frame_id!r} has {len(data)} bytes, this topic has {self._frame[1]}")
        return data

    def matches(self, buffer: Buffer) -> bool:
        """True if length, names, counts and encapsulation are those of this codec; then `decode` is exact."""
        size = self.size
        if not size <= len(buffer) <= size + SURPLUS:
            return False
        return int.from_bytes(buffer[:size], "little") & self._mask == self._fixed

    def decode(self, buffer: Buffer) -> tuple[int, dict[str, FloatArray]]:
        """(stamp_ns, arrays by field) of one message for which `matches` holds; the arrays are aligned and writable.

        A shorter buffer raises ValueError; nothing is ever read outside it.
        """
        if len(buffer) < self.size:
            raise ValueError(f"{len(buffer)} bytes, a {self.type_name} of this topic has {self.size}")
        stamp_ns = 0
        if self._stamp_at is not None:
            seconds, nanoseconds = _STAMP.unpack_from(buffer, self._stamp_at)
            stamp_ns = seconds * _SECOND + nanoseconds
        if not self._doubles:
            return stamp_ns, {}
        tail = np.frombuffer(buffer, "<f8", self._doubles, self._first).copy()
        return stamp_ns, {name: tail[part] for name, part in self._slices.items()}

    def stamp_ns(self, buffer: Buffer) -> int:
        """Only the stamp [ns]; 0 for a type without one."""
        if self._stamp_at is None:
            return 0
        seconds, nanoseconds = _STAMP.unpack_from(buffer, self._stamp_at)
        return int(seconds * _SECOND + nanoseconds)

    def rows(self, buffers: Sequence[Buffer] | ByteArray) -> ByteArray:
        """Messages as (n, at least size) uint8. Raises ValueError if the lengths differ or are too short."""
        if isinstance(buffers, np.ndarray):
            rows = buffers
        else:
            width = len(buffers[0]) if buffers else self.size
            joined = b"".join(buffers)
            if any(len(buffer) != width for buffer in buffers):
                raise ValueError(f"messages of {self.type_name} differ in length")
            rows = np.frombuffer(joined, np.uint8).reshape(len(buffers), width)
        if rows.ndim != 2 or rows.dtype != np.uint8 or rows.shape[1] < self.size:
            raise ValueError(f"expected bytes of shape (n, {self.size} or more), got {rows.dtype} {rows.shape}")
        return rows

    def columns(self, buffers: Sequence[Buffer] | ByteArray) -> MessageColumns:
        """Many messages at once; layout as in `matches`, not checked again. Arrays are (n, numbers), contiguous."""
        rows = self.rows(buffers)
        return self.columns_from(lambda at, width: np.ascontiguousarray(rows[:, at : at + width]))

    def columns_from(self, take: Callable[[int, int], ByteArray]) -> MessageColumns:
        """Like `columns`, from `take(at, width)` that gives (n, width) bytes at a place within each message."""
        stamps, frames = None, None
        if self._stamp_at is not None:
            stamps = take(self._stamp_at, 4).view("<i4").astype(np.int64)[:, 0] * _SECOND
            stamps += take(self._stamp_at + 4, 4).view("<u4")[:, 0]
        if self._frame is not None and self._frame[1]:
            frames = take(*self._frame).view(f"S{self._frame[1]}")[:, 0]
        values = {name: take(at, 8 * number).view("<f8") for name, (at, number) in self._places.items() if number}
        return MessageColumns(stamps, frames, values)

    def encode_columns(self, stamps_ns: ArrayLike, frame_id: str = "", **values: ArrayLike) -> ByteArray:
        """Many messages as (n, size) uint8; each of `values` is (n, numbers). The inverse of `columns`."""
        stamps = np.asarray(stamps_ns, np.int64).reshape(-1)
        if self._frame is not None:
            self._set_frame_id(frame_id)
        unknown = [name for name in values if name not in self._places]
        if unknown:
            raise ValueError(f"{self.type_name} here has the fields {', '.join(self.fields)}, not {', '.join(unknown)}")
        rows = np.tile(np.frombuffer(self._message, np.uint8), (len(stamps), 1))
        if self._stamp_at is not None:
            split = np.empty((len(stamps), 2), "<u4")
            seconds, split[:, 1] = np.divmod(stamps, _SECOND)
            split[:, 0] = seconds.astype(np.int32).view(np.uint32)
            rows[:, self._stamp_at : self._stamp_at + 8] = split.view(np.uint8)
        for name, (at, number) in self._places.items():
            data = np.zeros((len(stamps), number), "<f8")
            if name in values:
                data[...] = values[name]
            rows[:, at : at + 8 * number] = data.view(np.uint8)
        return rows


# ---- The types -------------------------------------------------------------------------------------


RUN_ID_LENGTH = 16
JOINT_FIELDS = ("position", "velocity", "effort")
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
        super().__init__(JOINT_STATE_TYPE, template, places, stamp_at, (frame_at, frame_id_length))
        self.joint_names = tuple(joint_names)


class TemperatureCodec(FixedCodec):
    """sensor_msgs/Temperature of one joint, `frame_id` fixed; fields `temperature` [°C] and `variance`."""

    def __init__(self, frame_id: str) -> None:
        template = Template()
        stamp_at = template.put(bytes(8), fixed=False)
        frame_at = template.text(frame_id.encode("utf-8"))
        places = {"temperature": (template.doubles(1), 1), "variance": (template.doubles(1), 1)}
        super().__init__(TEMPERATURE_TYPE, template, places, stamp_at, (frame_at, len(frame_id.encode("utf-8"))))
        self._frame_id = self.joint_name = frame_id


class ValuesCodec(FixedCodec):
    """std_msgs/Float64MultiArray without dimensions: introspection values; field `data`."""

    def __init__(self, count: int) -> None:
        template = Template()
        template.count(0)
        template.count(0)
        template.count(count)
        super().__init__(VALUES_TYPE, template, {"data": (template.doubles(count), count)})


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
    JOINT_STATE_TYPE: _joint_state_of,
    TEMPERATURE_TYPE: _temperature_of,
    VALUES_TYPE: _values_of,
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


def message_class(type_name: str) -> Any:
    """The rosbags class of a type, to be filled and given to `encode_message`."""
    return typestore().types[type_name]


def encode_text(text: str) -> bytes:
    """A std_msgs/String, without the library of types: loops call this, and loading that takes hundreds of ticks."""
    data = text.encode() + b"\0"
    return ENCAPSULATION + struct.pack("<I", len(data)) + data


def new_run_id() -> str:
    """A run id: `RUN_ID_LENGTH` hexadecimal characters from the system's random source."""
    import secrets

    return secrets.token_hex(RUN_ID_LENGTH // 2)
