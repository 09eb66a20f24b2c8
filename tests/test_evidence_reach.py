"""The small form of the study of the speed that was asked (``make evidence reach``)."""

from __future__ import annotations

import pytest
from evidence import reach
from evidence.__main__ import plain


@pytest.mark.long
def test_a_recorded_flight_takes_longer_than_its_ticks() -> None:
    found = plain(reach.run(full=False))["recording"]
    assert list(found) == ["outdoor_patrol"]
    assert found["outdoor_patrol"]["ratio"] > 1.0


def test_each_number_is_that_of_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {
        "outdoor": [
            {"stage": "whole", "worlds": 512, "ns": 250.0}, {"stage": "without filter", "worlds": 512, "ns": 100.0},
            {"stage": "whole", "worlds": 1, "tick_us": 2.05, "ns": 410.0},
        ],
        "throughput": [{"worlds": 512, "per_cpu_second": 7.4e6}, {"worlds": 1, "per_cpu_second": 1e6}],
        "bound": [
            {"program": "bound.cc", "threads": 1, "of_bound_cpu": 0.9},
            {"program": "qrsim", "threads": 2, "of_bound_cpu": 0.6},
            {"program": "qrsim, filter alone", "threads": 2, "of_bound_cpu": 0.5},
        ],
        "one_world": [
            {"worlds": 1, "vehicles": 4096, "threads": 1, "over_many_worlds": 0.4},
            {"worlds": 1, "vehicles": 4096, "threads": 2, "over_many_worlds": 0.8},
            {"worlds": 512, "vehicles": 8, "threads": 2, "over_many_worlds": 1.0},
        ],
    }  # fmt: skip
    monkeypatch.setattr(reach, "printed", lambda name, *words: rows[name])
    batches = reach.batches()
    measured = {"outdoor_patrol": 4e6, "one_world": 2.05, "rotors": 7.4e6}
    assert batches == {name: {"measured": value} for name, value in measured.items()}
    assert reach.bounds() == {"published": {"ratio": 0.6}, "filter": {"ratio": 0.5}}
    assert reach.large_worlds() == {"vehicles_4096": {"ratio": 0.8}}
