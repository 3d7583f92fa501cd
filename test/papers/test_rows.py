"""A row's `met` follows from its numbers alone; seeds, table and document say what they hold."""

import math

import pytest

from hd_control.papers import rows as r
from hd_control.papers.rows import Row, over_seeds


def row(ours, target, **more):
    return Row("a.b", "zhu", "(1)", "rad", 4e-4, ours, target, "none", **more)


@pytest.mark.parametrize(
    ("ours", "target", "more", "met"),
    [
        (1.0, 1.0, {}, True),
        (1.1, 1.0, {}, False),
        (1.1, 1.0, {"better": "more"}, True),
        (0.9, 1.0, {"better": "more"}, False),
        (7.6, 7.0, {"better": "near", "tolerance": 0.7}, True),
        (6.2, 7.0, {"better": "near", "tolerance": 0.7}, False),
        (math.nan, 1.0, {}, False),
        (math.nan, 1.0, {"better": "near", "tolerance": 1.0}, False),
        (-math.inf, 1.0, {}, False),
        (1.0, None, {}, None),
        (0.5, 1.0, {"seeds": (0.5, 1.5)}, False),
        (0.5, 1.0, {"seeds": (0.5, 0.9)}, True),
    ],
)
def test_met_is_computed(ours, target, more, met):
    assert row(ours, target, **more).met is met


def test_met_cannot_be_given():
    with pytest.raises(TypeError):
        row(1.0, 1.0, met=True)
    with pytest.raises(AttributeError):
        row(1.0, 1.0).met = True


@pytest.mark.parametrize("more", [{"better": "lower"}, {"better": "near"}])
def test_a_rule_that_cannot_be_checked_is_refused(more):
    with pytest.raises(ValueError, match=r"a\.b"):
        row(1.0, 1.0, **more)


def test_worst_seed():
    assert over_seeds([3.0, 1.0, 2.0]) == (2.0, (2.0, 3.0))
    assert over_seeds([3.0, 1.0, 2.0], "more") == (2.0, (2.0, 1.0))
    assert over_seeds([7.1, 6.5, 7.2], "near", 7.0) == (7.1, (7.1, 6.5))
    assert math.isnan(over_seeds([1.0, math.nan])[1][1])
    with pytest.raises(ValueError, match="no values"):
        over_seeds([])


def test_document_has_the_fields_of_its_schema():
    found = r.document([row(1.0, 2.0, chosen=("J 40 kg m^2",), seeds=(1.0, 1.5))], 3)
    assert found["schema"] == "hd.reproduce/1" and found["seed"] == 3
    assert {"id", "paper", "equation", "unit", "paper_value", "ours", "target", "met", "conditions"} <= set(
        found["rows"][0]
    )
    assert found["rows"][0]["met"] is True and found["rows"][0]["seeds"] == {"median": 1.0, "worst": 1.5}
    with pytest.raises(ValueError, match="twice"):
        r.document([row(1.0, 2.0), row(1.0, 2.0)], 0)


def test_table_shows_what_is_missed_and_what_was_chosen():
    text = "\n".join(r.table([row(3e-4, 2e-4, chosen=("inertia 40 kg m^2",)), row(1e-4, None)]))
    assert "NO" in text and "<= 0.0002" in text and text.count("inertia 40 kg m^2") == 1


def test_papers_are_found_without_importing_them():
    assert set(r.available()) <= set(r.PAPERS)
    with pytest.raises(ValueError, match="there is"):
        r.load_paper("newton")
