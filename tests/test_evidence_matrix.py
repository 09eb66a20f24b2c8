"""The matrix of vehicles, winds, sensors and routes: a small form of it, and the whole."""

from __future__ import annotations

import pytest
from evidence import matrix
from evidence.__main__ import plain


@pytest.mark.long
def test_a_pelican_and_a_hexacopter_take_off_fly_and_land_in_wind() -> None:
    found = plain(matrix.run(full=False))
    assert {name: found["all"][name] for name in ("flights", "possible", "completed")} == dict.fromkeys(
        ("flights", "possible", "completed"), 4
    )
    assert list(found["by_vehicle"]) == ["pelican_cascade", "hexa4_cascade"]
    # A receiver of 2 m and more would show.
    assert 0.1 < found["by_vehicle"]["hexa4_cascade"]["wind_6"]["noisy_m"] < 2.0


@pytest.mark.nightly
def test_every_flight_that_is_called_possible_is_completed() -> None:
    rows = matrix.rows_of(full=True)
    assert matrix.failed(rows) == []
    assert sum(row["possible"] for row in rows) > 0.7 * len(rows)
