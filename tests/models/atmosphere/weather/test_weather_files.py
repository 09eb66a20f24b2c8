"""Readers of weather models against a wind that is linear in place, height and time, and what is wrong with files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tests.weather_files as files

from qrsim.errors import UsageError
from qrsim.models.atmosphere.weather.grib import grib_values
from qrsim.models.atmosphere.weather.netcdf import netcdf_values
from qrsim.models.atmosphere.weather.soundings import Site, Soundings, read_weather, soundings_of
from qrsim.models.atmosphere.weather.values import Key, Request, Values, corners_of

START = files.BEGIN.timestamp()
# Between the points of the grid, in the first hour and a half.
LATITUDE, LONGITUDE = 51.7119, -0.21052
REQUEST = Request(LATITUDE, LONGITUDE, START + 600.0, START + 5000.0, None)
SITE = Site(30.0, "sea", 0.05)


def read(path: Path, request: Request = REQUEST, site: Site = SITE) -> Soundings:
    """As ``read_weather``, without a process of its own."""
    reader = grib_values if path.suffix == ".grib2" else netcdf_values
    return soundings_of("FILE", reader("FILE", str(path), request), request, site)


def check(found: Soundings, levels: list[tuple[str, float, float]], tolerance: float) -> None:
    """Check the first levels: name, height above the ground, and number of level in the field."""
    assert found.times == (START, START + 3600.0, START + 7200.0)
    for hour, own in enumerate(found.levels):
        for level, (name, height, number) in zip(own, levels, strict=False):
            assert level.name == name
            assert level.height == pytest.approx(height, abs=0.05)
            assert level.east == pytest.approx(files.u_of(hour, number, LATITUDE, LONGITUDE), abs=tolerance)
            assert level.north == pytest.approx(files.v_of(hour, number, LATITUDE, LONGITUDE), abs=tolerance)


PRESSURE_LEVELS = [("1000 hPa", 80.0, 0.0), ("975 hPa", 300.0, 1.0), ("950 hPa", 520.0, 2.0), ("900 hPa", 960.0, 3.0)]


def test_era5_of_both_layouts(tmp_path: Path) -> None:
    """A packed number is half a step off, the field's range over 65 000."""
    new, old = files.era5(tmp_path / "new.nc"), files.era5(tmp_path / "old.nc", "old")
    assert max(new.stat().st_size, old.stat().st_size) < 30_000
    check(read(new), PRESSURE_LEVELS, 2e-6)
    check(read(old), PRESSURE_LEVELS, 2e-4)
    assert len(read(new).levels[0]) == len(read(old).levels[0]) == 6


def test_single_levels_and_their_gusts(tmp_path: Path) -> None:
    found = read(files.single_levels(tmp_path / "single.nc"))
    check(found, [("10 m", 10.0, 10.0 * 0), ("100 m", 100.0, 1.0)], 1e-9)
    assert found.gust == 11.5
    assert found.source == "FILE, from 2026-05-01 09:00 to 11:00 UTC"


def test_grib_of_a_regular_grid(tmp_path: Path) -> None:
    """24 bits over a range of 20 m/s are 1e-6 m/s. A wind at 10 m is the lowest level."""
    path = files.grib(tmp_path / "g.grib2")
    assert path.stat().st_size < 30_000
    check(read(path), [("10 m", 10.0, -0.5), *PRESSURE_LEVELS], 1e-5)


def test_winds_at_a_height_in_edition_1(tmp_path: Path) -> None:
    """ERA5 has them on the surface: parameters 165 and 166 of table 128, and 228246 and 228247."""
    import eccodes

    with open(tmp_path / "e.grib2", "wb") as file:
        for hour in (9, 11):
            for parameter, speed in ((165, 1.0), (166, 2.0), (228246, 3.0), (228247, 4.0)):
                handle = eccodes.codes_grib_new_from_samples("regular_ll_sfc_grib1")
                for key, value in {"dataDate": 20260501, "dataTime": 100 * hour, "paramId": parameter}.items():
                    eccodes.codes_set(handle, key, value)
                count = eccodes.codes_get_size(handle, "values")
                eccodes.codes_set_values(handle, np.full(count, speed))
                eccodes.codes_write(handle, file)
                eccodes.codes_release(handle)
    (first, _) = read(tmp_path / "e.grib2", REQUEST._replace(latitude_deg=40.0, longitude_deg=10.0)).levels
    assert [(level.name, level.east, level.north) for level in first] == [("10 m", 1.0, 2.0), ("100 m", 3.0, 4.0)]


