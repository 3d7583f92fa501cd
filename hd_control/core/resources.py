"""Where shipped files are found: the same in a checkout, after `pip install` and in a colcon workspace."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

from hd_control.core.errors import ConfigError


def _folder(name: str) -> Path:
    checkout = Path(__file__).resolve().parents[2] / name
    if checkout.is_dir():
        return checkout
    try:
        return Path(str(importlib.resources.files(f"hd_control.{name}")))
    except ModuleNotFoundError:
        raise ConfigError(f"the shipped folder {name}/ was not found; reinstall hd_control") from None


def config_path(relative: str = "") -> Path:
    """Path of a file below the shipped `config/` folder. Raises ConfigError if it does not exist."""
    path = _folder("config") / relative
    if not path.exists():
        known = ", ".join(sorted(p.name for p in path.parent.glob("*"))) if path.parent.is_dir() else "nothing"
        raise ConfigError(f"no shipped configuration {relative!r}; there is {known}")
    return path


def find_config(name_or_path: str, folder: str = "") -> Path:
    """A user's own file if it exists, else the shipped one of that name. Raises ConfigError otherwise."""
    path = Path(name_or_path).expanduser()
    if path.exists():
        return path
    if path.is_absolute() or len(path.parts) > 1:
        raise ConfigError(f"{path}: no such file")
    return config_path(f"{folder}/{name_or_path}" if folder else name_or_path)
