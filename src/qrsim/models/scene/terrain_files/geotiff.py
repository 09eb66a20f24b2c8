"""GeoTIFF (BigTIFF and COG among them) and Erdas Imagine (.img), by GDAL."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from qrsim.errors import UsageError, shortened
from qrsim.files.user_files import check_file
from qrsim.models.scene.terrain_files.crs import from_wkt
from qrsim.models.scene.terrain_files.gdal import Gdal
from qrsim.models.scene.terrain_files.raster import Crs, Grid, Heights, grid_of

DRIVERS = {".tif": "GTiff", ".tiff": "GTiff", ".img": "HFA"}
# Country-wide mosaics; of them only what is near the site is read.
LARGEST_FILE = 2**40
TYPES = ("int16", "int32", "uint8", "uint16", "uint32", "float32", "float64")
# Units of height, as files name them, in metres.
FEET, US_FEET = 0.3048, 1200.0 / 3937.0
METRES = {
    **dict.fromkeys(("", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet"), FEET),
    **dict.fromkeys(("us survey foot", "us survey feet", "ftus", "us-ft", "us_survey_foot"), US_FEET),
}


@dataclass(frozen=True)
class GeoTiff:
    """An open file; see ``Raster``."""

    file: str
    grid: Grid
    gdal: Gdal
    driver: str
    metres: float
    nodata: tuple[float, ...]
    note: str
    overviews: tuple[int, ...]

    def heights(self, rows: range, columns: range) -> Heights:
        """Return the heights [m] at rows and columns of the file, NaN where they are missing."""
        return self._read(rows, columns, False)

    def coarse(self, rows: range, columns: range) -> Heights:
        """Return one height [m] per block of cells (the ranges' steps), float32, by the file's overviews if any."""
        return self._read(rows, columns, True)

    def _read(self, rows: range, columns: range, coarse: bool) -> Heights:
        """Return the heights [m] at rows and columns, or one per block of cells if ``coarse``, read by GDAL."""
        return self.gdal.read(
            self.file, self.driver, rows, columns, coarse=coarse, metres=self.metres, nodata=self.nodata
        )


def open_geotiff(
    file: str, gdal: Gdal, site: tuple[float, float], given: Crs | None, nodata: tuple[float, ...] = ()
) -> GeoTiff:
    """Return a GeoTIFF, or other raster that GDAL reads, opened, with its content checked.

    Args:
        file: its path.
        gdal: to read it with.
        site: latitude and longitude [deg] where it will be used.
        given: system of a file that has none; one that has must have this one.
        nodata: further values for missing heights.

    Raises:
        UsageError: it cannot be read, or its content is not heights with a place.
        OSError: there is no such file.
    """
    if str(check_file(file, LARGEST_FILE).absolute()).startswith("/vsi"):
        raise UsageError(f"{file}: begins with /vsi, which GDAL takes for a virtual file; move it elsewhere")
    driver = DRIVERS[Path(file).suffix.lower()]
    found = gdal.describe(file, driver)
    if found["bands"] != 1:
        raise UsageError(f"{file}: has {found['bands']} bands; expected one, the heights")
    if found["palette"]:
        raise UsageError(f"{file}: band 1 is a colour (palette); expected heights in metres")
    if found["dtype"] not in TYPES:
        raise UsageError(f"{file}: band 1 has the type {found['dtype']}; expected one of {', '.join(TYPES)}")
    unit = str(found["unit"] or "")
    if unit.lower() not in METRES:
        raise UsageError(f"{file}: its unit is {shortened(repr(unit), 40)}; allowed: m, ft")
    crs = _system(file, found["crs"], gdal, site, given)
    if found["transform"] == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]:
        raise UsageError(f"{file}: has no geotransform, which gives the place of its cells")
    grid = grid_of(file, tuple(found["shape"]), found["transform"], crs)
    metres = METRES[unit.lower()]
    note = "" if metres == 1.0 else f"its heights are in feet ('{unit}') and are converted to metres"
    return GeoTiff(file, grid, gdal, driver, metres, nodata, note, tuple(found["overviews"]))


def _system(file: str, wkt: str | None, gdal: Gdal, site: tuple[float, float], given: Crs | None) -> Crs:
    """Return a file's coordinate reference system, or the given one; raise UsageError for none or a conflict."""
    if not wkt:
        if given is None:
            raise UsageError(f"{file}: has no coordinate reference system; give crs: EPSG:n")
        return given
    crs = from_wkt(file, wkt, gdal, site)
    if given is not None and given.wkt != crs.wkt:
        raise UsageError(f"{file}: has the coordinate reference system {crs.name}, not {given.name}; leave out crs")
    return crs
