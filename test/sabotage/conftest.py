"""The tools of this folder are imported by name, as in the campaigns."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
