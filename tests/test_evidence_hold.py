"""The small form of the study of holding in wind (``make evidence hold``)."""

from __future__ import annotations

import numpy as np
import pytest
from evidence import hold as study


def test_distance_from_a_square() -> None:
    """On a side, inside next to one, beyond a corner."""
    places = np.array([[20.0, 0.0], [20.0, 39.0], [43.0, 44.0], [-2.0, 20.0], [20.0, 20.0]])
    assert study.from_square(places) == pytest.approx([0.0, 1.0, 5.0, 2.0, 20.0])


@pytest.mark.long
def test_a_cascade_holds_in_eight_metres_per_second() -> None:
    """On the truth within 0.35 m, a square of 40 m within 2.5 m; on noisy sensors within 1.2 of the GNSS error."""
    found = study.run(False)["winds"]["8"]
    assert all(row["stopped"] == 0 for row in found.values())
    assert found["cascade"]["horizontal_m"] < 0.35
    assert found["cascade"]["height_m"] < 0.2
    assert found["cascade_square"]["from_square_m"] < 2.5
    assert found["cascade_square"]["reached_least"] >= 3
    filtered = found["cascade_filter"]
    assert filtered["horizontal_m"] < 1.2 * filtered["gnss_m"]
    # It leans into a wind of 9.9 m/s: g tan(26.6 deg)/0.497.
    assert found["cascade"]["tilt_mean_deg"] == pytest.approx(27.0, abs=2.0)
