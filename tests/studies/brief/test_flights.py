"""From an operation to its scenario: terrain, buildings, keep-outs and the wind of a table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from tests.studies.brief.plans import HOME, RETURN, TAKE_OFF, WAYPOINT, item, place, write_plan

from qrsim.studies.brief.faults import fault_scenario, fault_study
from qrsim.studies.brief.fleets import fleets_of
from qrsim.studies.brief.flights import flights_of
from qrsim.studies.brief.operation import MissionSpec, read_operation
from qrsim.studies.brief.studying import varied

RETURNS = {"type": "SimpleItem", "command": RETURN, "frame": 2, "params": [0] * 7, "autoContinue": True}


def write_square(file: Path, north: float, east: float, properties: dict[str, object]) -> None:
    """Write a square of 40 m as GeoJSON."""
    corners = [(0, 0), (0, 40), (40, 40), (40, 0), (0, 0)]
    ring = [list(reversed(place(north + a, east + b))) for a, b in corners]
    feature = {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))


def write_flat(file: Path, height: float) -> None:
    """Write terrain of one height around home, as a grid in latitude and longitude."""
    head = f"ncols 81\nnrows 81\nxllcenter {HOME[1] - 0.004}\nyllcenter {HOME[0] - 0.004}\ncellsize 0.0001\n"
    file.write_text(head + "\n".join(" ".join([f"{height}"] * 81) for _ in range(81)) + "\n")
    write_projection(file)


def write_projection(file: Path) -> None:
    """Write the projection of a grid in latitude and longitude next to it."""
    file.with_suffix(".prj").write_text(
        'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
    )


@pytest.mark.long
def test_terrain_buildings_keep_outs_and_a_table_of_the_wind(tmp_path: Path) -> None:
    write_plan(tmp_path / "a.plan")
    write_square(tmp_path / "school.geojson", -40.0, -45.0, {"name": "school"})
    write_square(tmp_path / "barn.geojson", -20.0, 45.0, {"building": "yes", "height": 8})
    write_flat(tmp_path / "field.asc", 90.0)
    rows = ["time,height,speed,direction", "2026-05-01T09:00Z,10,3,200", "2026-05-01T11:00Z,10,5,200"]
    (tmp_path / "wind.csv").write_text("\n".join(rows) + "\n")
    operation = {
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": "a.plan", "vehicle": "x500"}],
        "wind": {"file": "wind.csv"},
        "site": {"terrain": ["field.asc"], "buildings": "barn.geojson", "keep_out": ["school.geojson"]},
        "contingency": {"gnss_lost": {"after": 3}},
    }
    (tmp_path / "field.yaml").write_text(yaml.safe_dump(operation))
    read = read_operation(tmp_path / "field.yaml", {})
    flights = flights_of(read)
    world = flights.scenario.spec.world
    assert (world.area.type, world.ground.type, len(world.obstacles)) == ("zones", "dem", 1)
    # In the middle of two hours, and from where the table says.
    assert flights.wind.speed == pytest.approx(4.0)
    assert flights.wind.from_deg == pytest.approx(200.0)
    assert flights.content["world"]["wind"]["type"] == "profile"
    assert not any(path.startswith("world.wind") for path in varied(read, flights))
    assert flights.content["fleets"]["a"]["failsafes"]["EKF2_NOAID_TOUT"] == 3e6


def test_missions_with_the_same_vehicle_share_a_fleet(tmp_path: Path) -> None:
    for name, north in (("a", 0.0), ("b", 10.0), ("c", 20.0)):
        home = (*place(north, 0.0), 90.0)
        items = [item(TAKE_OFF, 0, 0, 12), item(WAYPOINT, 25.0 + north, 0, 12), *([RETURNS] if name != "b" else [])]
        write_plan(tmp_path / f"{name}.plan", items, home=home)
    operation = {
        "at": "2026-05-01T10:00Z",
        "missions": [
            {"plan": "a.plan", "vehicle": "x500"},
            {"plan": "b.plan", "vehicle": "x500", "battery": {"capacity": 4.0}},
            {"plan": "c.plan", "vehicle": "x500", "delay": 7.0},
        ],
        "wind": {"speed": 4, "from": 250},
        "uncertain": {"drag": 0.0},
        "faults": ["motor", "low_battery"],
    }
    (tmp_path / "field.yaml").write_text(yaml.safe_dump(operation))
    read = read_operation(tmp_path / "field.yaml", {})
    flights = flights_of(read)
    # a and c are alike; b has another pack.
    assert flights.names == ("a", "c", "b")
    assert [mission.delay for mission in flights.missions] == [0.0, 7.0, 0.0]
    fleets = flights.content["fleets"]
    assert {name: [each["name"] for each in fleet["vehicles"]] for name, fleet in fleets.items()} == {
        "x500": ["a", "c"],
        "b": ["b"],
    }
    assert fleets["x500"]["vehicles"][1]["legs"][0] == {**fleets["x500"]["vehicles"][1]["legs"][0], "time": 7.0}
    assert fleets["x500"]["battery"]["capacity"] == [5.0, 5.0]
    assert fleets["b"]["battery"]["capacity"] == 4.0
    assert [path for path in varied(read, flights) if "capacity" in path or "mass" in path] == [
        "fleets.x500.battery.capacity.0",
        "fleets.x500.vehicle.mass.0",
        "fleets.x500.battery.capacity.1",
        "fleets.x500.vehicle.mass.1",
        "fleets.b.battery.capacity",
        "fleets.b.vehicle.mass",
    ]
    # b does not return, so its path is shorter than the padding of the table of its legs would make it.
    assert flights.planned_s[2] < flights.planned_s[0] < flights.planned_s[1] - 7.0
    # Each vehicle has its own time of a fault, at a share of its own mission.
    scenario = fault_scenario(read, flights)
    assert [(each["type"], each.get("vehicles")) for each in scenario["fleets"]["x500"]["faults"]] == [
        ("rotor", ["a"]),
        ("battery", ["a"]),
        ("rotor", ["c"]),
        ("battery", ["c"]),
    ]
    assert [(each["type"], each.get("vehicles")) for each in scenario["fleets"]["b"]["faults"]] == [
        ("rotor", None),
        ("battery", None),
    ]
    planned, finished = max(flights.planned_s), 100.0
    settings = fault_study(read, flights, finished, 0)["vary"]["fault"]["conditions"]["low_battery_50"]
    assert settings == {
        "fleets.x500.faults.1.at": pytest.approx(50.0 * flights.planned_s[0] / planned, abs=0.051),
        "fleets.x500.faults.3.at": pytest.approx(50.0),
        "fleets.b.faults.1.at": pytest.approx(50.0 * flights.planned_s[2] / planned, abs=0.051),
    }


def test_names_and_sizes_of_fleets() -> None:
    x500 = MissionSpec.model_validate({"plan": "a.plan", "vehicle": "x500"})
    own = x500.model_copy(update={"vehicle": "there/my own.yaml"})
    # A fleet of several has the name of the vehicle, unless a mission that flies alone has it.
    found = fleets_of([x500, own, x500, own, x500.model_copy(update={"battery": {"cells": 6}})], [*"abcd", "x500"])
    assert [(fleet.name, fleet.missions) for fleet in found] == [
        ("x500_1", (0, 2)), ("my_own", (1, 3)), ("x500", (4,)),
    ]  # fmt: skip
    # 100 faults, four of each vehicle, are the most that a scenario lets a fleet have.
    assert [len(fleet.missions) for fleet in fleets_of([x500] * 60, [f"v{i}" for i in range(60)])] == [25, 25, 10]
