"""Terrain files: one hill in every format, tiles, and missing heights."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.models.scene import terrain_maps
from tests.models.scene.terrain_maps import (
    BOX,
    EAST,
    LATITUDE,
    LONGITUDE,
    NORTH,
    SITE,
    down,
    geotiff,
    hgt,
    hill,
    utm_ascii,
    vrt,
)

from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.site import Site

pytest.importorskip("rasterio")


def expected(zero: float | None = None) -> Any:
    """Return the down coordinate of the hill there, by its formula; z = 0 is its height at the origin."""
    latitude, longitude, _ = SITE.ned_to_geodetic(np.stack([NORTH, EAST, 0.0 * NORTH], axis=-1))
    return (hill(LATITUDE, LONGITUDE) if zero is None else zero) - hill(np.degrees(latitude), np.degrees(longitude))


def bilinear(spacing: float) -> float:
    """Return the largest error of bilinear patches of the hill, read twice (cells, and points half as far apart)."""
    return 2.0 * 2.5e-4 * spacing**2 / 8.0 * 1.25


@pytest.mark.usefixtures("one_process")
class TestOneHill:
    @pytest.mark.long
    def test_geotiffs_in_degrees_and_on_maps(self, tmp_path: Path):
        """The zone's north is 2.19 degrees off: read as true north, heights would be off by 0.9 m at 500 m."""
        files = {
            "degrees": geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0, compress="deflate", predictor=3, tiled=True),
            "zone": geotiff(tmp_path / "b.tif", "EPSG:32630", 20.0, dtype="float64", compress="lzw"),
            "turned": geotiff(tmp_path / "c.tif", "EPSG:3035", 20.0, turn_deg=30.0, BIGTIFF="YES"),
            "national": geotiff(tmp_path / "d.tif", "EPSG:27700", 20.0, compress="zstd", predictor=2, nodata=-9999.0),
        }
        found = {name: down(file) for name, file in files.items()}
        for name, values in found.items():
            np.testing.assert_allclose(values, expected(), atol=0.01 + bilinear(20.0), err_msg=name)
        # Of float files all pairs.
        for values in found.values():
            np.testing.assert_allclose(values, found["degrees"], atol=0.05)

    def test_north_of_a_map_is_turned(self, tmp_path: Path):
        """Heights are a tenth of the easting; the meridian is 2.78948 degrees east of the zone's middle.

        It converges with that by 2.78948 sin(latitude) degrees, so 1 km to the north is 38.2 m to the west on the map.
        """
        import rasterio
        from rasterio.warp import transform

        (x,), (y,) = transform("EPSG:4326", "EPSG:32630", [LONGITUDE], [LATITUDE])
        place = rasterio.Affine(40.0, 0.0, x - 1500.0, 0.0, -40.0, y + 1500.0)
        heights = np.broadcast_to(0.1 * (40.0 * (np.arange(75) + 0.5) - 1500.0), (75, 75)).astype(np.float32)
        profile = {"width": 75, "height": 75, "count": 1, "dtype": "float32", "crs": "EPSG:32630", "transform": place}
        with rasterio.open(tmp_path / "a.tif", "w", "GTiff", **profile) as file:
            file.write(heights, 1)
        ground = ElevationFile(str(tmp_path / "a.tif")).at(SITE, (-1000.0, 1000.0, -100.0, 100.0))
        west = 1000.0 * np.sin(np.radians(2.78948 * np.sin(np.radians(LATITUDE))))
        found = ground.down(Vec3(np.array([1000.0, -1000.0]), np.zeros(2), np.zeros(2)))  # type: ignore[arg-type]
        np.testing.assert_allclose(np.asarray(found) / 0.1, [west, -west], atol=0.05)

    def test_whole_metres_feet_scales_and_offsets(self, tmp_path: Path):
        whole = geotiff(
            tmp_path / "a.tif", "EPSG:32630", 20.0, dtype="int16", compress="lzw", predictor=2, nodata=-32768
        )
        np.testing.assert_allclose(down(whole, height_of_zero=100.0), expected(100.0), atol=0.51 + bilinear(20.0))
        feet = geotiff(
            tmp_path / "b.tif", "EPSG:4326", 20.0, change=lambda metres: metres / 0.3048, tags={"units": ("ft",)}
        )
        np.testing.assert_allclose(down(feet), expected(), atol=0.01 + bilinear(20.0))
        assert "its heights are in feet ('ft')" in ElevationFile(feet).notes(SITE, BOX)[0]
        tags = {"scales": (0.01,), "offsets": (50.0,)}
        packed = geotiff(
            tmp_path / "c.tif", "EPSG:4326", 20.0, dtype="int32", change=lambda h: (h - 50.0) * 100.0, tags=tags
        )
        np.testing.assert_allclose(down(packed), expected(), atol=0.02 + bilinear(20.0))

    def test_srtm_and_lists_and_folders_and_virtual_rasters(self, tmp_path: Path):
        """SRTM's cells are 93 m by 58 m here, and its heights whole metres."""
        tolerance = 0.51 + 1.25 * 2.5e-4 * (92.7**2 + 57.6**2) / 8.0
        tile = hgt(tmp_path / "N51W001.hgt")
        for file in (tile, str(tmp_path), (tile,), vrt(tmp_path / "all.vrt", "N51W001.hgt")):
            np.testing.assert_allclose(down(file, height_of_zero=100.0), expected(100.0), atol=tolerance)

    def test_ascii_grids_with_a_prj_or_a_code(self, tmp_path: Path):
        for file, settings in (
            (utm_ascii(tmp_path / "a.asc"), {}),
            (utm_ascii(tmp_path / "b.asc", prj=False), {"crs": "EPSG:32630"}),
        ):
            np.testing.assert_allclose(down(file, **settings), expected(), atol=0.01 + bilinear(20.0))

    def test_without_a_prj_the_turn_of_the_map_is_said(self, tmp_path: Path):
        file = utm_ascii(tmp_path / "b.asc", prj=False)
        origin = {"origin_north": 5732784.0, "origin_east": 692666.0}
        assert "its north is taken for true north" in ElevationFile(file, **origin).notes(SITE, BOX)[0]
        assert ElevationFile(file, frame="local", **origin).notes(SITE, BOX) == ()
        assert ElevationFile(utm_ascii(tmp_path / "c.asc")).notes(SITE, BOX) == ()


