"""The study of MAVLink in its small form: no exception, and the honest flight is the same to the bit."""

from __future__ import annotations

import pytest
from evidence import mavlink
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form():
    found = plain(mavlink.run(full=False))["fuzz"]
    assert found["frames"] == 19_800
    assert found["exceptions"] == 0
    assert found["flights_that_differ"] == 0
    # It flies, 10 s after it was told to take off.
    assert found["last_height_m"] > 5.0
    assert found["growth_mb"] < 50.0
