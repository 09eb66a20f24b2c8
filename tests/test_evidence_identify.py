"""The small form of the study of identification (``make evidence identify``)."""

from __future__ import annotations

import numpy as np
import pytest
from evidence import identify as study


def test_vehicles_that_are_drawn_can_hover() -> None:
    values, _ = study.draw_vehicles(20, np.random.default_rng(study.SEED))
    for i in range(20):
        throttle = study.hover_throttle({name: float(column[i]) for name, column in values.items()})
        assert throttle is not None
        assert study.HOVER[0] <= throttle <= study.HOVER[1]


@pytest.mark.long
def test_a_simulated_vehicle_is_identified() -> None:
    """One short flight in wind: the roll and pitch constants to 3 %."""
    found = study.round_trip(1, 16.0)
    for name in ("kpq0", "kpq1", "kpq2"):
        assert found["constants"][name]["rms_error_percent"] < 3.0, name
    assert found["delay_rms_error_ms"] < 2.0
