"""From an operation to its scenario: terrain, buildings, keep-outs and the wind of a table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from tests.studies.brief.plans import HOME, place, write_plan

from qrsim.studies.brief.flights import flights_of
from qrsim.studies.brief.operation import read_operation
from qrsim.studies.brief.studying import varied


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
