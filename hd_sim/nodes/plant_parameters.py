"""Parameters of the plant node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hd_control.core.errors import ConfigError
from hd_control.core.parameters import Change, Parameter, ParameterSet, Shape
from hd_sim.plant_config import PlantConfig
from hd_sim.truth import HiddenEffect, apply_hidden, nominal

CLOCKS = ("wall", "lockstep")


def _hide_rule(values: Mapping[str, Any]) -> list[str]:
    found = []
    for text in filter(None, values["hide"]):
        parts = text.split(":")
        if len(parts) not in (2, 3) or (len(parts) == 3 and not _is_number(parts[2])):
            found.append(f"hide: {text!r} is not joint:effect or joint:effect:strength")
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


PARAMETERS = ParameterSet(
    "plant_node",
    (
        Parameter("plant", "plant file: shipped name or path", kind=str, change=Change.FIXED),
        Parameter(
            "clock",
            "wall: period by deadlines; lockstep: wait for the command of each tick",
            kind=str,
            choices=CLOCKS,
            change=Change.FIXED,
        ),
        Parameter(
            "seed", "seed of the sensor noise and of hidden effects", kind=int, low=0, high=2**31, change=Change.FIXED
        ),
        Parameter("nominal", "strip the plant of everything beyond the usual model", kind=bool, change=Change.FIXED),
        Parameter(
            "hide",
            "effects to add, joint:effect:strength; an empty text adds none",
            kind=str,
            shape=Shape.LIST,
            change=Change.FIXED,
        ),
        Parameter("stop_after_tick", "ticks to run; 0: endless", kind=int, low=0, high=2**53, change=Change.HOT),
        Parameter(
            "pause_at_tick",
            "lock-step waits before this tick until the value is raised; -1: never",
            kind=int,
            low=-1,
            high=2**53,
            change=Change.HOT,
        ),
        Parameter(
            "lockstep_timeout", "longest wait for a command in lock-step", "s", low=0.01, high=3600.0, change=Change.HOT
        ),
        Parameter(
            "lockstep_recorder_lag",
            "ticks that a recorder may lag in lock-step; 0: no recorder is waited for",
            kind=int,
            low=0,
            high=100_000,
            change=Change.FIXED,
        ),
    ),
    (_hide_rule,),
)


def plant_config(values: Mapping[str, Any]) -> PlantConfig:
    """The world that these values describe. Raises ConfigError."""
    config = PlantConfig.from_file(values["plant"])
    if abs(config.period - values["period"]) > 1e-12:
        raise ConfigError(
            f"period: {values['period']:g} s, but plant {values['plant']} has {config.period:g} s; set period"
        )
    if values["nominal"]:
        config = nominal(config)
    return apply_hidden(config, hidden_effects(values["hide"]), values["seed"])


def hidden_effects(texts: Sequence[str]) -> list[HiddenEffect]:
    """`joint:effect:strength` as values; strength 1 if left out."""
    found = []
    for text in filter(None, texts):
        joint, name, *strength = text.split(":")
        found.append(HiddenEffect(joint, name, float(strength[0]) if strength else 1.0))
    return found
