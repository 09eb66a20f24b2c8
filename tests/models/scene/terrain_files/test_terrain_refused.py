"""Terrain files that are refused, and what is said of each."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.models.scene import terrain_maps
from tests.models.scene.terrain_maps import LATITUDE, LONGITUDE, down, geotiff, hgt, utm_ascii, vrt

from qrsim.errors import UsageError
from qrsim.models.scene.terrain_files import gdal_requests
from qrsim.models.site import Site

pytest.importorskip("rasterio")


def said(file: Any, **settings: Any) -> str:
    """Return the message of a file that is refused."""
    with pytest.raises(UsageError) as caught:
        down(file, **settings)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.usefixtures("one_process")
class TestRefused:
    """Each file that cannot be used, and what is said; the messages name the file."""

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
        assert words in said(file)

    def test_a_sign_of_the_longitude(self, tmp_path: Path):
        """Six degrees of longitude at 51.7 degrees north are 413 km on the great circle, to the middle of the file."""
        file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0, centre=(51.7119, 3.0))
        words = "the site is 412 km from its grid; is the site's longitude of the right sign?"
        assert words in said(file, site=Site.from_degrees(51.7119, -3.0))

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
        assert words in said(geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0), **settings)

    def test_too_many_heights(self, tmp_path: Path):
        """A file of 10 cm cells that says it has 60 000 x 60 000, none of which is there."""
        import rasterio
        from rasterio.crs import CRS

        place = rasterio.Affine(0.1, 0.0, 690_000.0, 0.0, -0.1, 5_736_000.0)
        profile = {"width": 60_000, "height": 60_000, "count": 1, "dtype": "float32", "transform": place}
        file = str(tmp_path / "a.tif")
        with rasterio.open(file, "w", "GTiff", crs=CRS.from_epsg(32630), SPARSE_OK=True, BIGTIFF="YES", **profile):
            pass
        assert "1.1e+08 heights in world.area; allowed: 8e+06; set every: 4, or a smaller area" in said(file)

    def test_damaged(self, tmp_path: Path):
        path = Path(geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0, tiled=True, blockxsize=16, blockysize=16))
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])
        assert "a.tif: cannot be read: " in said(str(path))
        path.write_bytes(b"GIF89a")
        assert "a.tif: cannot be read: 'a.tif' not recognized" in said(str(path))
        deflated = Path(geotiff(tmp_path / "b.tif", "EPSG:4326", 20.0, compress="deflate", blockysize=8))
        data = deflated.read_bytes()
        middle = len(data) // 2
        deflated.write_bytes(data[:middle] + b"\xff" * 2000 + data[middle + 2000 :])
        assert "b.tif: cannot be read: block (" in said(str(deflated))
        assert "a.tif: cannot be read: No such file" in said(str(tmp_path / "none" / "a.tif"))

    def test_srtm(self, tmp_path: Path):
        (tmp_path / "foo.hgt").write_bytes(bytes(2884802))
        (tmp_path / "N51W001.hgt").write_bytes(bytes(25000))
        assert "its name says no place; expected one such as N51W001.hgt" in said(str(tmp_path / "foo.hgt"))
        words = "has 25000 bytes; an .hgt has 2884802 (1201 x 1201) or 25934402 (3601 x 3601)"
        assert words in said(str(tmp_path / "N51W001.hgt"))

    def test_tiles(self, tmp_path: Path):
        a = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0)
        b, c = geotiff(tmp_path / "b.tif", "EPSG:4326", 30.0), geotiff(tmp_path / "c.tif", "EPSG:32630", 20.0)
        words = "b.tif: its cells are 0.000269639 x 0.000434028 deg, those of"
        assert words in said((a, b))
        assert "c.tif: has the coordinate reference system EPSG:32630" in said((a, c))
        moved = (LATITUDE + 7.0 / terrain_maps.NORTH_M, LONGITUDE)
        d = geotiff(tmp_path / "d.tif", "EPSG:4326", 20.0, centre=moved)
        assert "are shifted against those of" in said((a, d))
        (tmp_path / "none").mkdir()
        assert "none: has no terrain in it; expected files .tif" in said(str(tmp_path / "none"))
        assert "x.txt: expected one of .tif" in said((a, str(tmp_path / "x.txt")))

    def test_a_gap_between_srtm_tiles(self, tmp_path: Path):
        """The site is 51.99 degrees north; N51W001 ends at 52."""
        for name in ("N51W001", "N53W001"):
            hgt(tmp_path / f"{name}.hgt", change=lambda h: 0.0 * h)
        words = said(str(tmp_path), site=Site.from_degrees(51.998, LONGITUDE))
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
        assert words in said(vrt(tmp_path / "a.vrt", name))

    def test_virtual_rasters_that_compute(self, tmp_path: Path):
        words = "source 1 has LUT, which changes heights"
        assert words in said(vrt(tmp_path / "a.vrt", "a.tif", inner="<LUT>0:1,1:2</LUT>", kind="ComplexSource"))
        assert "has a KernelFilteredSource" in said(vrt(tmp_path / "b.vrt", "a.tif", kind="KernelFilteredSource"))
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
            assert words in said(str(path))

    def test_a_prj_that_is_none(self, tmp_path: Path):
        file = utm_ascii(tmp_path / "a.asc")
        (tmp_path / "a.prj").write_text("Projection UTM")
        assert "a.prj: PROJ does not understand its coordinate reference system, 'Projection UTM'" in said(file)


def crash(*_: object) -> None:
    os.abort()


class TestProcess:
    def test_a_process_that_ends_is_a_file_that_cannot_be_read(self, tmp_path: Path, monkeypatch: Any):
        file = geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0)
        monkeypatch.setattr(gdal_requests, "describe", crash)
        assert said(file).endswith("a.tif: cannot be read: its decoder crashed (SIGABRT)")

    def test_without_the_package_one_line_says_how_to_get_it(self, tmp_path: Path, monkeypatch: Any):
        monkeypatch.setattr("qrsim.extras._present", lambda name: name != "rasterio")
        words = said(geotiff(tmp_path / "a.tif", "EPSG:4326", 20.0))
        assert words.endswith("needs rasterio: python -m pip install 'qrsim[terrain]'")
        # SRTM needs none.
        down(hgt(tmp_path / "N51W001.hgt"))
