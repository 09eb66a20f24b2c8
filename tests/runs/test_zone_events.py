"""Breaches of zones in flight: reported, or the end, with the zone's name in events and numbers in metrics."""

from __future__ import annotations

from typing import Any

import pytest

import qrsim
from qrsim.apps.check.outcomes import outcomes
from qrsim.runs.recorder import fly
from qrsim.runs.summary import NOT_A_STOP

pytestmark = pytest.mark.long


def scenario(breach: str) -> qrsim.Scenario:
    """Two vehicles at 10 m: one flies north over a school 10 m wide, one out of the field and ten metres on."""
    field = {"name": "field", "polygon_ned": [[-60, -60], [-60, 60], [60, 60], [60, -60]]}
    school = {"name": "school", "circle_ned": [20, 0], "radius": 5, "ceiling": 30}
    content: dict[str, Any] = {
        "name": "zones",
        "duration": 14.0,
        "world": {
            "area": {
                "type": "zones", "breach": breach, "allow_crossing": True, "stay_in": [field], "stay_out": [school]
            }
        },
        "fleets": {
            "a": {
                "controller": {"type": "cascade", "feed": "truth"},
                "vehicles": [
                    {"position_ned": [0, 0, -10], "waypoints_ned": [[40, 0, -10]]},
                    {"position_ned": [0, 20, -10], "waypoints_ned": [[70, 20, -10]]},
                ],
            }
        },
    }  # fmt: skip
    return qrsim.load_scenario(content, quiet=True)


def events(breach: str, tmp_path: Any) -> list[Any]:
    fly(scenario(breach), tmp_path / "run", seed=0, precision="float32")
    return [event for event in qrsim.open_run(tmp_path / "run").events if event.kind != "waypoint_reached"]


def test_reported(tmp_path: Any) -> None:
    found = events("report", tmp_path)
    assert [(event.vehicle, event.kind, event.field) for event in found] == [
        ("a_0", "zone_entered", "school"),
        ("a_0", "zone_left", "school"),
        ("a_1", "zone_left", "field"),
    ]
    assert found[0].message.startswith("a_0: entered 'school', to stay out of, at ")
    # Within one tick of 0.02 s at 8 m/s at most.
    assert -0.16 < found[0].value <= 0.0 <= found[1].value < 0.16
    assert all(event.kind in NOT_A_STOP for event in found)
    flown = qrsim.rollout(scenario("report").world(), ticks=700)
    assert flown["breaches"].tolist() == [[1, 1]]
    assert not flown["reason"].any()
    counted = {outcome.name: outcome.runs for outcome in outcomes(flown)}
    assert (counted["is outside the zones"], counted["leaves the area"], counted["any of these"]) == (1, 0, 1)
    outside = flown["seconds_outside"][0]
    assert outside[0] == pytest.approx(found[1].time - found[0].time)
    assert outside[1] == pytest.approx(14.0 - found[2].time, abs=0.021)
    # In the middle of the school it is 5 m from its edge; the other overshoots a place ten metres outside.
    school, field = flown["fence_distance_min_m"][0]
    assert school == pytest.approx(-5.0, abs=0.1)
    assert -12.0 < field < -10.0


def test_the_end(tmp_path: Any) -> None:
    found = events("end", tmp_path)
    assert [(event.vehicle, event.kind, event.field) for event in found] == [
        ("a_0", "out_of_area", "fence"),
        ("a_1", "out_of_area", "fence"),
    ]
    assert found[0].message.endswith(" m ('school')")
    assert found[1].message.endswith(" m ('field')")
    assert -0.16 < found[0].value < 0.0
