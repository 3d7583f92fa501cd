"""The one error family of the project.

A message names what is wrong, the value, what is allowed, where, and what to do. The command line prints it on one
line and exits with `exit_code`; no traceback reaches a user.
"""

from __future__ import annotations


class HdError(Exception):
    """Base of every error that a user may see."""

    exit_code = 2


class ConfigError(HdError):
    """A file, parameter or combination of parameters is not usable."""


class RobotError(HdError):
    """A robot description (URDF) is missing, malformed or disagrees with the configuration."""


class GoalError(HdError):
    """A trajectory goal is malformed or infeasible. `code` names the check that refused it."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class BagError(HdError):
    """A recording cannot be opened, read or written."""


class AnswerIsNo(HdError):
    """A check that the user asked for failed; nothing was wrong with the question."""

    exit_code = 1
