"""Goal G13: the system clock jumps by seconds and hours at random ticks; no number of the control changes."""

import os
import struct
from pathlib import Path

import pytest
from clock_jumps import FakeClock, hash_of_run, put_in_place, random_jumps, wall_ticks

from hd_control import _chain, _laws, _plane
from hd_sim import _drive_side, _plant

SEED = int(os.environ.get("HD_SEED", "1"))
CLOCKS = {"time", "clock", "gettimeofday", "clock_gettime", "timespec_get", "_ZNSt6chrono3_V212system_clock3nowEv",
          "_ZNSt6chrono3_V212steady_clock3nowEv"}  # fmt: skip
"""Names under which a compiled module would ask for the time."""


def linked_names(library):
    """Names that an ELF library asks of others or offers: its only table of strings that is loaded (.dynstr)."""
    data = library.read_bytes()
    start, size, count = *struct.unpack_from("<Q", data, 0x28), *struct.unpack_from("<HH", data, 0x3A)
    for place in range(start, start + size * count, size):
        _, kind, flags, _, offset, length = struct.unpack_from("<IIQQQQ", data, place)
        if kind == 3 and flags & 2:
            return set(data[offset : offset + length].decode().split("\0"))
    return set()


def clocks_of(module):
    """The clock functions that a compiled module calls."""
    names = linked_names(Path(module.__file__))
    assert "PyErr_SetString" in names, "the table was found"
    return sorted(names & CLOCKS)


def test_f15_g13_a_jump_of_the_clock_changes_no_number(monkeypatch):
    plain = hash_of_run()
    clock = FakeClock()
    put_in_place(monkeypatch, clock)
    assert hash_of_run(clock, random_jumps(SEED, 20)) == plain
    assert clock.offset_ns != 0


def test_f15_g13_the_plant_on_the_wall_clock_counts_ticks_by_the_steady_clock():
    """The number of the first tick is taken from the system clock, once; no jump makes, loses or repeats a tick."""
    sent = wall_ticks(random_jumps(SEED, 20))
    first = sent[0][0]
    assert first == 1_700_000_000_000 + 10**6 + 20
    assert sent == [(first + k, (first + k) * 1_000_000) for k in range(len(sent))]


@pytest.mark.parametrize("module", [_laws, _chain, _drive_side, _plant], ids=lambda module: module.__name__)
def test_f15_g13_the_compiled_tick_knows_no_clock(module):
    """Nobody can turn a clock under it: laws, monitors, guard, gate, watchdog and plant count ticks."""
    assert clocks_of(module) == []


def test_a_compiled_module_with_a_clock_is_noticed():
    assert "clock_gettime" in clocks_of(_plane)
