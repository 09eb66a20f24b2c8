"""The small form of the study of the 3-D page (``make evidence view``)."""

from __future__ import annotations

import pytest
from evidence import view as study

pytestmark = pytest.mark.long


def test_browsers_come_and_go_while_vehicles_fly() -> None:
    """Numbers of a busy machine mean nothing; that they are there, and of what kind, does."""
    count, seconds = study.SMALL
    found = study.run(full=False)
    assert found["vehicles"] == count
    assert found["simulated_s"] == pytest.approx(seconds)
    # At the speed of the wall clock, but for what it takes to begin.
    assert found["wall_s"] > 0.8 * seconds
    assert 0 < found["frames_drawn"] <= 31.0 * found["wall_s"] + 5
    assert found["fetched_megabytes_per_second"] > 0.0
    # The browser that returned got vehicles, their places and their attitudes.
    assert found["whole_scene_after_return_s"] > 0.0
    slower = found["slowdown"]
    assert slower["factor_lowest"] <= slower["factor"] <= slower["factor_highest"]
    assert slower["with_two_percent_least"] <= slower["with_two_percent"] <= slower["with_two_percent_most"]
    assert slower["with_one_frames_per_second"] > 0.0
