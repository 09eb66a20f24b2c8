"""The small form of the study of range-only SLAM (``make evidence slam``), and what the full form must have found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from evidence import slam as study

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
