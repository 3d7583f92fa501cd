"""Worlds side by side and real-like rows, against counts made by hand; seeds and the log of looks at them."""

import json

import pytest

from hd_control.core.errors import ConfigError
from hd_sim.puzzles.seeds import log_look, purposes, read_looks
from hd_sim.puzzles.tables import COVERED, COVERED_SAME, headline, headline_text, interval, spoilt_rows, worse_world


def record(world, category, named=(), hidden=(), step="", unknown=None, **score):
    effects = [{"name": name, "confidence": 0.9} for name in named]
    right = list(named) == list(hidden)
    plain = {
        "verdict": "missing" if named else "adequate",
        "wrong": [n for n in named if n not in hidden],
        "missed": [n for n in hidden if n not in named],
        "tolerated": [],
        "top_1": (bool(named) and named[0] in hidden) if hidden else None,
        "exact": right,
        "false_alarm": bool(named) if category == "none" else None,
        "confident_wrong": any(n not in hidden for n in named),
        "refused": False,
        "unknown_flagged": bool(unknown),
        "unknown_variable": unknown == "right" if category == "unknown" else None,
        "parameters": [],
    }
    answer = {"effects": effects}
    return {
        "world": world, "category": category, "names": list(hidden), "step": step, "answer": answer,
        "score": {**plain, **score}, "same_law": ["payload"], "features": {},
    }  # fmt: skip


def inside(effect, covered):
    return {"effect": effect, "name": "x", "relative_error": 0.1, "covered": covered}


RECORDS = [
    record("home", "none"),
    record("home", "none"),
    record("second", "none"),
    record("second", "none", ["backlash"]),
    record("home", "one", ["payload"], ["payload"], "weak", parameters=[inside("payload", True)]),
    record("second", "one", ["payload"], ["payload"], "faint", parameters=[inside("payload", True)]),
    record("second", "one", ["backlash", "payload"], ["payload"], "clear", parameters=[inside("payload", False)]),
    record("second", "one", ["backlash"], ["backlash"], "clear", parameters=[inside("backlash", False)]),
    record("second", "two", ["payload"], ["payload", "backlash"]),
    record("home", "two", ["payload", "backlash"], ["payload", "backlash"]),
    record("second", "unknown", unknown="right"),
    record("second", "unknown", unknown="wrong"),
    record("second", "unknown"),
    record("second", "poor", ["backlash"]),
]


def test_each_figure_of_each_world_and_the_worse_one():
    table = {entry["name"]: entry for entry in headline(RECORDS)}

    def counts(name, world):
        row = table[name]["worlds"][world]
        return row["hits"], row["count"]

    expected = {
        "nothing missing: false alarm": ((0, 2), (1, 2), "second"),
        "one effect: right first": ((1, 1), (2, 3), "second"),
        "one effect: exact set": ((1, 1), (2, 3), "second"),
        "two effects: both named": ((1, 1), (0, 1), "second"),
        "two effects: exact set": ((1, 1), (0, 1), "second"),
        COVERED: ((1, 1), (1, 3), "second"),
        COVERED_SAME: ((1, 1), (1, 2), "second"),
        "one effect, barely visible: right first": ((1, 1), (1, 1), "home"),
    }
    for name, (home, second, worse) in expected.items():
        assert (counts(name, "home"), counts(name, "second"), table[name]["worse"]) == (home, second, worse), name
    assert counts("unknown: flagged", "second") == (2, 3) and counts("unknown: right variable", "second") == (1, 3)
    assert counts("poor recording: wrong confident claim", "second") == (1, 1)
    assert counts("one effect, clear: right first", "second") == (1, 2)
    assert table["unknown: flagged"]["worlds"]["home"]["count"] == 0 and table["unknown: flagged"]["worse"] == "second"
    low, high = interval(2, 3)
    row = table["one effect: right first"]["worlds"]["second"]
    assert (row["low"], row["high"]) == (low, high)


def test_the_calibration_error_by_hand():
    """Second world: 0.9 said seven times among good recordings, right four times."""
    table = {entry["name"]: entry for entry in headline(RECORDS)}
    row = table["calibration error of the confidence"]["worlds"]["second"]
    assert row["count"] == 6 and row["value"] == pytest.approx(abs(0.9 - 4 / 6))


def test_less_is_better_for_some():
    rows = {entry["name"]: entry for entry in headline(RECORDS)}
    assert rows["poor recording: wrong confident claim"]["worse"] == "second"
    assert worse_world("one effect: right first", {}) is None
    lines = headline_text(RECORDS).splitlines()
    assert lines[0] == "| figure | home | second | worse | target |" and len(lines) == 2 + len(rows)
    assert "1/2 = 50.0 % (1–99)" in lines[2] and lines[2].endswith("| second | ≤ 0.02 |")


def test_false_names_by_what_was_spoilt():
    def one(torque, named=(), category="none"):
        spoilt = {"torque": torque, "angle": "plain", "rate": 100, "signals": "all"}
        return record("real_like", category, named) | {"features": spoilt}

    records = [one("white", ["backlash"]), one("white"), one("averaged"), one("averaged", ["payload"], "one")]
    rows = {row.name: (row.hits, row.count) for row in spoilt_rows(records)}
    assert rows["perfect model: false names"] == (1, 3) and rows["all: false names"] == (2, 4)
    assert rows["perfect model, torque white: false names"] == (1, 2)
    assert rows["perfect model, torque averaged: false names"] == (0, 1)


def test_seeds_have_their_purpose():
    assert purposes(5, 10) == ("development",) and purposes(99_999, 2) == ("development", "calibration")
    assert purposes(900_000, 1) == ("test",) and purposes(2_000_000, 5) == ()


def test_nobody_looks_at_test_seeds_twice(tmp_path):
    log = tmp_path / "looks.jsonl"
    log_look(log, 900_000, 100, "both", "mix", "1.0")
    log_look(log, 900_100, 100, "both", "mix", "1.0")
    with pytest.raises(ConfigError, match="seeds 900000 to 900099 were looked at"):
        log_look(log, 900_050, 10, "second", "mix", "1.0")
    log_look(log, 900_100, 100, "both", "mix", "1.0", again=True)
    assert [look["seed"] for look in read_looks(log)] == [900_000, 900_100]
    assert json.loads(log.read_text().splitlines()[0])["world"] == "both"
    log.write_text("nonsense\n")
    with pytest.raises(ConfigError, match="not a log"):
        read_looks(log)
