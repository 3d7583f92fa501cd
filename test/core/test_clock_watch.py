"""F15: a jump of the system clock is reported with its size; slow corrections and the first look are none."""

import pytest

from hd_control.core.clock_watch import ClockWatch

S = 1_000_000_000


@pytest.mark.parametrize("jump", [1.0, -1.0, 3600.0, -3600.0, 0.11])
def test_f15_a_jump_of_the_system_clock_is_reported_with_its_size(jump):
    watch = ClockWatch()
    assert watch.look(1_700_000_000 * S, 50 * S) is None
    assert watch.look(1_700_000_001 * S, 51 * S) is None
    fault = watch.look(1_700_000_002 * S + round(jump * S), 52 * S)
    assert fault is watch.last and fault.value == pytest.approx(jump) and watch.jumps == 1
    assert "HD-F15 clock_jump" in fault.text() and f"{jump:.6g} s" in fault.text()
    assert watch.look(1_700_000_003 * S + round(jump * S), 53 * S) is None and watch.jumps == 1


def test_f15_slow_corrections_are_no_jump():
    watch = ClockWatch()
    for k in range(100):
        assert watch.look(k * S + k * 100_000_000, k * S) is None
    assert watch.jumps == 0
