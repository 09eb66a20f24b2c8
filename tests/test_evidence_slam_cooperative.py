"""What cooperation does to range-only SLAM: the small form of the study, and its statistics against literals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import slam_cooperative as study
from evidence.__main__ import plain

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "slam_cooperative.json"


class Fixes:
    """As much of a flight as its errors (F, 2)."""

    def __init__(self, errors: Any) -> None:
        self.fix_error = errors


def test_the_common_share_of_errors_that_are_sums() -> None:
    """Variance 9 that all of 3 vehicles have, and 1 of each: 0.9; within 4 standard errors of 4000 worlds."""
    generator = np.random.default_rng(1)
    common, own = 3.0 * generator.standard_normal((4000, 1, 1, 2)), generator.standard_normal((4000, 3, 1, 2))
    flown: Any = [[Fixes(errors) for errors in each] for each in common + own]
    assert study.common_share(flown) == pytest.approx(0.9, abs=0.02)
    flown = [[Fixes(errors) for errors in each] for each in own]
    assert study.common_share(flown) == pytest.approx(0.0, abs=0.03)


@pytest.mark.nightly
def test_cooperation_averages_what_each_vehicle_has_of_its_own_and_not_what_they_share() -> None:
    """White inside its band; a shared error as states of each is more certain the more fly, and no better."""
    found = study.run(full=False)
    # What a file of evidence can hold.
    assert plain(found, "") == found
    assert found["fixes"]["shared"]["common_share"] > 0.99
    assert abs(found["fixes"]["own"]["common_share"]) < 0.5
    assert found["white"]["vehicles_3"]["position"]["inside"]
    assert found["white"]["vehicles_1"]["position"]["inside"]
    own, shared = (found[name]["vehicles_3"] for name in ("own_as_own_states", "shared_as_own_states"))
    error = {name: found[name]["vehicles_1"]["trajectory_m"]["mean"] for name in ("own_as_own_states", "white")}
    assert own["trajectory_m"]["mean"] < 0.8 * error["own_as_own_states"]
    assert shared["trajectory_m"]["mean"] > 0.9 * error["own_as_own_states"]
    assert shared["position"]["nees"] > 1.5 * found["shared_as_own_states"]["vehicles_1"]["position"]["nees"]
    assert not shared["position"]["inside"]
    one = found["shared_as_one_state"]["vehicles_3"]
    assert one["position"]["inside"]
    assert one["relative_m"]["mean"] < shared["relative_m"]["mean"]


def test_the_full_study_shows_what_is_averaged_and_what_is_not() -> None:
    """Own errors gain by four more vehicles, shared ones by less than a quarter of that."""
    found = json.loads(REPORT.read_text(encoding="utf-8"))["results"]
    assert found["seeds"] == study.FULL.seeds == 50
    gain = {name: found[name]["vehicles_5"]["gain_m"] for name in study.CASES}
    assert gain["own_as_own_states"]["low"] > 0.0
    assert gain["own_as_own_states"]["p"] < 0.01
    for name in ("shared_as_white", "shared_as_own_states", "receiver_as_own_states"):
        assert gain[name]["mean"] < 0.25 * gain["own_as_own_states"]["mean"]
    assert found["white"]["vehicles_5"]["position"]["inside"]
    one = found["shared_as_one_state"]["vehicles_5"]["position"]
    assert one["nees"] < one["band_high"]
    sure = found["shared_as_own_states"]["vehicles_5"]["position"]
    assert sure["nees"] > sure["band_high"]
    assert found["fixes"]["receiver"]["common_share"] > 0.9
    assert 5.0 < found["fixes"]["receiver"]["own_time_constant_s"] < 30.0
    ones, twos = (found[f"receiver_as_common_and_own_{name}"]["vehicles_5"] for name in ("states", "memory"))
    assert twos["relative_position"]["nees"] < 0.1 * ones["relative_position"]["nees"]
    assert twos["relative_m"]["mean"] < 0.5 * ones["relative_m"]["mean"]
