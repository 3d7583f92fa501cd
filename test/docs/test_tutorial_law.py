"""The law of the tutorial, as printed there, moves the simulated joint; what goes wrong in a law ends in a stop."""

from __future__ import annotations

import importlib.metadata
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_blocks import ROOT, Written, steps

from hd_control.core.errors import ConfigError
from hd_control.core.faults import FaultCode
from hd_control.laws.plug_ins import GROUP, PythonLaw, command_of, law_named
from hd_control.laws.torque import new_reference, new_sample
from hd_sim.plant_config import PlantConfig
from hd_sim.runner import Runner, RunSetup
from hd_sim.scenario import find_scenario, make_plan

PAGE = ROOT / "docs" / "tutorials" / "write_a_law.md"
Install = Callable[[str, str], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Writes a module and names the class in it, as if its package were installed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    known: list[str] = []

    def write(module: str, text: str, kind: str = "Law") -> None:
        (tmp_path / f"{module}.py").write_text(text)
        point = importlib.metadata.EntryPoint("cautious", f"{module}:{kind}", GROUP)
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [point] if group == GROUP else [])
        known.append(module)

    yield write
    for module in known:
        sys.modules.pop(module, None)


def printed() -> dict[str, str]:
    return {step.name: step.text for step in steps(PAGE) if isinstance(step, Written)}


def a_law(body: str) -> str:
    head = "import numpy as np\nfrom hd_control.laws.plug_ins import PythonLaw\n\nclass Law(PythonLaw):\n"
    return head + textwrap.indent(textwrap.dedent(body), "    ")


def make(plug_in: str = "cautious") -> Runner:
    return Runner(RunSetup(PlantConfig.from_file("single_joint_5"), 0, {"torque_node": {"plug_in": plug_in}}))


def test_the_page_names_its_own_files() -> None:
    files = printed()
    assert f'[project.entry-points."{GROUP}"]\ncautious = "cautious_law:CautiousLaw"\n' in files["pyproject.toml"]
    assert yaml.safe_load(files["cautious.yaml"]) == {"torque_node": {"ros__parameters": {"plug_in": "cautious"}}}


def test_the_printed_law_follows_a_sine_without_a_fault(install: Install) -> None:
    install("cautious_law", printed()["cautious_law.py"], "CautiousLaw")
    runner = make()
    scenario, config = find_scenario("sine_joint_5_0p5hz"), PlantConfig.from_file("single_joint_5")
    limit = RunSetup(config).node_values("motion_node")["velocity_limit"]
    plan = make_plan(scenario, runner.robot.joint_names, config.start_position, limit, config.period)
    errors: list[float] = []

    def note(tick: int, bus: dict[str, dict[str, np.ndarray]]) -> None:
        if tick > 1000:
            errors.append(abs(float((bus["joint_reference"]["position"] - bus["joint_states"]["position"])[0])))

    runner.run(type(plan)(plan.goals, 4000, plan.window), note)
    assert not runner.torque.guard.stopped and runner.torque.mode == "ACTIVE"
    assert 1e-5 < max(errors) < 5e-3, "it moves 0.1 rad, and not by the compiled law"
    _, _, values = runner.torque.report()
    assert values["plug_in"] == "CautiousLaw: a law in Python, not real time" and "coulomb_torque" not in values


def test_a_run_at_once_takes_the_same_steps_and_a_compiled_recording_is_refused(install: Install) -> None:
    install("same_law", a_law("def step(self, sample, reference):\n    return reference.joint_torque_required\n"))
    one, two = make(), make()
    one.run_on(150)
    for _ in range(150):
        two.step()
    np.testing.assert_array_equal(one.torque.allowed, two.torque.allowed)
    assert one.tick == two.tick == 150
    with pytest.raises(ConfigError, match="a law in Python runs step by step only"):
        one.record({}, 10)


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ("def step(self, sample, reference):\n    raise KeyError('a bug')\n", FaultCode.EXCEPTION),
        ("def step(self, sample, reference):\n    return np.zeros(2)\n", FaultCode.EXCEPTION),
        ("def step(self, sample, reference):\n    return None\n", FaultCode.NOT_FINITE),
        ("def step(self, sample, reference):\n    return [float('nan')]\n", FaultCode.NOT_FINITE),
    ],
)
def test_f33_f04_what_goes_wrong_in_a_law_stops_the_robot(install: Install, body: str, code: FaultCode) -> None:
    install("broken_law", a_law(body))
    runner = make()
    runner.run_on(3)
    assert runner.torque.guard.stopped
    if code is FaultCode.EXCEPTION:
        assert runner.torque.exception is not None
        assert runner.torque.report()[1].startswith("HD-F33")
    else:
        assert runner.torque.faults.first_stop is not None and runner.torque.faults.first_stop.code is code


def test_a_law_cannot_change_what_it_is_given_and_hears_of_activations(install: Install) -> None:
    install("rude_law", a_law(
        """
        started = 0
        def start(self):
            self.started += 1
        def step(self, sample, reference):
            sample.array[:] = 1e9
            reference.array[:] = 1e9
            return np.zeros(len(self.joint_names))
        """
    ))  # fmt: skip
    runner = make()
    runner.run_on(2)
    assert (runner.torque.sample.array < 1e8).all() and runner.torque.plug_in is not None
    assert runner.torque.plug_in.started == 1
    runner.torque.start()
    assert runner.torque.plug_in.started == 2


def test_names_and_classes_that_are_no_law_are_refused(install: Install) -> None:
    with pytest.raises(ConfigError, match="no installed package has a law 'bold' in group hd_control.laws; there is"):
        law_named("bold", ("a",), 1e-3)
    install("odd_law", "class Law:\n    def __init__(self, joint_names, period):\n        pass\n")
    with pytest.raises(ConfigError, match="is no hd_control.laws.plug_ins.PythonLaw"):
        law_named("cautious", ("a",), 1e-3)
    install("bad_law", "raise ImportError('a missing library')\n")
    with pytest.raises(ConfigError, match="cannot be made: ImportError: a missing library"):
        make()


def test_a_torque_of_another_length_is_an_error() -> None:
    class Short(PythonLaw):
        def step(self, sample: object, reference: object) -> list[float]:
            return [1.0]

    law = Short(("a", "b"), 1e-3)
    with pytest.raises(ValueError, match="one torque for each joint"):
        command_of(law, new_sample(2), new_reference(2))
