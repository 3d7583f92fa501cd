"""What is missing or doubtful in a recording, as values."""

from __future__ import annotations

from dataclasses import dataclass

RECORD_CAP = 64 << 20
EXPANSION_CAP = 1000


@dataclass(frozen=True)
class Problem:
    """One finding. `loses_data` is False for notices: nothing is known to be missing because of it."""

    text: str
    file: str = ""
    offset: int = -1
    loses_data: bool = True

    def __str__(self) -> str:
        place = f" at byte {self.offset}" if self.offset >= 0 else ""
        return f"{self.file}{place}: {self.text}" if self.file else self.text