def test_a_newer_forecast_of_the_same_time_counts(tmp_path: Path) -> None:
    """That of 08:00 has other winds for the same times."""
    old = files.grib(tmp_path / "old.grib2", dataTime=800)
    new = files.grib(tmp_path / "g.grib2")
    both = tmp_path / "both.grib2"
    both.write_bytes(new.read_bytes() + old.read_bytes())
    check(read(both), [("10 m", 10.0, -0.5)], 1e-5)


def lambert(path: Path, latitude: float, longitude: float, middle: float, parallels: tuple[float, float]) -> Path:
    """A grid of 8 x 5 points 4 km apart from a place on, with 10 m/s along its columns; u is the column's number."""
    import eccodes

    with open(path, "wb") as file:
        for hour in files.HOURS:
            for name, values in (("10u", np.tile(np.arange(8.0), 5)), ("10v", np.full(40, 10.0))):
                handle = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib2")
                settings = {
                    "gridType": "lambert", "Nx": 8, "Ny": 5, "DxInMetres": 4000, "DyInMetres": 4000,
                    "LaDInDegrees": parallels[0], "LoVInDegrees": middle % 360.0, "Latin1InDegrees": parallels[0],
                    "Latin2InDegrees": parallels[1], "latitudeOfFirstGridPointInDegrees": latitude,
                    "longitudeOfFirstGridPointInDegrees": longitude % 360.0, "jScansPositively": 1,
                    "uvRelativeToGrid": 1, "dataDate": 20260501, "dataTime": 900, "stepRange": hour,
                    "typeOfLevel": "heightAboveGround", "level": 10, "shortName": name, "bitsPerValue": 24,
                }  # fmt: skip
                for key, value in settings.items():
                    eccodes.codes_set(handle, key, value)
                eccodes.codes_set_values(handle, values)
                eccodes.codes_write(handle, file)
                eccodes.codes_release(handle)
    return path


@pytest.mark.parametrize(
    ("grid", "place", "east", "turn"),
    [
        # Of HRRR: the site is 13 689.33 m along the rows, where true north is turned by 4.824488 degrees.
        ((39.9, -105.4, -97.5, (38.5, 38.5)), (40.0, -105.25), 13_689.33, -4.824488),
        ((51.9, 9.9, 5.0, (30.0, 60.0)), (52.0, 10.0), 5_979.36, 3.577834),
    ],
)
def test_lambert_is_turned_to_true_north(
    tmp_path: Path, grid: Any, place: tuple[float, float], east: float, turn: float
) -> None:
    """Places and convergence of meridians are those of PROJ 9 (pyproj 3.7.2, lcc of a sphere of 6 371 229 m)."""
    path = lambert(tmp_path / "l.grib2", *grid)
    found = read(path, REQUEST._replace(latitude_deg=place[0], longitude_deg=place[1]))
    assert found.cell == 4000.0
    (level, *_), *_ = found.levels
    assert math.hypot(level.north, level.east) == pytest.approx(math.hypot(east / 4000.0, 10.0), abs=2e-4)
    own = math.degrees(math.atan2(level.east, level.north)) - math.degrees(math.atan2(east / 4000.0, 10.0))
    assert own == pytest.approx(turn, abs=0.01)


def test_a_grid_round_the_earth_is_closed() -> None:
    longitudes = np.arange(0.0, 360.0, 0.25)
    found = corners_of("FILE", np.array([90.0, 0.0, -90.0]), longitudes, 45.0, -0.1)
    assert found.columns == (1439, 0)
    assert found.rows == (0, 1)
    assert (found.down, found.along) == pytest.approx((0.5, 0.6))
    west = corners_of("FILE", np.array([0.0, 1.0]), np.array([10.0, 9.0, 8.0]), 0.25, 8.25)
    assert (west.columns, west.along, west.down) == ((1, 2), 0.75, 0.25)


def values(**more: float) -> Values:
    """Two levels of 1000 and 900 hPa, 5 m/s to the east."""
    found = {Key(name, START, "hPa", level): 5.0 for name in "uv" for level in (1000.0, 900.0)}
    named = {"height": "height", "t": "t"}
    for name, value in more.items():
        kind, _, level = name.partition("_")
        where = ("hPa", float(level)) if level.isdigit() else ("ground" if level == "ground" else "sea", 0.0)
        found[Key(named.get(kind, "pressure"), START, *where)] = value
    return Values([START], found)


def heights_of(found: Values, site: Site = SITE) -> tuple[list[float], tuple[str, ...]]:
    made = soundings_of("FILE", found, REQUEST, site)
    return [level.height for level in made.levels[0]], made.notes