@pytest.mark.usefixtures("one_process")
class TestTiles:
    def test_two_that_touch_are_one(self, tmp_path: Path):
        """The seam is 3 m east of the site: patches across it have heights of both."""
        import rasterio
        from rasterio.windows import Window

        whole = geotiff(tmp_path / "whole.tif", "EPSG:4326", 20.0)
        with rasterio.open(whole) as file:
            for name, first, last in (("a", 0, 45), ("b", 45, 90)):
                window = Window(first, 0, last - first, file.height)
                profile = file.profile | {"width": last - first, "transform": file.window_transform(window)}
                with rasterio.open(tmp_path / f"{name}.tif", "w", **profile) as part:
                    part.write(file.read(window=window))
        one, tiles = down(whole), tuple(str(tmp_path / f"{name}.tif") for name in "ab")
        np.testing.assert_array_equal(down(tiles), one)
        np.testing.assert_array_equal(down(tiles[::-1]), one)
        np.testing.assert_array_equal(down(vrt(tmp_path / "two.vrt", "a.tif", "b.tif")), one)
        with pytest.raises(UsageError, match=r"covers latitude .* world.area needs latitude"):
            down(tiles[0])

    def test_every_nth(self, tmp_path: Path):
        file = geotiff(tmp_path / "fine.tif", "EPSG:32630", 5.0, tiled=True, blockxsize=64, blockysize=64)
        for every in (4, 7):
            np.testing.assert_allclose(down(file, every=every), expected(), atol=0.01 + bilinear(5.0 * every))
        with pytest.raises(UsageError, match=r"every: 1000 leaves 1 x 1 heights, .* give a smaller number"):
            down(file, every=1000)

    def test_the_horizon_is_that_of_all_files(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """A wall of 1000 m, 5 km to the south in another file: 11.3 degrees."""
        import rasterio

        a = geotiff(tmp_path / "a.tif", "EPSG:32630", 20.0, change=lambda h: 0.0 * h)
        b = geotiff(
            tmp_path / "b.tif",
            "EPSG:32630",
            20.0,
            centre=(LATITUDE - 6000.0 / terrain_maps.NORTH_M, LONGITUDE),
            change=lambda h: 0.0 * h + 1000.0,
        )
        b_aligned = _aligned(b, a)
        assert np.asarray(ElevationFile(a).at(SITE, BOX).horizon).max() < 0.01
        # The near side is 5.1 km away; bearings are every 2 degrees, from north.
        wall = 1000.0 / np.hypot(1000.0, 5100.0)
        item = ElevationFile((a, b_aligned))
        horizon = np.asarray(item.at(SITE, BOX).horizon)
        assert horizon[0, 90] == pytest.approx(wall, abs=0.005)
        assert horizon[0, 0] < 0.01
        # One height stands for two by two or more, and then those of an overview.
        monkeypatch.setattr("qrsim.models.scene.terrain_files.survey.MOST_HEIGHTS", 12_000)
        for overviews in ([], [2, 4]):
            with rasterio.open(b_aligned, "r+") as file:
                file.build_overviews(overviews)
            os.utime(b_aligned, (1e9, 1e9 + len(overviews)))
            assert np.asarray(item.at(SITE, BOX).horizon)[0, 90] == pytest.approx(wall, abs=0.01)
            assert item.notes(SITE, BOX) == ()
        # Not as far as the wall where that would be too much to read.
        monkeypatch.setattr("qrsim.models.scene.terrain_files.survey.MOST_READ", 500.0)
        os.utime(b_aligned, (1e9, 2e9))
        assert np.asarray(item.at(SITE, BOX).horizon)[0, 90] < 0.01
        assert "the horizon is that of the nearest" in item.notes(SITE, BOX)[0]


def _aligned(file: str, other: str) -> str:
    """Move a file by less than a cell, so that its cells are those of another."""
    import rasterio

    with rasterio.open(other) as base, rasterio.open(file, "r+") as moved:
        column, row = ~base.transform @ (moved.transform.c, moved.transform.f)
        moved.transform = base.transform @ rasterio.Affine.translation(round(column), round(row))
    return file


@pytest.mark.usefixtures("one_process")
class TestMissing:
    @staticmethod
    def with_hole(tmp_path: Path, rows: slice, columns: slice, value: Any = -9999.0, **profile: Any) -> str:
        def change(heights: Any) -> Any:
            heights[rows, columns] = value
            return heights

        return geotiff(tmp_path / "hole.tif", "EPSG:32630", 20.0, change=change, **profile)

    def test_in_the_area_is_an_error(self, tmp_path: Path):
        values = [[-9999.0, -32768.0], [np.nan, 1e20]]
        file = self.with_hole(tmp_path, slice(50, 52), slice(40, 42), values)
        words = r"has no height at 38 of 10404 points .* first at north -143\.\d+ m, east -113\.\d+ m; missing: fill"
        with pytest.raises(UsageError, match=words):
            down(file)
        found = down(file, missing="fill")
        # Two cells of 20 m by a slope of 0.1.
        np.testing.assert_allclose(found, expected(), atol=4.0)
        assert "4 missing heights" in ElevationFile(file, missing="fill").notes(SITE, BOX)[0]

    def test_a_hole_too_large_is_not_filled(self, tmp_path: Path):
        with pytest.raises(UsageError, match="has no height at"):
            down(self.with_hole(tmp_path, slice(40, 55), slice(40, 55), 0.0, nodata=0.0), missing="fill")

    def test_beyond_the_area_it_matters_to_the_horizon_only(self, tmp_path: Path):
        np.testing.assert_allclose(down(self.with_hole(tmp_path, slice(0, 9), slice(0, 90))), expected(), atol=0.05)


@pytest.mark.usefixtures("one_process")
def test_z_0_is_the_site_by_its_height_above_the_sea_or_the_ellipsoid(tmp_path: Path):
    """The geoid is 46.29 m above the ellipsoid there, and the hill 124.6 m high at the site."""
    file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0)
    site = Site.from_degrees(LATITUDE, LONGITUDE, 160.0)
    for datum, zero in (("sea", 160.0 - 46.29), ("ellipsoid", 160.0)):
        np.testing.assert_allclose(down(file, site=site, zero="site", datum=datum), expected(zero), atol=0.06)
    with pytest.raises(UsageError, match="height_of_zero and zero: site are both given"):
        down(file, zero="site", height_of_zero=0.0)
