"""The long campaigns are run rarely; a change of the quick tests that they use must not break them unseen."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_every_campaign_can_be_collected_and_names_tests_that_exist():
    campaigns = sorted((ROOT / "test" / "campaigns").glob("test_*.py"))
    named = {name for path in campaigns for name in re.findall(r'"(test/[\w/]+\.py::\w+)"', path.read_text())}
    assert len(campaigns) >= 22 and named
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run([*command, *map(str, campaigns), *sorted(named)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    for path in campaigns:
        assert f"{path.name}::test_" in done.stdout
