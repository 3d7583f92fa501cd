"""`hd calibrate BAG --model M -o fusion.yaml`: ripple, gain and offset of the gauge bridges from a slow turn."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hd_control.drive.model import Model
    from hd_control.lab.signals.joint_signals import JointSignals, Recording
    from hd_control.laws.calibration import GaugeFit, GaugeModel, SlowTurn

NAME = "calibrate"
HELP = "gauge ripple, gain and offset from a recorded slow turn, written as fusion parameters"
EXAMPLE = "hd calibrate bags/slow_turn --model single_joint_5.yaml --params fusion_node.yaml -o my_fusion.yaml"
SCHEMA = "hd.calibrate/1"
PARTLY_READ = 3
FIELDS = {
    "gain": "gauge_gain",
    "offset": "gauge_offset",
    "offset_drift": "gauge_temperature_drift",
    "reference_temperature": "gauge_reference_temperature",
    **{name: f"gauge_{name}" for name in ("cosine_2", "sine_2", "cosine_4", "sine_4")},
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("bag", metavar="BAG", help="recording of a slow turn: bag folder, .mcap or .db3 file")
    parser.add_argument(
        "--model", metavar="MODEL", required=True, help="model file; the true torque follows from its links"
    )
    parser.add_argument("--params", metavar="FILE", default="fusion_node.yaml", help="fusion parameters to start from")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="fusion parameters to write")
    parser.add_argument("--joint", metavar="NAME", action="append", help="only this joint; repeatable [all recorded]")
    parser.add_argument("--only", nargs="+", choices=("ripple", "offset", "gain"), help="what to estimate [all three]")
    parser.add_argument("--map", metavar="FILE", help="mapping of a foreign bag's topics, joints, units")


def run(arguments: argparse.Namespace) -> int:
    """Writes the parameter file; 0 done, 3 if the bag could be read in part only. Refuses a turn that cannot decide."""
    from pathlib import Path

    from hd_control.cli.options import refuse_overwrite, say, write_json
    from hd_control.core.files import write_whole
    from hd_control.core.resources import find_config
    from hd_control.core.strict_yaml import load_params_file
    from hd_control.drive.model_file import load_model
    from hd_control.lab.signals.recording import read_recording
    from hd_control.laws import fusion
    from hd_control.laws.calibration import PARTS

    output, source = Path(arguments.output), find_config(arguments.params)
    refuse_overwrite(output, arguments.force)
    values = load_params_file(source, "fusion_node")
    fusion.PARAMETERS.check(values, len(values.get("joint_names", ())), str(source))
    model, recording = load_model(arguments.model), read_recording(arguments.bag, arguments.map)
    joints = chosen_joints(arguments.joint, recording, values, model)
    parts = tuple(arguments.only or PARTS)
    fits = {joint: calibrate(recording, model, values, joint, parts) for joint in joints}
    changed = with_fits(values, fits)
    write_whole(output, params_text(changed, fits, recording.path))
    for text in (*recording.problems, *recording.notes):
        say(arguments, f"  ! {text}")
    for joint, fit in fits.items():
        for line in lines(joint, fit):
            say(arguments, line)
    say(arguments, f"written: {output}")
    document = {"schema": SCHEMA, "bag": {"path": recording.path, "sha256": recording.sha256}, "file": str(output)}
    write_json(arguments, {**document, "joints": {joint: as_json(fit) for joint, fit in fits.items()}})
    return PARTLY_READ if recording.problems else 0


def chosen_joints(asked: list[str] | None, recording: Recording, values: Mapping[str, Any], model: Model) -> list[str]:
    """The joints to calibrate. Raises BagError for one that recording, parameters or model do not have."""
    from hd_control.core.errors import BagError

    known = [joint for joint in values["joint_names"] if joint in recording.joints and joint in model.joints]
    for joint in asked or ():
        if joint not in known:
            raise BagError(f"{joint}: not in recording, parameters and model together; there is {', '.join(known)}")
    if not known:
        raise BagError(f"{recording.path}: recording, parameters and model have no joint in common")
    return list(asked or known)


def calibrate(
    recording: Recording, model: Model, values: Mapping[str, Any], joint: str, parts: tuple[str, ...]
) -> GaugeFit:
    """The gauge parameters of one joint. Raises BagError if the recording does not determine them."""
    from hd_control.laws.calibration import fit_gauge

    row = list(values["joint_names"]).index(joint)
    own = {name: value[row] for name, value in values.items() if isinstance(value, list)}
    return fit_gauge(slow_turn(recording, model, own, joint), gauge_model(own), parts)


def gauge_model(own: Mapping[str, Any]) -> GaugeModel:
    """The present parameters of one joint."""
    from hd_control.laws.calibration import GaugeModel

    return GaugeModel(**{field: float(own[name]) for field, name in FIELDS.items()})


def slow_turn(recording: Recording, model: Model, own: Mapping[str, Any], joint: str) -> SlowTurn:
    """The columns of one joint without gaps; the gauge angle as the fusion law forms it."""
    import numpy as np

    from hd_control.core.errors import BagError
    from hd_control.lab.balances.link import link_torque
    from hd_control.laws.calibration import SlowTurn, unwrap

    signals = recording.joints[joint]
    shaft, position, gauge = (
        _needed(signals, name) for name in ("motor_shaft_position", "joint_position", "gauge_torque")
    )
    torque, velocity = link_torque(model, recording.joints, joint)
    good = signals.valid & np.isfinite(shaft) & np.isfinite(position) & np.isfinite(gauge)
    if good.sum() < 2:
        raise BagError(f"{joint}: encoder, joint sensor and gauge are never there together")
    angles = []
    for column, kind in ((shaft, "encoder"), (position, "resolver")):
        period = float(own[f"{kind}_period"])
        rows = column[good] if period == 0.0 else unwrap(column[good], period)
        angles.append(rows - float(own[f"{kind}_offset"]))
    angle = angles[0] - float(own["gauge_joint_turns"]) * angles[1] + float(own["gauge_angle_offset"])
    warm = None if signals.temperature is None else signals.temperature[good]
    rotor = velocity[good] * float(own["gear_ratio"])
    return SlowTurn(joint, gauge[good], torque[good], angle, velocity[good], rotor, warm)


def _needed(signals: JointSignals, name: str) -> Any:
    from hd_control.core.errors import BagError

    column = getattr(signals, name)
    if column is None:
        raise BagError(f"{signals.joint}: {name} is not recorded; a calibration needs encoder, joint sensor and gauge")
    return column


def with_fits(values: Mapping[str, Any], fits: Mapping[str, GaugeFit]) -> dict[str, Any]:
    """The parameters with the estimates in their places."""
    changed = {name: list(value) if isinstance(value, list) else value for name, value in values.items()}
    for joint, fit in fits.items():
        row = list(values["joint_names"]).index(joint)
        for field in fit.errors:
            changed[FIELDS[field]][row] = getattr(fit.model, field)
    return changed


def params_text(values: Mapping[str, Any], fits: Mapping[str, GaugeFit], bag: str) -> str:
    """A ROS params file of the fusion node; estimated lists carry their standard errors as a comment."""
    from hd_control.core.parameters import yaml_value
    from hd_control.laws import fusion

    text = ["/**:", "  ros__parameters:", f"    # Fusion parameters; gauge of {', '.join(fits)} calibrated from {bag}"]
    for parameter in fusion.PARAMETERS.parameters:
        name = parameter.name
        words = [] if parameter.unit == "-" else [parameter.unit]
        field = next((field for field, other in FIELDS.items() if other == name), "")
        words += [f"{joint} ± {fit.errors[field]:.2g}" for joint, fit in fits.items() if field in fit.errors]
        text.append(f"    {name}: {yaml_value(values[name])}" + (f"  # {'; '.join(words)}" if words else ""))
    return "\n".join(text) + "\n"


def lines(joint: str, fit: GaugeFit) -> list[str]:
    """The estimates as text for people."""
    values = [f"{FIELDS[name]} {getattr(fit.model, name):.5g} ± {error:.2g}" for name, error in fit.errors.items()]
    found = [f"{joint}: {fit.rows} samples, {fit.turns:.1f} wave-generator turns, load spans {fit.torque_span:.3g} N m"]
    found += [f"  {text}" for text in values]
    found.append(f"  gauge against the links' torque: {fit.before:.3g} N m RMS before, {fit.after:.3g} after")
    return [*found, *(f"  ! {note}" for note in fit.notes)]


def as_json(fit: GaugeFit) -> dict[str, Any]:
    """One joint in schema hd.calibrate/1."""
    values = {FIELDS[name]: {"value": getattr(fit.model, name), "error": e} for name, e in fit.errors.items()}
    return {"parameters": values, "rms_before": fit.before, "rms_after": fit.after, "rows": fit.rows,
            "wave_generator_turns": fit.turns, "torque_span": fit.torque_span, "notes": list(fit.notes)}  # fmt: skip
