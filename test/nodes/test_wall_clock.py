"""On the wall clock no figure is promised on a busy computer; every tick is accounted for."""

from __future__ import annotations

from pathlib import Path

import pytest
from node_runs import random_domain

from hd_control.session.session import RunPlan, Session

pytestmark = pytest.mark.process


def accounted(session: Session) -> int:
    """Ticks that the plant published or counted as slept through."""
    found = session.diagnostics("chain")
    return int(found.get("ticks", "0")) + int(found.get("skipped", "0"))


def test_f17_every_wall_tick_is_published_or_counted_as_skipped(tmp_path: Path) -> None:
    plan = RunPlan(nodes=("chain",), parameters={"chain": {"stop_after_tick": 1500}})
    with Session(plan, random_domain(), tmp_path, real_time=False) as session:
        session.activate()
        session.wait_for(lambda: accounted(session) >= 1500, 30.0, "published and skipped ticks do not add up")
        found = session.diagnostics("chain")
        assert int(found["missed"]) <= int(found["skipped"])
        assert int(found["ticks"]) > 0
    assert session.exit_codes == {"chain": 0}, session.log("chain")
