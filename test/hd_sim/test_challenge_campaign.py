"""Campaigns: blind, resumable, the same with one and two workers, errors as answers."""

import json

import numpy as np
import pytest

from hd_control.core.errors import BagError, ConfigError
from hd_sim.puzzles.campaign import Campaign, read_record, run_campaign, run_one
from hd_sim.puzzles.draw import draw_case
from hd_sim.puzzles.tables import FAILED, make_table


def adequate(question):
    """A diagnosis that always finds the model good; it looks at what it was given."""
    assert set(question.model) == {"joint", "gear_ratio", "rated_torque", "robot", "effects"}
    return {"verdict": "adequate", "effects": [], "unknown": None, "experiments": [], "n": question.fit["time"].size}


def refuses(question):
    raise BagError("no signals")


@pytest.mark.parametrize("world", ["home", "second", "real_like"])
def test_the_question_holds_nothing_of_the_case(world):
    seen = []

    def look(question):
        seen.append(question)
        return adequate(question)

    entry = run_one(Campaign(1, 17, "one", world=world), 17, look)
    assert set(vars(seen[0])) == {"period", "fit", "held_out", "model"} and entry["world"] == world
    assert "strength" not in json.dumps(seen[0].model) and "visibility" not in json.dumps(seen[0].model)
    known = {"time", "reference_position", "temperature", "motor_shaft_position", "joint_position", "gauge_torque"}
    assert set(seen[0].fit) <= known | {"motor_torque"}
    assert entry["category"] == "one" and entry["score"]["missed"] == entry["names"]


def test_an_error_of_the_diagnosis_is_an_answer():
    entry = run_one(Campaign(1, 3, "none"), 3, refuses)
    assert entry["score"]["verdict"] == FAILED and entry["answer"]["error"] == "no signals"
    assert not entry["score"]["correct"] and not entry["score"]["false_alarm"]
    assert any(row.name == "diagnosis failed" and row.hits == 1 for row in make_table([entry]))


def test_after_a_refusal_the_judge_plays_the_experiment():
    asked = []

    def refuses_poor_ones(question):
        asked.append(question)
        poor = len(asked) == 1
        return {"verdict": "cannot_tell" if poor else "adequate", "effects": [], "unknown": None}

    seed = next(s for s in range(100) if draw_case(s, "poor").motion == "slow_only" and not draw_case(s, "poor").names)
    entry = run_one(Campaign(1, seed, "poor"), seed, refuses_poor_ones)
    speeds = [np.abs(np.diff(question.fit["reference_position"])).max() * 1e3 for question in asked]
    assert len(asked) == 2 and speeds[0] < 0.1 and speeds[1] > 0.8
    assert entry["score"]["refused"] and entry["score_after_experiment"]["correct"]
    rows = {row.name: row for row in make_table([entry])}
    assert rows["poor recording: refused, right after a general one"].hits == 1


def test_both_worlds_take_turns():
    campaign = Campaign(4, 10, world="both")
    assert [campaign.world_of(seed) for seed in campaign.seeds()] == ["home", "second", "home", "second"]
    assert Campaign(1, 3, world="second").world_of(3) == "second" and Campaign(1, 3).world_of(3) == "home"


def test_an_interrupted_campaign_goes_on_where_it_stopped(tmp_path):
    record, campaign = tmp_path / "run.jsonl", Campaign(6, 40, "poor")
    started = run_campaign(campaign, adequate, record=record)
    first = [next(started)["seed"] for _ in range(2)]
    started.close()
    with record.open("a") as file:
        file.write('{"seed": 42, "cut o')
    again = list(run_campaign(campaign, adequate, record=record))
    assert first == [40, 41] and sorted(entry["seed"] for entry in again) == list(range(40, 46))
    assert len(read_record(record, campaign)) == 6
    assert len(list(run_campaign(campaign, refuses, record=record))) == 6, "nothing is asked twice"


def test_workers_give_the_same_records():
    campaign = Campaign(3, 60, "poor")
    one, two = (
        {e["seed"]: {k: v for k, v in e.items() if k != "cpu_seconds"} for e in run_campaign(campaign, adequate, jobs)}
        for jobs in (1, 2)
    )
    assert one == two


def test_a_foreign_or_other_record_is_refused(tmp_path):
    other = tmp_path / "other.jsonl"
    list(run_campaign(Campaign(1, 1, "poor"), adequate, record=other))
    with pytest.raises(ConfigError, match="kind poor"):
        read_record(other, Campaign(1, 1, "mix"))
    with pytest.raises(ConfigError, match="world home"):
        read_record(other, Campaign(1, 1, "poor", world="second"))
    foreign = tmp_path / "foreign.jsonl"
    foreign.write_text('{"schema": "something"}\n')
    with pytest.raises(ConfigError, match="not a record"):
        read_record(foreign, Campaign(1, 1))
    foreign.write_text("a,b\n1,2\n")
    with pytest.raises(ConfigError, match="line 1"):
        read_record(foreign, Campaign(1, 1))
