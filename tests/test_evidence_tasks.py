"""The study of the tasks in its small form."""

from __future__ import annotations

import evidence.tasks as study
import pytest
from evidence.__main__ import plain


@pytest.mark.long
def test_the_small_form_scores_all_policies() -> None:
    """Ten seconds are too short to find anybody: every step costs 1/10, unless a person lies at the start."""
    results = plain(study.run(full=False))
    assert results["seeds"] == 3
    for kind in ("baseline", "idle", "random"):
        found = results["search_and_rescue_2A"][kind]
        assert found["low"] <= found["mean"] <= found["high"]
        assert found["flown_to_the_end"] == 1.0
        assert -1.001 <= found["median"] <= 10.0
