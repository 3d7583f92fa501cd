"""The growing end of a file: every byte in order, whatever the system takes at once; the CRC is zlib's."""

from __future__ import annotations

import errno
import io
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_bags import T0

from hd_control._pump import RecordFile
from hd_control.record.mcap_write import message_record


class Slow:
    """Takes at most some bytes at a time, as a file near its limit does, then fails if so made."""

    def __init__(self, sizes, failure: BaseException | None = None) -> None:
        self.sizes, self.failure, self.data = list(sizes), failure, b""

    def write(self, data) -> int:
        if not self.sizes:
            if self.failure is not None:
                raise self.failure
            self.data += bytes(data)
            return len(data)
        size = min(self.sizes.pop(0), len(data))
        self.data += bytes(data[:size])
        return size


@given(st.lists(st.binary(max_size=40), max_size=8), st.lists(st.integers(1, 30), max_size=8))
def test_bytes_arrive_in_order_and_the_crc_is_theirs(parts, sizes):
    stream, places = Slow(sizes), []
    file = RecordFile(stream)
    for number, part in enumerate(parts):
        places.append(file.append(part))
        if number % 2:
            file.flush()
    file.flush()
    whole = b"".join(parts)
    assert stream.data == whole and file.crc == zlib.crc32(whole)
    assert places == [len(b"".join(parts[:number])) for number in range(len(parts))]
    assert (file.position, file.end, file.pending) == (len(whole), len(whole), 0)


@given(st.binary(max_size=100))
def test_a_message_is_the_record_of_the_format(payload):
    stream = Slow([])
    file = RecordFile(stream)
    file.message(3, 0xFFFFFFFF, T0, T0 + 5, payload)
    file.message(3, 1, T0 - 9, 0, payload)
    file.flush()
    assert stream.data == message_record(3, 0xFFFFFFFF, T0, T0 + 5, payload) + message_record(3, 1, T0 - 9, 0, payload)
    assert (file.counts, file.first_ns, file.last_ns) == ({3: 2}, T0 - 9, T0)


@pytest.mark.parametrize("taken", [0, 1, 7])
def test_a_refused_write_says_how_far_it_came(taken):
    stream = Slow([taken] if taken else [], OSError(errno.ENOSPC, "made to fail"))
    file = RecordFile(stream)
    file.append(b"0123456789")
    with pytest.raises(OSError, match="made to fail") as caught:
        file.flush()
    assert caught.value.errno == errno.ENOSPC
    assert (file.position, file.pending, file.crc) == (taken, 10 - taken, zlib.crc32(b"0123456789"[:taken]))


def test_a_file_that_takes_nothing_is_an_error_not_an_endless_loop():
    file = RecordFile(Slow([0, 0, 0]))
    file.append(b"x")
    with pytest.raises(OSError, match="took no more bytes"):
        file.flush()


def test_an_error_of_another_kind_passes_through():
    file = RecordFile(Slow([], ZeroDivisionError("a defect of the stream")))
    file.append(b"x")
    with pytest.raises(ZeroDivisionError):
        file.flush()


def test_a_real_full_device_names_its_reason():
    with open("/dev/full", "wb", buffering=0) as raw:
        file = RecordFile(raw.fileno())
        file.append(b"x")
        with pytest.raises(OSError, match="No space left") as caught:
            file.flush()
    assert caught.value.errno == errno.ENOSPC


def test_a_closed_file_is_an_error(tmp_path):
    with (tmp_path / "file").open("wb", buffering=0) as raw:
        file = RecordFile(raw.fileno())
    file.append(b"x")
    with pytest.raises(OSError, match="Bad file descriptor"):
        file.flush()


def test_what_is_no_file_is_refused():
    file = RecordFile(io.BytesIO())
    file.append(b"x")
    file.flush()
    with pytest.raises(TypeError):
        file.append("text")
