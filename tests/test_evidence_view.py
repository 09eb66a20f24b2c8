"""The small form of the study of the 3-D page (``make evidence view``)."""

from __future__ import annotations

import pytest
from evidence import view as study

from qrsim.view.browser import INSTALL, find_browser

pytestmark = pytest.mark.long


def test_browsers_come_and_go_while_vehicles_fly() -> None:
    """Numbers of a busy machine mean nothing; that they are there, and of what kind, does."""
    count, seconds = study.SMALL
    found = study.run(full=False, parts=("minute",))
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


def test_few_and_many_vehicles_and_a_slow_link() -> None:
    found = study.run(full=False, parts=("reach",))["reach"]["vehicles_2"]
    assert 0.0 < found["frames_per_second"] <= 31.0 + 5.0 / study.SMALL_REACH[1]
    # A vehicle is 28 bytes of each of 30 frames.
    assert 2 * 28 * 5e-6 < found["megabytes_per_second_each"] < 0.5
    assert 0.0 < found["slow_link_oldest_frame_s"] < 10.0


def test_memory_is_looked_at_twice() -> None:
    found = study.run(full=False, parts=("hours",))["hours"]
    count, seconds, speed = study.SMALL_HOURS
    assert (found["vehicles"], found["simulated_s"], found["speed"]) == (count, seconds, speed)
    # Of this process, whatever other tests have left in it.
    assert 100.0 < found["memory_after_a_third_megabytes"] < 50_000.0
    growth = 100.0 * (found["memory_at_end_megabytes"] / found["memory_after_a_third_megabytes"] - 1.0)
    assert found["memory_growth_percent"] == pytest.approx(growth, abs=0.01)


def test_exports_are_measured() -> None:
    found = study.run(full=False, parts=("export",))["export"]
    for page in (found["short"], found["vehicles_2"]):
        assert page["processor_s"] > 0.5
        assert 100.0 < page["peak_megabytes"] < 3000.0
        # viser's own page is 0.82 MB of it.
        assert 0.82 < page["page_megabytes"] < 3.0
    assert found["vehicles_2"]["page_megabytes"] > found["short"]["page_megabytes"]


@pytest.mark.nightly
@pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}")
def test_a_browser_opens_scrubs_and_looks_for_long() -> None:
    found = study.run(full=False, parts=("browser",))["browser"]
    opening, scrubbing, many, hour = (found[name] for name in ("opening", "scrubbing", "many", "hour"))
    assert 0.0 < opening["names_what_it_loads_s"] <= opening["whole_s"]
    assert 0.0 < opening["page_processor_until_it_names_s"] <= opening["page_processor_s"]
    # Not for each vehicle a call: twenty take as many as a thousand, some 14.
    assert (scrubbing["vehicles"], many["vehicles"]) == (4, 20)
    assert 2.0 < scrubbing["draw_calls_a_frame"] < 30.0
    assert 2.0 < many["draw_calls_a_frame"] < 30.0
    assert 20 * 100 < many["triangles_a_frame"] < 20 * 2000
    assert many["frames_per_second"] > 0.0
    # Paths have a largest length, which they reach after 100 s. Nothing else is kept.
    assert hour["heap_at_end_megabytes"] - hour["heap_after_a_sixth_megabytes"] < 3.0
    assert (scrubbing["errors"], many["errors"], hour["errors"]) == (0, 0, 0)
