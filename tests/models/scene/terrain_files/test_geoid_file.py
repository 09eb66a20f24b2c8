"""Geoids from files: rasters of GDAL and grids of GeographicLib, in heights near a site and in scenarios."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import ScenarioError, UsageError
from qrsim.models.geoid import GeoidPlane, above_sea, undulation
from qrsim.models.scene.terrain_files.geoid_file import geoid_of_file
from qrsim.models.site import Site
from qrsim.scenarios.derived import heights_line
from qrsim.scenarios.scenario import Scenario, load_scenario

LATITUDE, LONGITUDE = 51.7119, -0.21052
SITE = Site.from_degrees(LATITUDE, LONGITUDE)
# Metres of a degree of latitude, and of longitude at the site, on the ellipsoid.
NORTH_M, EAST_M = 111_258.0, 69_110.0
HEAD = b"P5\n# Geoid\n# Offset -108\n# Scale 0.003\n360 181\n65535\n"


def geotiff(path: Path, values: Callable[[Any, Any], Any] = undulation, west: float = -1.0, **options: Any) -> str:
    """Write heights every 0.1 degrees, over 2 by 2 degrees around 51.5 degrees north."""
    import rasterio

    latitude, longitude = 52.45 - 0.1 * np.arange(20), west + 0.05 + 0.1 * np.arange(20)
    place = rasterio.Affine(0.1, 0.0, west, 0.0, -0.1, 52.5)
    profile = {"width": 20, "height": 20, "count": 1, "dtype": "float32", "crs": "EPSG:4979", "transform": place}
    with rasterio.open(path, "w", "GTiff", **{**profile, **options}) as file:
        file.write(np.array(values(latitude[:, None], longitude[None, :]), "float32"), 1)
    return str(path)


def pgm(path: Path, head: bytes = HEAD, missing: int = 0) -> str:
    """Write 40 m + 10 m sin(3 latitude) + 5 m cos(2 longitude) at whole degrees; numbers are to 3 mm."""
    latitude, longitude = np.radians(90.0 - np.arange(181))[:, None], np.radians(np.arange(360.0))[None, :]
    heights = 40.0 + 10.0 * np.sin(3.0 * latitude) + 5.0 * np.cos(2.0 * longitude)
    numbers = np.round((heights + 108.0) / 0.003).astype(">u2").tobytes()
    path.write_bytes(head + numbers[: len(numbers) - missing])
    return str(path)


def test_a_raster_of_the_built_in_geoid_is_that_geoid(tmp_path: Path) -> None:
    found, own = geoid_of_file(geotiff(tmp_path / "a.tif"), SITE), GeoidPlane.at(SITE)
    assert found.height == pytest.approx(own.height, abs=0.01)
    assert found.slope_north == pytest.approx(own.slope_north, abs=4e-6)
    assert found.slope_east == pytest.approx(own.slope_east, abs=4e-6)
    higher = geoid_of_file(geotiff(tmp_path / "b.tif", lambda a, b: undulation(a, b) + 0.5), SITE)
    assert higher.height - found.height == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("longitude", [LONGITUDE, 0.0, 100.3, 179.999, -179.999])
def test_a_grid_of_geographiclib(tmp_path: Path, longitude: float) -> None:
    found = geoid_of_file(pgm(tmp_path / "a.pgm"), Site.from_degrees(LATITUDE, longitude))
    latitude, east = np.radians(LATITUDE), np.radians(longitude)
    assert found.height == pytest.approx(40.0 + 10.0 * np.sin(3.0 * latitude) + 5.0 * np.cos(2.0 * east), abs=0.002)
    per_degree = np.radians(1.0)
    assert found.slope_north == pytest.approx(30.0 * np.cos(3.0 * latitude) * per_degree / NORTH_M, abs=3e-7)
    assert found.slope_east == pytest.approx(-10.0 * np.sin(2.0 * east) * per_degree / EAST_M, abs=3e-7)


def test_places_near_a_site_with_a_geoid() -> None:
    site = Site.from_degrees(LATITUDE, LONGITUDE, 100.0, (45.0, 1e-4, -2e-4))
    north, east = 1000.0, 2000.0
    place = np.array([LATITUDE + north / NORTH_M, LONGITUDE + east / EAST_M, 120.0])
    assert above_sea(place, site)[2] == pytest.approx(120.0 - 45.0 - 0.1 + 0.4, abs=0.001)
    assert above_sea(place, SITE)[2] == pytest.approx(120.0 - undulation(place[0], place[1]), abs=1e-9)


def load(geoid: Any, **site: Any) -> Scenario:
    place = {"latitude_deg": LATITUDE, "longitude_deg": LONGITUDE, "geoid": geoid, **site}
    return load_scenario({"extends": "hover_ideal", "name": "geoid", "site": place})


def test_a_site_with_a_geoid(tmp_path: Path) -> None:
    file = pgm(tmp_path / "own.pgm")
    scenario = load(file, height_amsl=100.0)
    level = 40.0 + 10.0 * np.sin(3.0 * np.radians(LATITUDE)) + 5.0 * np.cos(2.0 * np.radians(LONGITUDE))
    assert scenario.spec.site.height == pytest.approx(100.0 + level, abs=0.003)
    assert GeoidPlane.at(scenario.site).height == pytest.approx(level, abs=0.003)
    assert "100.00 m above mean sea level; undulation of the geoid (own.pgm): 49.2" in heights_line(scenario)
    saved = tmp_path / "saved.yaml"
    saved.write_text(scenario.to_yaml())
    Path(file).unlink()
    assert load_scenario(saved).spec == scenario.spec
    assert "file" not in saved.read_text()
    moved = load_scenario(saved, ["site.latitude_deg=51.8"]).spec.site
    assert moved.height == pytest.approx(100.0 + undulation(51.8, LONGITUDE), abs=0.001)
    assert load({"height": 46.0}, height=90.0).spec.site.undulation == 46.0


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.gtx", b"", "is no geoid; allowed: files that end in .tif, .tiff, .img, .pgm"),
        ("a.pgm", b"P6\n1 1\n255\n", "is no geoid of GeographicLib: expected P5, '# Offset', '# Scale' and 65535"),
        ("a.pgm", b"P5\n# Offset x\n# Scale 1\n2 2\n65535\n", "is no geoid of GeographicLib"),
        ("a.pgm", HEAD, "has 0 bytes of heights; 360 x 181 of them have 130320"),
        ("a.pgm", HEAD.replace(b"360 181", b"0 0"), "has 0 x 0 heights; expected at least 2 x 2"),
        ("gone.pgm", None, "gone.pgm: cannot be read: No such file"),
    ],
)
def test_what_is_no_geoid(tmp_path: Path, name: str, content: bytes | None, words: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    (problem,) = caught.value.problems
    assert problem.startswith("site.geoid: ")
    assert words in problem


def test_rasters_that_have_no_geoid_there(tmp_path: Path) -> None:
    away = geotiff(tmp_path / "away.tif", west=5.0)
    with pytest.raises(UsageError, match=r"away\.tif: does not reach 2\.5 km beyond the site on all sides"):
        geoid_of_file(away, SITE)
    hills = geotiff(tmp_path / "hills.tif", lambda a, b: 300.0 + 0.0 * (a + b))
    with pytest.raises(UsageError, match=r"hills\.tif: has the height 300 m within 2\.5 km of the site; a geoid is"):
        geoid_of_file(hills, SITE)
    holes = geotiff(tmp_path / "holes.tif", lambda a, b: np.nan + a + b)
    with pytest.raises(UsageError, match=r"holes\.tif: has no height within 2\.5 km"):
        geoid_of_file(holes, SITE)


def test_what_a_geoid_may_give() -> None:
    with pytest.raises(ScenarioError, match="expected one of file and height"):
        load({"slope_north": 1e-5})
    with pytest.raises(ScenarioError, match="did you mean 'slope_north'"):
        load({"height": 46.0, "slope_nort": 1e-5})
