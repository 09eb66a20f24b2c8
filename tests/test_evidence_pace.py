"""The study of shared worlds in its small form: every order was flown, and from the tick after the next one at most."""

from __future__ import annotations

import pytest
from evidence import pace
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form():
    found = plain(pace.run(full=False))["two"]
    assert found["controllers"] == 2
    # A second of ticks of 0.02 s, and what comes before the first client has seen one.
    assert 40 <= found["ticks"] <= 300
    # Who orders at once when a tick is out has its order flown at the end of the next one.
    assert 5.0 < found["latency_median_ms"] < 100.0
    assert found["missed"] == 0