def test_heights_without_geopotentials() -> None:
    """ISO 2533 has 900 hPa at 988.5 m and 1000 hPa at 110.8 m; a layer at 0 deg C from 1000 to 900 hPa is 842.4 m."""
    heights, notes = heights_of(values())
    assert heights == pytest.approx([110.8 - 30.0, 988.5 - 30.0], abs=0.2)
    assert notes == ("FILE: has neither heights (z, gh) nor temperatures of its levels of pressure; their heights are "
                     "those of the standard atmosphere, to about 30 m",)  # fmt: skip
    heights, notes = heights_of(values(t_1000=273.15, t_900=273.15, pressure_sea=100_000.0), Site(-1.0, "sea", 0.05))
    assert heights == pytest.approx([1.0, 843.4], abs=0.1)
    assert notes == ()


def test_heights_above_the_models_ground() -> None:
    """Its surface, or where its pressure is: half way in ln p from 1000 to 900 hPa, at sqrt(1000 * 900) = 948.683."""
    known = {"height_1000": 100.0, "height_900": 1000.0}
    assert heights_of(values(**known, height_ground=90.0), Site(30.0, "model", 0.05))[0] == [10.0, 910.0]
    heights, _ = heights_of(values(**known, pressure_ground=94_868.33), Site(30.0, "model", 0.05))
    assert heights == pytest.approx([450.0], abs=0.01)
    _, notes = heights_of(values(**known, height_ground=90.0))
    assert notes == (
        "FILE: the model's ground is 90 m above the sea at the site, the site 30 m; above: model takes heights above "
        "the model's ground",
    )
    with pytest.raises(UsageError, match="FILE: has neither the height of the model's ground"):
        heights_of(values(**known), Site(30.0, "model", 0.05))
    with pytest.raises(UsageError, match="FILE: has no level above the ground at the site, 1200 m above the sea"):
        heights_of(values(**known), Site(1200.0, "sea", 0.05))


@pytest.mark.parametrize(
    ("write", "request_", "words"),
    [
        (
            lambda path: files.era5(path),
            REQUEST._replace(start=START + 3 * 3600.0, end=START + 3 * 3600.0 + 600.0),
            "FILE: from 2026-05-01 09:00 to 11:00 UTC; the run is from 2026-05-01 12:00 to 12:10 UTC",
        ),
        (lambda path: files.era5(path, drop=["v"]), REQUEST, "FILE: has u, but no v"),
        (
            lambda path: files.era5(path, units={"u": "knots"}),
            REQUEST,
            "FILE: 'u' has the units 'knots'; expected 'm s-1'",
        ),
        (
            lambda path: files.era5(path),
            REQUEST._replace(latitude_deg=48.0),
            "FILE: covers latitude 51.5 to 52.5 and longitude -1 to 0.75; the site is at latitude 48, longitude "
            "-0.21052",
        ),
        (
            lambda path: files.era5(path),
            REQUEST._replace(latitude_deg=-0.21052, longitude_deg=51.71),
            "FILE: covers latitude 51.5 to 52.5 and longitude -1 to 0.75; the site is at latitude -0.21052, longitude "
            "51.71; are its latitude and longitude swapped?",
        ),
        (lambda path: files.era5(path), REQUEST._replace(member=3), "FILE: has no ensemble, and member is 3"),
    ],
)
def test_a_netcdf_file_that_cannot_be_used(tmp_path: Path, write: Any, request_: Request, words: str) -> None:
    with pytest.raises(UsageError) as error:
        read(write(tmp_path / "w.nc"), request_)
    assert str(error.value) == words


def test_a_grib_file_that_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "w.grib2"
    later = REQUEST._replace(start=START + 600.0, end=START + 3 * 3600.0)
    with pytest.raises(UsageError, match=r"FILE: at 2026-05-01 09:00 UTC; the run is .*join it with the next"):
        read(files.grib(path, [0]), later)
    with pytest.raises(UsageError, match="FILE: has no member 2; it has 0"):
        read(path, REQUEST._replace(member=2))
    with pytest.raises(UsageError, match="FILE: has a rotated grid; take the regular-lat-lon files"):
        read(files.grib(path, gridType="rotated_ll"))


def test_files_are_read_in_a_child(tmp_path: Path) -> None:
    """Its result is that of the reader; neither a text nor a damaged file is a traceback."""
    path = files.single_levels(tmp_path / "single.nc")
    assert read_weather(str(path), REQUEST, SITE).levels == read(path).levels
    (tmp_path / "text").write_text("height,speed,direction\n10,3,4\n")
    with pytest.raises(UsageError, match="text: is neither NetCDF nor GRIB; a table of heights and speeds is of type"):
        read_weather(str(tmp_path / "text"), REQUEST, SITE)
    (tmp_path / "cut.grib2").write_bytes(files.grib(tmp_path / "g.grib2", [0]).read_bytes()[:500])
    with pytest.raises(UsageError, match=r"cut\.grib2: cannot be read: "):
        read_weather(str(tmp_path / "cut.grib2"), REQUEST, SITE)
