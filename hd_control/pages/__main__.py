"""`python -m hd_control.pages [FOLDER]`: writes the generated pages, by default into `docs`."""

from __future__ import annotations

import sys
from pathlib import Path

from hd_control.core.files import write_whole
from hd_control.pages.pages import PAGES

FOLDER = Path(__file__).resolve().parents[2] / "docs"


def main() -> None:
    """Writes every page. Words that are no folder are refused."""
    if len(sys.argv) > 2 or any(word.startswith("-") for word in sys.argv[1:]):
        sys.exit("usage: python -m hd_control.pages [FOLDER]")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    for name, make in PAGES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / name, make())


if __name__ == "__main__":
    main()
