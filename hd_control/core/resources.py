"""Where shipped files are found: the same in a checkout, after `pip install` and in a colcon workspace."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

from hd_control.core.errors import ConfigError


def _folder(name: str) -> Path:
    # Installed, the folder lies in the package; a checkout is asked last, for any site-packages may hold a `config/`.
    package = Path(str(importlib.resources.files("hd_control")))
    for folder in (package / name, Path(__file__).resolve().parents[2] / name):
        if folder.is_dir():
            return folder
    raise ConfigError(f"the shipped folder {name}/ was not found; reinstall hd_control")


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
