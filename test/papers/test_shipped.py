"""What is said of the shipped settings is read from the files."""

import pytest

from hd_control.papers import shipped


def test_the_shipped_gains_are_those_of_the_tables():
    assert shipped.differing_numbers() == {}


def test_every_departure_is_named_with_its_reason():
    found = shipped.departures()
    assert len(found) == 6
    for words in ("compliance_derivative stiffness_only, the paper literal", "rate_source error_filter",
                  "adapt_compliance false, the paper true", "adaptation_scale 0.1, the paper 1"):  # fmt: skip
        assert sum(words in text for text in found) == 1, words
    assert shipped.START_WHY in found and shipped.LOAD_WHY in found


@pytest.mark.parametrize(
    ("name", "value", "words"), [("torque_gain", [9.0] * 7, "torque_gain"), ("rate_source", "plain", "")]
)
def test_changed_files_change_the_list(name, value, words, monkeypatch):
    real = shipped.shipped_values

    def changed(node):
        values = dict(real(node))
        return values | ({name: value} if name in values else {})

    monkeypatch.setattr(shipped, "shipped_values", changed)
    if words:
        assert shipped.differing_numbers() == {words: 7} and words in shipped.departures()[0]
    else:
        assert not any("rate_source" in text for text in shipped.departures())
