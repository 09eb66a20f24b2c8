"""Writes the files of an invented place in the formats of map services, ground stations and weather services.

    python examples/real_place/make_files.py [FOLDER]

Needs ``pip install 'qrsim[terrain,weather]'``. The default folder is that of this script.
"""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import rasterio
from rasterio.transform import from_origin
from rasterio.warp import transform

# Where the vehicle takes off: latitude, longitude [deg], altitude above mean sea level [m].
HOME = (46.6, 10.2, 1480.0)
WGS84, UTM = "EPSG:4326", "EPSG:32632"
# East and north of home [m].
LOCAL = f"+proj=aeqd +datum=WGS84 +lat_0={HOME[0]} +lon_0={HOME[1]}"
CELL, SIZE = 20.0, 251
WAYPOINT, RETURN, TAKE_OFF, SPEED = 16, 20, 22, 178
ABOVE_HOME, NO_PLACE, ABOVE_GROUND = 3, 2, 10

# Places [m]: north and east of home.
FENCE = [(-120, -240), (-120, 260), (400, 300), (400, -240)]
RALLY = (-60, 60)
SURVEY = [(0, -160), (0, 40), (40, 40), (40, -160), (80, -160), (80, 40)]
OVER_THE_KNOLL = [(180, 80), (300, 80), (340, -40), (200, -120)]
STAY_OUT = {
    "Chapel": [(110, -130), (110, -100), (150, -100), (150, -130)],
    "Cable car": [(-120, 190), (400, 165), (400, 185), (-120, 210)],
}
FARM = [(250, -220), (250, -180), (310, -180), (310, -220)]
BUILDINGS = {
    "barn": (9, [(-70, -20), (-70, 10), (-55, 10), (-55, -20)]),
    "inn": (14, [(-30, -95), (-30, -80), (-15, -80), (-15, -95)]),
}

# Of a weather model: pressure [hPa], height above mean sea level [m], speed [m/s] and bearing of the wind [deg].
LEVELS = [(850, 1500, 3.0, 215), (825, 1745, 6.0, 235), (800, 2000, 8.0, 250), (750, 2535, 11.0, 265)]
HOURS = [datetime(2026, 5, 1, hour, tzinfo=UTC).timestamp() for hour in (9, 10, 11, 12)]


def height(north: Any, east: Any) -> Any:
    """Return the height of the ground [m] above mean sea level: a valley that rises to the east, and a knoll."""
    along, across = 0.5 * north + 0.866 * east, 0.866 * north - 0.5 * east
    sides = 420.0 * (1.0 - np.exp(-((across / 700.0) ** 2)))
    knoll = 35.0 * np.exp(-((north - 280.0) ** 2 + (east - 40.0) ** 2) / (2.0 * 60.0**2))
    return HOME[2] + 0.02 * along + sides + knoll


