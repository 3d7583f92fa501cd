"""Parameters of the compiled laws: each value lands in its own field of the law's block, for its own joint."""

import copy

import numpy as np
import pytest

from hd_control import _laws
from hd_control.chain.chain import shipped_values
from hd_control.core.parameters import Shape
from hd_control.laws import fusion, integral_manifold, torque, torque_adaptive, torque_feedback

DT = 1e-3
CASES = {
    "fusion": (fusion, fusion, {}),
    "adaptive": (torque, torque_adaptive, {"law": "adaptive", "kinematic_feedforward": True, "adaptation_scale": 1.0}),
    "integral_manifold": (torque, integral_manifold, {"law": "integral_manifold"}),
    "torque_feedback": (torque, torque_feedback, {"law": "torque_feedback"}),
}
"""Law -> module that configures it, module of its parameters, values."""
COMPUTED = {"fast_gain"}


def _values(case):
    configures, _, given = CASES[case]
    values = shipped_values("fusion_node" if configures is fusion else "torque_node")
    values = {name: copy.copy(values[name]) for name in configures.PARAMETERS.names} | given
    return values | ({"link_inertia": [2.0] * 7} if "link_inertia" in values else {})


@pytest.mark.parametrize("case", CASES)
def test_each_value_lands_in_its_own_field(case):
    configures, law, _ = CASES[case]
    values = _values(case)
    before = configures.configure(values, None, DT)
    names = [p.name for p in law.PARAMETERS.parameters if p.shape is Shape.PER_JOINT]
    reached = set()
    for name in names:
        own = copy.copy(values[name])
        little = 1e-9 * (abs(own[4]) or 1.0)  # stays inside every rule
        own[4] += -little if name.endswith("_high") else little
        if name == "gauge_joint_turns":
            own[4] = 1.0
        after = configures.configure({**values, name: own}, None, DT)
        moved = {field for field in before.layout.slices if np.any(before.view(field) != after.view(field))}
        if name in before.layout.slices:
            assert name in moved and after.view(name)[4] == own[4], name
            assert moved - {name} <= COMPUTED, name
        elif name[:-2] in before.layout.slices:
            assert moved == {name[:-2]} and after.view(name[:-2])[4, int(name[-1]) - 1] == own[4], name
        assert all(np.argwhere(before.view(f) != after.view(f))[:, 0].tolist() == [4] for f in moved), name
        reached |= moved
    per_joint = {field.name for field in before.layout.fields if field.per_joint}
    assert per_joint <= reached, "fields that no parameter reaches"


@pytest.mark.parametrize("case", CASES)
def test_each_word_has_the_number_of_its_place(case):
    configures, law, _ = CASES[case]
    values = _values(case)
    block = configures.configure(values, None, DT).layout.name
    for name, (kind, *_, words) in _laws.ALLOWED[block].items():
        if kind == "word" and name != "law":
            assert law.PARAMETERS[name].choices == words
            numbers = [float(configures.configure({**values, name: word}, None, DT).view(name)) for word in words]
            assert numbers == list(range(len(words)))
