"""GNSS of the day: dilution of a known geometry, and a street between high walls."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.brief.plans import write_plan

import qrsim
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.studies.brief.flights import flights_of
from qrsim.studies.brief.operation import checked
from qrsim.studies.brief.sky import NONE_PDOP, Sky, _dilution, places_along, sky_of, sky_row


def scenario(folder: Path, obstacles: list[dict[str, object]]) -> Scenario:
    plan = write_plan(folder / "a.plan", fence=[(-60.0, -60.0), (-60.0, 60.0), (80.0, 60.0), (80.0, -60.0)])
    content = {
        "operation": "field",
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": str(plan), "vehicle": "x500"}],
        "wind": {"speed": 4, "from": 250},
        "world": {"obstacles": obstacles},
    }
    return flights_of(checked(content, "field")).scenario


def at_rest(start: datetime, obstacles: list[dict[str, object]]) -> dict[str, Any]:
    """Return a scenario of one receiver that stays 1.5 m above the ground."""
    fleet = {
        "vehicle": {"type": "fixed_point"},
        "controller": {"type": "none"},
        "sensors": {"gnss": {"type": "gnss", "preset": "f9p_single"}},
        "vehicles": [{"position_ned": [0, 0, -1.5]}],
    }
    world = {"obstacles": obstacles}
    return {"name": "rest", "start_time": start.isoformat(), "world": world, "fleets": {"a": fleet}}


@pytest.mark.long
def test_the_table_is_what_a_receiver_at_rest_reports_over_a_day() -> None:
    """Satellites exactly, and PDOP within 1 %; the receiver is flown, and the table is geometry."""
    begin = datetime(2026, 5, 1, 10, tzinfo=UTC)
    sky = sky_of(load_scenario(at_rest(begin, [])))
    for row in range(0, 289, 24):
        simulation = qrsim.load(at_rest(begin + timedelta(minutes=5 * row), []), seed=1)
        simulation.reset()
        fix = simulation.step(ticks=50).gnss
        assert sky.count[row, 0] == fix.satellites[0]
        assert sky.pdop[row, 0] == pytest.approx(np.hypot(fix.hdop, fix.vdop)[0], rel=0.01)
        assert sky.hdop[row, 0] == pytest.approx(fix.hdop[0], rel=0.01)


@pytest.mark.long
def test_a_courtyard_that_leaves_4_satellites_is_a_no_go() -> None:
    """Walls of 30 m, 12 m away on all sides; the receiver of the test above tracks 4 satellites directly here."""
    sides = [(-17, 17, 12, 17), (-17, 17, -17, -12), (12, 17, -12, 12), (-17, -12, -12, 12)]
    walls: list[dict[str, object]] = [
        {"type": "box", "z_min": -30, "z_max": 0, "x_min": south, "x_max": north, "y_min": west, "y_max": east}
        for south, north, west, east in sides
    ]
    sky = sky_of(load_scenario(at_rest(datetime(2026, 5, 1, 10, tzinfo=UTC), walls)))
    assert sky.count[0, 0] == 4
    row = sky_row(sky, 300.0)
    assert row.verdict == "no-go"
    assert row.why.startswith("good (8 satellites or more, PDOP below 4) for 0 % of the time at the worst of 20 places")
    assert "(north 0, east 0, height 2 m)" in row.why


def test_dilution_of_one_satellite_above_and_three_on_the_horizon() -> None:
    angles = np.radians([0.0, 120.0, 240.0])
    sight = np.array([[0.0, 0.0, -1.0], *([np.cos(a), np.sin(a), 0.0] for a in angles)])[None]
    pdop, hdop = _dilution(sight, np.ones((1, 4), bool))
    # Horizontally 2/3 each; vertically 4/3, because height and clock share the satellite above.
    assert hdop[0] == pytest.approx(np.sqrt(4.0 / 3.0))
    assert pdop[0] == pytest.approx(np.sqrt(8.0 / 3.0))
    # Three satellites give no fix.
    assert _dilution(sight, np.array([[True, True, True, False]]))[0][0] == NONE_PDOP


@pytest.mark.long
def test_an_open_field_is_a_go_and_a_street_between_walls_is_not(tmp_path: Path) -> None:
    field = scenario(tmp_path, [])
    places = places_along(field)
    assert places.shape == (20, 3)
    # From home up to 12 m, 25 m north, and back.
    assert places[:, 0].max() == pytest.approx(25.0, abs=0.1)
    assert places[:, 2].min() == pytest.approx(-12.0)
    sky = sky_of(field)
    # A day by 5 minutes, and both ends.
    assert sky.count.shape == (289, 20)
    # GPS, Galileo, GLONASS and BeiDou have 24 satellites each here, of which about a third is above 10 degrees.
    assert 20 < sky.count.min() <= sky.count.max() < 48
    assert sky_row(sky, 300.0).verdict == "go"
    assert (sky.hdop <= sky.pdop).all()

    wall = {"type": "box", "x_min": -50.0, "x_max": 70.0, "z_min": -200.0, "z_max": 0.0}
    sides = [{**wall, "y_min": 5.0, "y_max": 10.0}, {**wall, "y_min": -10.0, "y_max": -5.0}]
    ends = [{**wall, "x_min": x, "x_max": x + 5.0, "y_min": -5.0, "y_max": 5.0} for x in (-15.0, 40.0)]
    street = sky_of(scenario(tmp_path, [*sides, *ends]))
    assert (street.count <= sky.count).all()
    row = sky_row(street, 300.0)
    assert row.verdict == "no-go"
    assert row.why.startswith("good (8 satellites or more, PDOP below 4) for 0 % of the time ")


def test_the_verdict_on_the_sky_is_that_of_the_flights() -> None:
    seconds, places = np.arange(0.0, 7200.0, 300.0), np.zeros((1, 3))
    late = (seconds > 3600.0)[:, None]
    sky = Sky(seconds, places, np.where(late, 4, 12), np.where(late, 9.0, 1.5), np.ones(late.shape))
    # Flights of half an hour, and half an hour after them.
    assert sky_row(sky, 1800.0).verdict == "go"
    assert sky_row(sky, 5400.0).verdict == "no-go"