def geodetic(places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return latitude and longitude [deg] of places [m]."""
    longitudes, latitudes = transform(LOCAL, WGS84, [east for _, east in places], [north for north, _ in places])
    return [(round(a, 8), round(o, 8)) for a, o in zip(latitudes, longitudes, strict=True)]


def ring(places: list[tuple[float, float]]) -> list[list[float]]:
    """Return longitude and latitude [deg] of corners, the first one again at the end."""
    return [[longitude, latitude] for latitude, longitude in geodetic([*places, places[0]])]


def write_terrain(path: Path) -> None:
    """Write a GeoTIFF in UTM, 5 km wide, in tenths of a metre."""
    (east,), (north,) = transform(WGS84, UTM, [HOME[1]], [HOME[0]])
    half = 0.5 * SIZE * CELL
    corner = from_origin(round(east - half), round(north + half), CELL, CELL)
    middles = CELL * (np.arange(SIZE) + 0.5)
    x, y = np.meshgrid(corner.c + middles, corner.f - middles)
    easts, norths = transform(UTM, LOCAL, x.ravel(), y.ravel())
    tenths = np.round(10.0 * height(np.array(norths), np.array(easts))).astype(np.int16).reshape(SIZE, SIZE)
    with rasterio.open(
        path, "w", driver="GTiff", width=SIZE, height=SIZE, count=1, dtype="int16", crs=UTM, transform=corner,
        nodata=-32768, compress="deflate", predictor=2,
    ) as file:  # fmt: skip
        file.scales = (0.1,)
        file.write(tenths, 1)


def item(
    command: int, frame: int = NO_PLACE, place: tuple[float, float] | None = None, z: float = 0.0, **first: float
) -> dict[str, Any]:
    """Return an item of a plan."""
    latitude, longitude = geodetic([place])[0] if place else (0.0, 0.0)
    params = [first.get(f"param{i}", 0.0) for i in (1, 2, 3, 4)]
    return {
        "type": "SimpleItem", "command": command, "frame": frame, "autoContinue": True,
        "params": [*params[:3], None if place else params[3], latitude, longitude, z],
    }  # fmt: skip


def write_plan(path: Path) -> None:
    """Write a plan of QGroundControl: a survey of the floor, and four legs 40 m above the ground."""
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "version": 5,
        "polygon": geodetic([SURVEY[0], SURVEY[1], SURVEY[5], SURVEY[4]]),
        "TransectStyleComplexItem": {
            "version": 2,
            "Items": [item(WAYPOINT, ABOVE_HOME, place, 60.0) for place in SURVEY],
        },
    }
    items = [
        item(TAKE_OFF, ABOVE_HOME, (0, 0), 30.0),
        item(SPEED, param1=1, param2=7, param3=-1),
        survey,
        *(item(WAYPOINT, ABOVE_GROUND, place, 40.0) for place in OVER_THE_KNOLL),
        item(RETURN),
    ]
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 15, "hoverSpeed": 5,
            "plannedHomePosition": list(HOME), "items": items,
        },
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [{"version": 1, "inclusion": True, "polygon": geodetic(FENCE)}],
        },
        "rallyPoints": {"version": 2, "points": [[*geodetic([RALLY])[0], 45.0]]},
    }  # fmt: skip
    path.write_text(json.dumps(plan, indent=1))


def write_keepouts(path: Path) -> None:
    """Write a KML file, as Google Earth saves it."""
    marks = [
        f"<Placemark><name>{name}</name><Polygon><outerBoundaryIs><LinearRing><coordinates>"
        + " ".join(f"{longitude},{latitude},0" for longitude, latitude in ring(corners))
        + "</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark>"
        for name, corners in STAY_OUT.items()
    ]
    path.write_text(f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{"".join(marks)}</Document></kml>')


def write_geojson(path: Path, features: list[tuple[dict[str, Any], list[tuple[float, float]]]]) -> None:
    """Write polygons with their properties."""
    found = [
        {"type": "Feature", "properties": own, "geometry": {"type": "Polygon", "coordinates": [ring(corners)]}}
        for own, corners in features
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": found}, indent=1))


def write_forecast(path: Path) -> None:
    """Write winds on pressure levels in the layout of ERA5; they grow by 0.5 m/s in an hour."""
    axes = {
        "valid_time": (np.array(HOURS, np.int64), "seconds since 1970-01-01"),
        "pressure_level": (np.array([level[0] for level in LEVELS], float), "hPa"),
        "latitude": (np.array([47.0, 46.75, 46.5, 46.25]), "degrees_north"),
        "longitude": (np.array([9.75, 10.0, 10.25, 10.5]), "degrees_east"),
    }
    _, heights, speeds, bearings = (
        np.array(column, float)[None, :, None, None] for column in zip(*LEVELS, strict=True)
    )
    speeds = speeds + 0.5 * np.arange(len(HOURS))[:, None, None, None]
    angle = np.radians(bearings)
    with netCDF4.Dataset(path, "w") as file:
        for name, (values, units) in axes.items():
            file.createDimension(name, len(values))
            file.createVariable(name, values.dtype, (name,))[:] = values
            file[name].units = units
        for name, values, units in (
            ("u", -speeds * np.sin(angle), "m s**-1"),
            ("v", -speeds * np.cos(angle), "m s**-1"),
            ("z", 9.80665 * heights, "m**2 s**-2"),
        ):
            whole = np.broadcast_to(values, [len(each) for each, _ in axes.values()])
            file.createVariable(name, "f4", tuple(axes), zlib=True)[:] = whole
            file[name].units = units


def main(folder: Path) -> None:
    """Write all files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_terrain(folder / "terrain.tif")
    write_plan(folder / "valley.plan")
    write_keepouts(folder / "keepouts.kml")
    write_geojson(folder / "farm.geojson", [({"name": "Alp Sura"}, FARM)])
    buildings = [
        ({"building": "yes", "name": name, "height": roof}, corners) for name, (roof, corners) in BUILDINGS.items()
    ]
    write_geojson(folder / "buildings.geojson", buildings)
    write_forecast(folder / "forecast.nc")
    for path in sorted(folder.iterdir()):
        if path.suffix in (".tif", ".plan", ".kml", ".geojson", ".nc"):
            print(f"{path} ({path.stat().st_size} bytes)")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
