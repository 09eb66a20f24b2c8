"""The matrix of vehicles, winds, sensors and routes: a small form of it, and the whole."""

from __future__ import annotations

import pytest
from evidence import matrix


@pytest.mark.long
def test_a_pelican_and_a_hexacopter_take_off_fly_and_land_in_wind() -> None:
    found = matrix.run(full=False)
    assert (found["flights"], found["possible"]) == (4, 4)
    assert found["failed"] == []


@pytest.mark.nightly
def test_every_flight_that_is_called_possible_is_completed() -> None:
    found = matrix.run(full=True)
    assert found["possible"] > 0.7 * found["flights"]
    assert found["failed"] == []
