"""The small forms of two studies of range-only SLAM, and what the full form must have found.

``make evidence slam`` and ``make evidence slam_consistency``, which compares errors with their covariances. They share
a process, because both solve the same problems by the same programs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import slam as study
from evidence import slam_consistency as consistency
from evidence.__main__ import plain

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "slam.json"


@pytest.fixture(scope="module")
def small() -> dict[str, Any]:
    return study.run(full=False)


@pytest.mark.nightly
def test_fixes_are_alike_in_size_and_differ_in_colour(small: dict[str, Any]) -> None:
    """Wider bounds than those of the full study, for a sixth of its flights and of their length."""
    white, coloured = (small["gnss"]["fixes"][noise] for noise in ("white", "coloured"))
    assert white["rms_m"] == pytest.approx(coloured["rms_m"], rel=0.1)
    assert white["allan"]["slope"] == pytest.approx(-0.5, abs=0.12)
    assert coloured["allan"]["low"] > 0.0


@pytest.mark.long
def test_with_gnss_factors_coloured_errors_are_larger(small: dict[str, Any]) -> None:
    """Every pair: Wilcoxon's two-sided p of eight pairs is then 0.008."""
    found = small["gnss"]["paired"]["plain"]["trajectory_m"]
    assert found["mean"] > 0.0
    assert found["p"] < 0.01


@pytest.mark.long
def test_the_published_graph_forgets_the_noise_once_it_has_converged(small: dict[str, Any]) -> None:
    """There the noises differ by less than a fifth of what they differ by with GNSS factors."""
    differences = {graph: small[graph]["paired"] for graph in ("paper", "gnss")}
    without, with_gnss = differences["paper"]["converged"], differences["gnss"]["plain"]
    assert abs(without["trajectory_m"]["mean"]) < 0.2 * with_gnss["trajectory_m"]["mean"]


def full() -> dict[str, Any]:
    """The recorded results of 50 seeds."""
    if not REPORT.is_file():
        pytest.skip("docs/evidence/slam.json is not recorded yet: make evidence slam")
    results: dict[str, Any] = json.loads(REPORT.read_text(encoding="utf-8"))["results"]
    assert results["gnss"]["seeds"] == study.FULL[0] == 50
    return results


def test_the_full_study_shows_the_loss_and_what_the_remedy_recovers() -> None:
    found = full()["gnss"]
    assert found["paired"]["plain"]["trajectory_m"]["low"] > 0.0
    assert found["paired"]["plain"]["trajectory_m"]["p"] < 0.01
    remedy = found["remedy"]["trajectory_m"]
    assert remedy["gain"]["p"] < 0.01
    assert 0.0 < remedy["recovered"]["low"] < remedy["recovered"]["part"] < remedy["recovered"]["high"] < 1.0


def test_the_full_study_shows_the_slopes() -> None:
    fixes = full()["gnss"]["fixes"]
    assert fixes["white"]["allan"]["slope"] == pytest.approx(-0.5, abs=0.05)
    assert fixes["coloured"]["allan"]["low"] > 0.0


def test_the_full_study_solved_an_hour_in_the_memory_that_is_stated() -> None:
    found = full()["resources"]
    assert found["flight_3600_s"]["states"] == 36001
    assert found["flight_3600_s"]["not_converged"] == 0
    for flight in (found[name] for name in found if name.startswith("flight_")):
        assert flight["bytes"] < flight["stated_bytes"]


def test_nees_is_the_squared_error_in_standard_deviations() -> None:
    """2 m at 4 m^2 and 3 m at 1 m^2: 1 + 9; 2 m twice at 1 m^2, correlated by a half: (4 + 4 - 4) / 0.75."""
    assert consistency.nees(np.array([2.0, 3.0]), np.diag([4.0, 1.0])) == pytest.approx(10.0)
    assert consistency.nees(np.array([2.0, 2.0]), np.array([[1.0, 0.5], [0.5, 1.0]])) == pytest.approx(16.0 / 3.0)


def test_the_band_of_fifty_seeds() -> None:
    """Chi-square of 100 degrees of freedom, 74.222 and 129.561 (tables), over 50."""
    assert consistency.band(50, 2) == pytest.approx((74.222 / 50, 129.561 / 50), rel=1e-5)


@pytest.mark.long
def test_coloured_errors_taken_for_white_make_it_too_sure_of_itself() -> None:
    """White inside its band; coloured above by far; as a state inside again."""
    found = consistency.run(full=False)
    # What a file of evidence can hold.
    assert plain(found, "") == found
    assert found["white"]["position"]["inside"]
    assert found["coloured"]["position"]["nees"] > 5.0 * found["coloured"]["position"]["band_high"]
    assert found["coloured"]["position"]["coverage"]["high"] < 0.95
    assert found["coloured_as_state"]["position"]["inside"]
