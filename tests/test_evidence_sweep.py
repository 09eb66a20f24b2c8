"""The small form of the study of sweeps (``make evidence sweep``), and what the full form must have found.

What it does to processes is in tests/studies/sweep/test_workers.py.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from evidence import sweep as study

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "sweep.json"


@pytest.mark.nightly
def test_the_small_form_measures_what_the_full_form_does() -> None:
    found = study.run(full=False)
    assert found["throughput"]["episodes"] == 60
    assert found["throughput"]["vehicle_steps"] == 60 * 50
    assert found["throughput"]["ratio"] > 0.0
    # The numbers of all episodes would take 6 MB.
    assert found["million"]["planned"] == 2**18
    assert found["million"]["more_bytes"] < 60e6


def test_the_full_form_shows_what_is_asked_for() -> None:
    if not REPORT.is_file():
        pytest.skip("docs/evidence/sweep.json is not recorded yet: make evidence sweep")
    results: dict[str, Any] = json.loads(REPORT.read_text(encoding="utf-8"))["results"]
    assert results["throughput"]["episodes"] == 10_000
    assert results["throughput"]["episode_s"] == pytest.approx(60.0)
    assert results["throughput"]["ratio"] >= 0.7
    assert set(results["sameness"]["same"].values()) == {1}
    assert results["million"]["planned"] >= 10**6
    assert results["million"]["more_bytes"] < 200e6
