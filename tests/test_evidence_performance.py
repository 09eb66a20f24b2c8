"""The study of speed in its small form: it runs, and what it says has the kinds that the documentation quotes."""

from __future__ import annotations

import pytest
from evidence import performance
from evidence.__main__ import plain


@pytest.mark.long
def test_small_form():
    found = plain(performance.run(full=False))
    for stages in found["throughput"].values():
        assert all(numbers["per_cpu_second"] > 0 for numbers in stages.values())
    memory = found["memory"]
    # A world of five vehicles: ten thousand ticks allocate nothing that stays.
    assert memory["after_bytes"] - memory["before_bytes"] < 20e6
    assert 400 < memory["state_bytes_per_vehicle"] < 4000
