"""Words of this package that belong to no table of the code; the tables fill the rest of the glossary."""

from __future__ import annotations

TERMS: dict[str, str] = {
    "bag": "A recording: a folder with metadata.yaml and MCAP files, a bare .mcap file or a .db3 file.",
    "balance, channel": "One of the three equations of a joint: motor_torque (rotor), transmission (torsion), "
    "link_torque (link). What the model leaves of it is the residual of that channel.",
    "chain": "Fusion, motion and torque law with gate, one after the other; also the node that runs them in one "
    "thread.",
    "effect": "One physical cause with its parameters, such as backlash. A model is a list of effects.",
    "flexspline torque": "The torque that the gear's flexible ring carries, measured by a gauge bridge on it.",
    "gate, guard": "The gate is the last limit before the command; the guard around it decides when to stop.",
    "goal": "A trajectory that is checked as a whole before it is accepted.",
    "held out": "Data that no fit has seen; errors that count are measured on them.",
    "joint side": "Behind the gear. Motor angles are divided by the gear ratio, motor torques multiplied by it.",
    "ladder": "Errors of a model before and after each effect that was added to it.",
    "law": "A pure step from sample and reference to output, with parameters and state as blocks.",
    "lock-step": "The plant waits for the command of tick k before tick k+1; the same torques on every machine.",
    "nat": "Unit of evidence: a factor e between the likelihoods of two explanations of the same data.",
    "presliding": "Elastic motion of a friction contact before it slips.",
    "residual": "Measurement minus model in one channel.",
    "rotor": "Motor shaft with wave generator.",
    "sealed truth": "The hidden effects of a simulated drive, in a file that is opened only after the diagnosis is "
    "written.",
    "stage": "A law at its place between topics, without ROS.",
    "tick": "The number k of a control period; time is k times the period and travels in header.stamp.",
    "torsion": "Joint angle minus motor angle divided by the gear ratio: wind-up of the gear.",
    "VDC": "Virtual decomposition control: the required torque of each joint from the dynamics of its own link (Zhu).",
    "verdict": "Answer of a diagnosis: adequate, missing, unknown, missing_and_unknown or cannot_tell.",
}
SIGNALS: dict[str, str] = {
    "motor_shaft_position": "rotor angle before the gear, multi-turn [rad]",
    "joint_position": "joint angle behind the gear [rad]",
    "gauge_torque": "torque that the gauge bridge indicates [N m]",
    "motor_torque": "motor torque times gear ratio, held from its stamp to the next [N m]",
    "temperature": "motor temperature [degC]",
    "reference_position": "desired joint angle [rad]",
}
"""Meaning of each signal of `hd_control.analysis.signals.SIGNALS`."""
