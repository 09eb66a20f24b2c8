"""Terrain files: one hill in every format, tiles, missing heights, and every file that is refused."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.models.scene import terrain_maps
from tests.models.scene.terrain_maps import BOX, LATITUDE, LONGITUDE, SITE, geotiff, hgt, hill, utm_ascii, vrt

from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.site import Site

pytest.importorskip("rasterio")

RNG = np.random.default_rng(5)
NORTH, EAST = RNG.uniform(-500.0, 500.0, (2, 1000))


def down(file: Any, box: Any = BOX, site: Site = SITE, **settings: Any) -> Any:
    """Return the down coordinate at the 1000 places."""
    ground = ElevationFile(file, **settings).at(site, box)
    return np.asarray(ground.down(Vec3(NORTH, EAST, 0.0 * NORTH)), np.float64)  # type: ignore[arg-type]


def expected(zero: float | None = None) -> Any:
    """Return the down coordinate of the hill there, by its formula; z = 0 is its height at the origin."""
    latitude, longitude, _ = SITE.ned_to_geodetic(np.stack([NORTH, EAST, 0.0 * NORTH], axis=-1))
    return (hill(LATITUDE, LONGITUDE) if zero is None else zero) - hill(np.degrees(latitude), np.degrees(longitude))


def bilinear(spacing: float) -> float:
    """Return the largest error of bilinear patches of the hill, read twice (cells, and points half as far apart)."""
    return 2.0 * 2.5e-4 * spacing**2 / 8.0 * 1.25


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

    @pytest.mark.long
    def test_whole_metres_feet_scales_and_offsets(self, tmp_path: Path):
        whole = geotiff(
            tmp_path / "a.tif", "EPSG:32630", 20.0, dtype="int16", compress="lzw", predictor=2, nodata=-32768
        )
        np.testing.assert_allclose(down(whole, height_of_zero=100.0), expected(100.0), atol=0.51 + bilinear(20.0))
        feet = geotiff(
            tmp_path / "b.tif", "EPSG:4326", 20.0, change=lambda metres: metres / 0.3048, tags={"units": ("ft",)}
        )
        np.testing.assert_allclose(down(feet), expected(), atol=0.01 + bilinear(20.0))
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


class TestTiles:
    @pytest.mark.long
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

    @pytest.mark.long
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


def test_z_0_is_the_site_by_its_height_above_the_sea_or_the_ellipsoid(tmp_path: Path):
    """The geoid is 46.29 m above the ellipsoid there, and the hill 124.6 m high at the site."""
    file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0)
    site = Site.from_degrees(LATITUDE, LONGITUDE, 160.0)
    for datum, zero in (("sea", 160.0 - 46.29), ("ellipsoid", 160.0)):
        np.testing.assert_allclose(down(file, site=site, zero="site", datum=datum), expected(zero), atol=0.06)
    with pytest.raises(UsageError, match="height_of_zero and zero: site are both given"):
        down(file, zero="site", height_of_zero=0.0)


class TestRefused:
    """Each file that cannot be used, and what is said; the messages name the file."""

    def said(self, file: Any, **settings: Any) -> str:
        with pytest.raises(UsageError) as caught:
            down(file, **settings)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"tagged": False}, "has no coordinate reference system; give crs: EPSG:n"),
            ({"count": 3}, "has 3 bands; expected one, the heights"),
            ({"dtype": "uint8", "photometric": "palette"}, "band 1 is a colour (palette); expected heights in metres"),
            ({"tags": {"units": ("foo",)}}, "its unit is 'foo'; allowed: m, ft"),
            ({"dtype": "complex64"}, "band 1 has the type complex64; expected one of int16"),
            (
                {"centre": (51.7119, 0.21052 + 130.0)},
                "the site is 7 611 km from its grid; look at site and crs",
            ),
            ({"centre": (51.7119, 2.21052)}, "the site is 166 km from its grid; look at site and crs"),
            ({"centre": (-51.7119, -0.21052)}, "km from its grid; is the site's latitude of the right sign?"),
            ({"reach": 400.0}, "world.area needs latitude 51.707406 to 51.716394, longitude -0.21775"),
        ],
    )
    def test_geotiffs(self, tmp_path: Path, options: dict[str, Any], words: str):
        if options.get("photometric"):
            options["change"] = lambda h: np.clip(h, 0, 255)
        file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0, **options)
        assert words in self.said(file)

    def test_a_sign_of_the_longitude(self, tmp_path: Path):
        """Six degrees of longitude at 51.7 degrees north are 413 km on the great circle, to the middle of the file."""
        file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0, centre=(51.7119, 3.0))
        words = "the site is 412 km from its grid; is the site's longitude of the right sign?"
        assert words in self.said(file, site=Site.from_degrees(51.7119, -3.0))

    @pytest.mark.parametrize(
        ("settings", "words"),
        [
            ({"crs": "EPSG:99999"}, "crs: PROJ knows no EPSG:99999; expected a code such as EPSG:32630"),
            ({"crs": "UTM 30"}, "crs: 'UTM 30' is no code; expected one such as EPSG:32630"),
            ({"crs": "EPSG:4978"}, "is GeodeticCRS; expected a geographic or a projected one"),
            ({"crs": "EPSG:32630"}, "has the coordinate reference system EPSG:4326, not EPSG:32630; leave out crs"),
            ({"frame": "local"}, "frame, origin_north and origin_east are for .asc and .npz in metres"),
            ({"box": None}, "needs a world.area with bounds, box or polygon"),
        ],
    )
    def test_settings(self, tmp_path: Path, settings: dict[str, Any], words: str):
        assert words in self.said(geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0), **settings)

    def test_too_many_heights(self, tmp_path: Path):
        """A file of 10 cm cells that says it has 60 000 x 60 000, none of which is there."""
        import rasterio
        from rasterio.crs import CRS

        place = rasterio.Affine(0.1, 0.0, 690_000.0, 0.0, -0.1, 5_736_000.0)
        profile = {"width": 60_000, "height": 60_000, "count": 1, "dtype": "float32", "transform": place}
        file = str(tmp_path / "a.tif")
        with rasterio.open(file, "w", "GTiff", crs=CRS.from_epsg(32630), SPARSE_OK=True, BIGTIFF="YES", **profile):
            pass
        assert "1.1e+08 heights in world.area; allowed: 8e+06; set every: 4, or a smaller area" in self.said(file)

    def test_damaged(self, tmp_path: Path):
        path = Path(geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0, tiled=True, blockxsize=16, blockysize=16))
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])
        assert "a.tif: cannot be read: " in self.said(str(path))
        path.write_bytes(b"GIF89a")
        assert "a.tif: cannot be read: 'a.tif' not recognized" in self.said(str(path))
        deflated = Path(geotiff(tmp_path / "b.tif", "EPSG:4326", 20.0, compress="deflate", blockysize=8))
        data = deflated.read_bytes()
        middle = len(data) // 2
        deflated.write_bytes(data[:middle] + b"\xff" * 2000 + data[middle + 2000 :])
        assert "b.tif: cannot be read: block (" in self.said(str(deflated))
        assert "a.tif: cannot be read: No such file" in self.said(str(tmp_path / "none" / "a.tif"))

    def test_srtm(self, tmp_path: Path):
        (tmp_path / "foo.hgt").write_bytes(bytes(2884802))
        (tmp_path / "N51W001.hgt").write_bytes(bytes(25000))
        assert "its name says no place; expected one such as N51W001.hgt" in self.said(str(tmp_path / "foo.hgt"))
        words = "has 25000 bytes; an .hgt has 2884802 (1201 x 1201) or 25934402 (3601 x 3601)"
        assert words in self.said(str(tmp_path / "N51W001.hgt"))

    def test_tiles(self, tmp_path: Path):
        a = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0)
        b, c = geotiff(tmp_path / "b.tif", "EPSG:4326", 30.0), geotiff(tmp_path / "c.tif", "EPSG:32630", 20.0)
        words = "b.tif: its cells are 0.000269639 x 0.000434028 deg, those of"
        assert words in self.said((a, b))
        assert "c.tif: has the coordinate reference system EPSG:32630" in self.said((a, c))
        moved = (LATITUDE + 7.0 / terrain_maps.NORTH_M, LONGITUDE)
        d = geotiff(tmp_path / "d.tif", "EPSG:4326", 20.0, centre=moved)
        assert "are shifted against those of" in self.said((a, d))
        (tmp_path / "none").mkdir()
        assert "none: has no terrain in it; expected files .tif" in self.said(str(tmp_path / "none"))
        assert "x.txt: expected one of .tif" in self.said((a, str(tmp_path / "x.txt")))

    def test_a_gap_between_srtm_tiles(self, tmp_path: Path):
        """The site is 51.99 degrees north; N51W001 ends at 52."""
        for name in ("N51W001", "N53W001"):
            hgt(tmp_path / f"{name}.hgt", change=lambda h: 0.0 * h)
        words = self.said(str(tmp_path), site=Site.from_degrees(51.998, LONGITUDE))
        assert "nothing between latitude 52.000833 and 52.0025, longitude" in words
        assert words.endswith("; tile N52W001 is missing")

    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("/vsicurl/http://x/a.tif", "source 1, '/vsicurl/http://x/a.tif', is not in its folder; only files in"),
            ("../a.tif", "source 1, '../a.tif', is not in its folder"),
            ("/etc/passwd", "source 1, '/etc/passwd', is not in its folder"),
            ("b.vrt", "b.vrt is of no kind that is read in a .vrt"),
            ("", "source 1 has no SourceFilename"),
            ("none.tif", "none.tif: cannot be read: No such file"),
        ],
    )
    def test_virtual_rasters_of_files_elsewhere(self, tmp_path: Path, name: str, words: str):
        assert words in self.said(vrt(tmp_path / "a.vrt", name))

    def test_virtual_rasters_that_compute(self, tmp_path: Path):
        words = "source 1 has LUT, which changes heights"
        assert words in self.said(vrt(tmp_path / "a.vrt", "a.tif", inner="<LUT>0:1,1:2</LUT>", kind="ComplexSource"))
        assert "has a KernelFilteredSource" in self.said(vrt(tmp_path / "b.vrt", "a.tif", kind="KernelFilteredSource"))
        path = tmp_path / "c.vrt"
        for text, words in (
            ('<!DOCTYPE a [<!ENTITY b "c">]><VRTDataset/>', "has a document type, which is not read"),
            ("<VRTDataset", "is no XML"),
            ("<kml/>", "begins with <kml>; expected <VRTDataset>"),
            ('<VRTDataset subClass="VRTWarpedDataset"/>', "is a VRTWarpedDataset"),
            ("<VRTDataset/>", "has 0 bands; expected one"),
            ('<VRTDataset><VRTRasterBand subClass="VRTDerivedRasterBand"/></VRTDataset>', "is a VRTDerivedRasterBand"),
        ):
            path.write_text(text)
            assert words in self.said(str(path))

    def test_a_prj_that_is_none(self, tmp_path: Path):
        file = utm_ascii(tmp_path / "a.asc")
        (tmp_path / "a.prj").write_text("Projection UTM")
        assert "a.prj: PROJ does not understand its coordinate reference system, 'Projection UTM'" in self.said(file)

    def test_a_process_that_ends_is_a_file_that_cannot_be_read(self, tmp_path: Path, monkeypatch: Any):
        file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0)
        half = "import struct, sys\nsys.stdout.buffer.write(struct.pack('<IQ', 2, 100) + b'{}half')\n"
        for name, script in (("crash.py", "import os\nos.abort()\n"), ("half.py", half)):
            (tmp_path / name).write_text(script)
            monkeypatch.setattr("qrsim.models.scene.terrain_files.gdal.PROCESS", tmp_path / name)
            assert "a.tif: cannot be read: GDAL ended on it" in self.said(file)
            os.utime(file)

    def test_without_the_package_one_line_says_how_to_get_it(self, tmp_path: Path, monkeypatch: Any):
        monkeypatch.setattr("qrsim.extras._present", lambda name: name != "rasterio")
        words = self.said(geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0))
        assert words.endswith("needs rasterio: python -m pip install 'qrsim[terrain]'")
        # SRTM needs none.
        down(hgt(tmp_path / "N51W001.hgt"))
