"""Parameters and blocks: one source of bounds, atomic refusal, named views of one array."""

import copy
import math

import numpy as np
import pytest

from hd_control.core.blocks import layout_of
from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape, field_numbers, parameters_of

GAINS = ParameterSet(
    "node",
    (
        Parameter("gain", "gain", "1/s", low=0.0, open_low=True, shape=Shape.PER_JOINT),
        Parameter("limit", "limit", "N m", low=0.0, high=10.0),
        Parameter("law", "law", kind=str, choices=("a", "b")),
        Parameter("joints", "joints", kind=str, shape=Shape.LIST),
        Parameter("count", "count", kind=int, low=1),
        Parameter("on", "switch", kind=bool),
    ),
    rules=(lambda v: [] if sum(v["gain"]) < v["limit"] else [f"sum of gain {sum(v['gain']):g} >= limit"],),
)
GOOD = {"gain": [1.0, 2.0], "limit": 5, "law": "a", "joints": [], "count": 3, "on": True}


def test_a_good_set_has_no_problems():
    assert GAINS.problems(GOOD, 2) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"gain": [1.0, 0.0]}, r"gain\[1\]: 0 is outside \(0, inf\) 1/s"),
        ({"gain": [1.0, math.nan]}, r"gain\[1\]: nan"),
        ({"gain": [1.0]}, "1 values, expected 2"),
        ({"gain": 1.0}, "expected a list"),
        ({"gain": [1.0, True]}, "not a number"),
        ({"gain": [4.0, 2.0]}, "sum of gain 6 >= limit"),
        ({"limit": math.inf}, "inf"),
        ({"limit": 11}, r"outside \[0, 10\] N m"),
        ({"law": "c"}, "one of a, b"),
        ({"count": 1.5}, "whole number"),
        ({"on": 1}, "true or false"),
        ({"joints": [1]}, "not text"),
        ({"gian": 1}, "unknown parameter of node, did you mean gain"),
    ],
)
def test_f20_each_bad_value_is_named_with_what_is_allowed(change, says):
    with pytest.raises(ConfigError, match=f"HD-F20 param_bad node: .*{says}"):
        GAINS.check({**GOOD, **change}, 2)


def test_all_problems_are_reported_together():
    found = GAINS.problems({**GOOD, "limit": -1, "law": "x"}, 2)
    assert len(found) == 2


def test_missing_parameter_is_named():
    without = {name: value for name, value in GOOD.items() if name != "limit"}
    assert GAINS.problems(without, 2) == ["limit: missing (limit, [0, 10] N m)"]


FIELDS = [("position", 1, "rad", "angle"), ("time", 0, "s", "time"), ("link", 3, "-", "three each")]


def test_block_fields_are_views_of_one_array():
    block = layout_of("Demo", FIELDS, 2).zeros()
    block.position = [1.0, 2.0]
    block.time = 3.0
    block.link[1, 2] = 4.0
    np.testing.assert_array_equal(block.array, [1, 2, 3, 0, 0, 0, 0, 0, 4])
    names = block.layout.element_names(["a", "b"])
    assert len(names) == block.array.size and names[8] == "link/b/2"
    assert block.time.shape == () and block.link.shape == (2, 3)


def test_block_refuses_unknown_fields_and_copies_independently():
    block = layout_of("Demo", FIELDS, 2).pack({"position": [1, 2], "time": 3, "link": np.ones((2, 3))})
    with pytest.raises(AttributeError, match="Demo has no field 'velocity'"):
        block.velocity = 1.0
    other = block.copy()
    other.position[0] = 9.0
    assert block.position[0] == 1.0
    np.testing.assert_array_equal(copy.deepcopy(block).array, block.array)


LAW = [
    ("mode", 0, "-", "which of two"),
    ("on", 0, "-", "switch"),
    ("count", 0, "samples", "how many"),
    ("gain", 1, "1/s", "error to rate"),
    ("wave", 2, "rad", "factor of cos n theta in rad"),
    ("pole", 0, "-", "computed"),
]
ALLOWED = {
    "mode": ("word", 0.0, math.inf, False, ("slow", "fast")),
    "on": ("truth", 0.0, 1.0, False, ()),
    "count": ("whole", 1.0, 9.0, False, ()),
    "gain": ("number", 0.0, math.inf, True, ()),
    "wave": ("number", -0.1, 0.1, False, ()),
}


def test_the_fields_of_a_block_become_parameters():
    more = {"wave": {"symbol": "a_n"}, "gain": {"symbol": "k", "change": Change.HOT}}
    found = parameters_of(LAW, ALLOWED, more, without=("pole",), source="chosen")
    assert found == (
        Parameter("mode", "which of two", kind=str, choices=("slow", "fast"), source="chosen"),
        Parameter("on", "switch", kind=bool, source="chosen"),
        Parameter("count", "how many", "samples", kind=int, low=1, high=9, source="chosen"),
        Parameter("gain", "error to rate", "1/s", shape=Shape.PER_JOINT, low=0.0, open_low=True, symbol="k",
                  source="chosen", change=Change.HOT),
        Parameter("wave_1", "factor of cos 1 theta in rad", "rad", shape=Shape.PER_JOINT, low=-0.1, high=0.1,
                  symbol="a_1", source="chosen"),
        Parameter("wave_2", "factor of cos 2 theta in rad", "rad", shape=Shape.PER_JOINT, low=-0.1, high=0.1,
                  symbol="a_2", source="chosen"),
    )  # fmt: skip
    assert isinstance(found[2].low, int)


@pytest.mark.parametrize("stranger", [{"more": {"gian": {}}}, {"more": {}, "without": ("pool",)}])
def test_what_is_said_of_no_field_is_refused(stranger):
    with pytest.raises(ValueError, match="has no field (gian|pool)"):
        parameters_of(LAW, ALLOWED, **stranger)


def test_values_of_parameters_become_numbers_of_the_fields():
    values = {"mode": "fast", "on": True, "count": 3, "gain": [1.0, 2.0], "wave_1": [5.0, 6.0], "wave_2": [7.0, 8.0]}
    block = layout_of("Law", LAW, 2).pack(field_numbers(LAW, ALLOWED, values) | {"pole": 0.8})
    np.testing.assert_array_equal(block.array, [1, 1, 3, 1, 2, 5, 7, 6, 8, 0.8])
    assert "pole" not in field_numbers(LAW, ALLOWED, values)
