"""`docs/reference/glossary.md`: every name of a signal, parameter and effect with unit, symbol and meaning."""

from __future__ import annotations

from collections.abc import Iterator

from hd_control.analysis.signals import SIGNALS
from hd_control.control import guard_limits, integral_manifold, motion, torque, torque_feedback
from hd_control.core.blocks import Layout
from hd_control.core.parameters import Parameter, ParameterSet
from hd_control.drive.library import library
from hd_control.record.schema import TOPICS
from hd_control.reference import terms
from hd_control.reference.markdown import code, page, table
from hd_control.sensing import fusion

SETS: dict[str, ParameterSet] = {
    "fusion_node": fusion.PARAMETERS,
    "motion_node": motion.PARAMETERS,
    "torque_node": torque.PARAMETERS,
    "torque_node, law torque_feedback": torque_feedback.PARAMETERS,
    "torque_node, law integral_manifold": integral_manifold.PARAMETERS,
    "limits": guard_limits.PARAMETERS,
}
OUTPUTS: dict[str, Layout] = {
    "fusion": fusion.layout("FusionOutput", 1),
    "motion": motion.layout("MotionOutput", 1),
    "torque": torque.layout("TorqueOutput", 1),
}


def glossary_page() -> str:
    """The page."""
    intro = [
        "Angles are in rad and torques in N m, on the joint side of the gear unless the name says `motor_shaft`:",
        "angles of the motor are divided by the gear ratio, torques multiplied by it. Symbols are those of the papers.",
        "SI units throughout.",
    ]
    effects = (effect for effect in library().values() if effect.__module__.startswith("hd_control."))
    return page(
        "Glossary",
        "the parameter tables, the output blocks of the laws, the effect library and the topics",
        intro,
        ["## Words"],
        table(["word", "meaning"], sorted(terms.TERMS.items(), key=lambda item: item[0].lower())),
        ["## Signals of the analysis"],
        table(["name", "meaning"], ([code(name), terms.SIGNALS[name]] for name in SIGNALS)),
        ["## Topics"],
        table(["topic", "carries"], ([code(topic.name), topic.meaning] for topic in TOPICS.values())),
        ["## Effects"],
        table(["name", "what it is"], ([f"[`{e.name}`](effects.md#{e.name})", e.title] for e in effects)),
        ["## Parameters of laws and limits"],
        table(["name", "symbol", "unit", "meaning", "in"], _parameters()),
        ["## Numbers that the laws put out"],
        table(["name", "unit", "meaning", "of"], _outputs()),
    )


def _parameters() -> Iterator[list[str]]:
    """Every name once for each meaning that it has, with the places where it means that."""
    places: dict[tuple[str, str], tuple[Parameter, list[str]]] = {}
    for owner, parameters in SETS.items():
        for parameter in parameters.parameters:
            places.setdefault((parameter.name, parameter.meaning), (parameter, []))[1].append(owner)
    for _, (parameter, owners) in sorted(places.items()):
        yield [code(parameter.name), parameter.symbol, parameter.unit, parameter.meaning, "; ".join(owners)]


def _outputs() -> Iterator[list[str]]:
    rows = [(field, law) for law, layout in OUTPUTS.items() for field in layout.fields]
    for field, law in sorted(rows, key=lambda row: (row[0].name, row[1])):
        yield [code(field.name), field.unit, field.meaning, law]
