"""Vehicles in rows instead of a list of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError
from qrsim.links.reference.tasks import MOST_VEHICLES
from qrsim.scenarios.in_rows import count_of
from qrsim.scenarios.scenario import load_scenario
from qrsim.scenarios.schema import json_schema


def loaded(vehicles: Any) -> Any:
    """Return the scenario of a fleet with such vehicles."""
    content = {
        "name": "rows",
        "fleets": {"team": {"controller": {"type": "cascade", "feed": "truth"}, "vehicles": vehicles}},
    }
    return load_scenario(content, quiet=True)


def test_rows_begin_in_the_south_west_and_lie_about_the_middle() -> None:
    """Five in rows of two, 4 m apart, about (10, 20): three rows, of which the last has one."""
    rows = {"count": 5, "columns": 2, "spacing": 4.0, "position_ned": [10.0, 20.0, -7.0], "yaw_deg": 90.0}
    found = loaded({**rows, "waypoints_ned": [[110.0, 20.0, -9.0]]}).spec.fleets["team"].vehicles
    assert [vehicle.position_ned for vehicle in found] == [
        [6.0, 18.0, -7.0],
        [6.0, 22.0, -7.0],
        [10.0, 18.0, -7.0],
        [10.0, 22.0, -7.0],
        [14.0, 18.0, -7.0],
    ]
    assert found[0].waypoints_ned == [[106.0, 18.0, -9.0]]
    assert found[4].waypoints_ned == [[114.0, 18.0, -9.0]]
    assert [vehicle.yaw_rad for vehicle in found] == pytest.approx([1.5707963] * 5)


def test_each_flies_the_legs_shifted_as_its_start_is() -> None:
    """Two, 10 m apart to the east: places are shifted, heights and the place that both look at are not."""
    legs: list[Any] = [
        {"type": "take_off", "height": 10},
        {"to_ned": [50, 0, -10], "facing_ned": [30, 30], "hold": 2},
        {"type": "loiter", "time": 3},
        {"type": "land", "at_ned": [5, 7]},
    ]
    rows = {"count": 2, "spacing": 10.0, "position_ned": [0, 0, 0], "on_ground": True, "legs": legs}
    content = {
        "name": "rows",
        "fleets": {
            "team": {
                "ground": "parked",
                "guidance": {"type": "mission"},
                "controller": {"type": "cascade", "feed": "truth"},
                "vehicles": rows,
            }
        },
    }
    first, second = load_scenario(content, quiet=True).spec.fleets["team"].vehicles
    for vehicle, east in ((first, -5.0), (second, 5.0)):
        found = [leg.model_dump(exclude_unset=True) for leg in vehicle.legs]
        assert found == [
            {"type": "take_off", "height": 10.0},
            {"type": "fly", "to_ned": [50.0, east, -10.0], "facing_ned": [30.0, 30.0], "hold": 2.0},
            {"type": "loiter", "time": 3.0},
            {"type": "land", "at_ned": [5.0, 7.0 + east]},
        ]


def test_without_columns_the_whole_is_nearly_square() -> None:
    """Seven make rows of three, and one alone is in the middle."""
    found = loaded({"count": 7, "position_ned": [0.0, 0.0, -7.0]}).spec.fleets["team"].vehicles
    assert len({vehicle.position_ned[1] for vehicle in found}) == 3
    (alone,) = loaded({"count": 1, "position_ned": [1.0, 2.0, -7.0]}).spec.fleets["team"].vehicles
    assert alone.position_ned == [1.0, 2.0, -7.0]


def test_they_hold_their_places() -> None:
    """Each holds the place in which it starts."""
    simulation = qrsim.Simulation(loaded({"count": 4, "spacing": 6.0, "position_ned": [0, 0, -7]}).world(), seed=1)
    simulation.reset()
    for _ in range(250):
        simulation.step()
    place = np.asarray(simulation.state.fleets[0].vehicle.position_ned.stack())
    assert place[:, :2] == pytest.approx(np.array([[-3, -3], [-3, 3], [3, -3], [3, 3]], float), abs=0.2)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ({"count": 3, "spacng": 2.0, "position_ned": [0, 0, -7]}, "spacng: no such parameter.*did you mean 'spacing'"),
        ({"count": 0, "position_ned": [0, 0, -7]}, "count: 0 is out of range; allowed: 1 to 10 000"),
        ({"count": 2.5, "position_ned": [0, 0, -7]}, "count: 2.5 is not a whole number"),
        ({"count": 3, "position_ned": [0, -7]}, "position_ned: expected 3 numbers, found 2"),
        ({"spacing": 3.0, "position_ned": [0, 0, -7]}, "count: missing"),
        ({"count": 3, "spacing": -1.0, "position_ned": [0, 0, -7]}, "spacing: -1.0 is out of range"),
        ({"count": 3, "name": "x", "position_ned": [0, 0, -7]}, "name: no such parameter"),
        (
            {"count": 3, "position_ned": [0, 0, -7], "waypoints_ned": [[1, 2, -3]], "legs": [{"to_ned": [1, 2, -3]}]},
            "gives both 'waypoints_ned' and 'legs'; give one",
        ),
        (
            {
                "count": 3,
                "position_ned": [0, 0, -7],
                "legs": [
                    {"to_geodetic": {"latitude_deg": 1, "longitude_deg": 2, "height": 3}},
                ],
            },
            "legs.0.to_geodetic: rows are shifted in metres; give to_ned",
        ),
        ({"count": 3, "position_ned": [0, 0, -7], "legs": [{"type": "lnd"}]}, "legs.0.type: .* did you mean 'land'"),
        ({}, "expected a list, or rows with a count; found keys and values without one"),
        ({"position_ned": [0, 0, -7]}, "expected a list, or rows with a count; found keys and values without one"),
        ({"cout": 3, "spacing": 2.0, "position_ned": [0, 0, -7]}, "did you mean 'count'"),
    ],
)
def test_wrong_rows_say_what_and_where(rows: dict[str, Any], message: str) -> None:
    """One line, with the fleet's name."""
    with pytest.raises(ScenarioError, match=f"fleets.team.vehicles: .*{message}"):
        loaded(rows)


def test_the_json_schema_has_both_forms() -> None:
    """A list of vehicles as before, or rows with a count."""
    known = json_schema()["$defs"]
    listed, other = known["FleetSpec"]["properties"]["vehicles"]["anyOf"]
    assert other == {"$ref": "#/$defs/RowsSpec"}
    rows = known["RowsSpec"]
    assert (listed["type"], listed["minItems"]) == ("array", 1)
    assert rows["required"] == ["count", "position_ned"]
    assert "yaw_deg" in rows["properties"]


def test_what_a_client_may_ask_for_is_counted() -> None:
    """A count is as many vehicles, however few words it takes."""
    assert count_of({"count": MOST_VEHICLES + 1}) == MOST_VEHICLES + 1
    assert count_of([{}, {}]) == 2
    assert count_of({"count": True}) == count_of("x") == count_of({}) == 0
