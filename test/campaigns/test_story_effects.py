"""The story of the project on every effect that the quick lane leaves out: named, added, and the error falls."""

from __future__ import annotations

import pytest
from results import write_result
from test_story import KNOWN, QUICK, test_the_missing_effect_is_named_added_and_the_error_falls

GOALS = ("STORY",)

story = test_the_missing_effect_is_named_added_and_the_error_falls
del test_the_missing_effect_is_named_added_and_the_error_falls  # is collected where it is defined


def test_every_effect_left_out_by_the_quick_lane():
    effects, failing = sorted(set(KNOWN) - set(QUICK)), []
    for effect in effects:
        try:
            story(effect)
        except AssertionError as error:
            failing.append(f"{effect}: {error}")
    words = f"{len(effects) - len(failing)} of {len(effects)} effects named, added, held-out error at the noise"
    write_result("STORY", words, not failing, effects=effects)
    if failing:
        pytest.fail("\n".join(failing))
