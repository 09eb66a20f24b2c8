"""The study of the tasks in its small form."""

from __future__ import annotations

import evidence.tasks as study
import numpy as np
import pytest
from evidence.__main__ import plain


@pytest.mark.long
def test_the_small_form_scores_all_policies() -> None:
    """Ten seconds are too short to find anybody: every step costs 1/10, unless a person lies at the start."""
    results = plain(study.run(full=False))
    assert results["seeds"] == 3
    for kind in ("baseline", "idle", "random", "oracle"):
        found = results["search_and_rescue_2A"][kind]
        assert found["low"] <= found["mean"] <= found["high"]
        assert found["flown_to_the_end"] == 1.0
        assert -1.001 <= found["median"] <= 10.0
        assert 0.0 <= found["persons_found"] <= 10.0


def test_persons_are_counted_from_returns() -> None:
    """Of 200 steps each without a find costs 1/200; one in which two are found is worth 2. A crash does not count."""
    returns = np.array([-1.0, 1.0 - 199 / 200, 2.0 - 198 / 200, 2.0 - 199 / 200, -1000.3])
    flies = np.array([True, True, True, True, False])
    assert study.persons(returns + 3e-8, flies, 200) == (0 + 1 + 2 + 2) / 4
    assert study.persons(returns, np.zeros(5, bool), 200) == 0.0
