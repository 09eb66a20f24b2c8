"""The small form of the study of receivers among buildings (``make evidence canyon``)."""

from __future__ import annotations

import pytest
from evidence import canyon as study


@pytest.mark.long
def test_streets_hide_satellites_and_move_fixes_by_metres() -> None:
    """Near the ground fixes are off by 5 to 10 m in the median, as models of cities give; over the roofs by nothing."""
    found = study.run(False)
    heights = found["heights"]["m8n"]
    direct = [row["direct"] / row["above_the_mask"] for row in heights.values()]
    assert direct == sorted(direct)
    assert 0.3 < direct[0] < 0.6
    assert direct[-1] > 0.95
    assert all(row["fix"] == 1.0 for row in heights.values())
    low, high = heights["h1_5m"], heights["h40m"]
    assert 3.0 < low["by_walls_r50_m"] < 12.0
    assert 10.0 < low["by_walls_r95_m"] < 40.0
    assert high["by_walls_r50_m"] < 0.1
    assert low["direct"] + low["reflected"] + low["blocked"] == pytest.approx(low["above_the_mask"])
    assert found["flight"]["flown_to_the_end"] == 1
    for receiver in ("gnss", "cheap"):
        flight = found["flight"][receiver]
        assert flight["fix"] == 1.0
        assert 0.5 < flight["street_r50_m"] < 20.0
        # The lags keep steps small, whatever comes and goes.
        assert flight["largest_step_m"] < 0.5
