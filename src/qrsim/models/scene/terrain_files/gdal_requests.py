"""Requests that GDAL and PROJ answer; ``gdal.py`` calls these functions in a child process."""

from __future__ import annotations

import json
import os
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

# Cells in memory at once where every n-th of them is wanted.
STRIP = 4_000_000
OPEN_FILES = 8
# Values that files use for missing heights, whatever their tag says; and no height is so large [m].
MISSING, LARGEST_HEIGHT = (-9999.0, -32768.0), 20_000.0


def dataset(file: str, driver: str) -> Any:
    """Return the opened rasterio dataset of a file, opened again only if the file has changed."""
    status = os.stat(file)
    return opened(file, driver, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=OPEN_FILES)
def opened(file: str, driver: str, changed: int, size: int) -> object:
    """Return the opened rasterio dataset of a file; ``changed`` and ``size`` identify its version for the cache."""
    import rasterio

    return rasterio.open(file, driver=driver)


def describe(file: str, driver: str) -> dict[str, Any]:
    """Return a raster file's header: bands, dtype, shape, transform, WKT, unit, overviews and palette."""
    found = dataset(file, driver)
    colours = [each.name for each in found.colorinterp]
    return {
        "bands": found.count,
        "dtype": found.dtypes[0],
        "shape": [found.height, found.width],
        "transform": list(found.transform)[:6],
        "crs": found.crs.to_wkt() if found.crs else None,
        "unit": found.units[0],
        "overviews": found.overviews(1),
        "palette": colours[0] == "palette",
    }


def read(
    file: str, driver: str, rows: range, columns: range, coarse: bool, metres: float, nodata: tuple[float, ...]
) -> npt.NDArray[Any]:
    """Return a window's heights [m], NaN if missing: every n-th, float64, or one per block if ``coarse``, float32."""
    import numpy as np
    from rasterio.windows import Window

    found = dataset(file, driver)
    (r0, r1), (c0, c1), n = (rows.start, rows.stop), (columns.start, columns.stop), rows.step
    if coarse:
        shape = ((r1 - r0) // n, (c1 - c0) // n)
        return heights(found, Window(c0, r0, c1 - c0, r1 - r0), shape, metres, nodata).astype(np.float32)
    parts, strip = [], max(1, STRIP // (c1 - c0) // n) * n
    for first in range(r0, r1, strip):
        window = Window(c0, first, c1 - c0, min(strip, r1 - first))
        parts.append(heights(found, window, None, metres, nodata)[::n, ::n])
    return np.concatenate(parts)


def heights(
    found: Any, window: Any, shape: tuple[int, int] | None, metres: float, nodata: tuple[float, ...]
) -> npt.NDArray[np.float64]:
    """Return the heights [m] in a window of an open raster, resampled to ``shape`` if given; NaN where missing."""
    import numpy as np
    from rasterio.enums import MaskFlags

    raw = found.read(1, window=window, out_shape=shape)
    value = raw.astype(np.float64)
    missing = ~np.isfinite(value)
    for none in (*MISSING, *nodata):
        missing |= value == none
    if found.nodatavals[0] is not None:
        missing |= value == found.nodatavals[0]
    if MaskFlags.per_dataset in found.mask_flag_enums[0]:
        missing |= found.read_masks(1, window=window, out_shape=shape) == 0
    value = (value * found.scales[0] + found.offsets[0]) * metres
    return np.where(missing | ~(np.abs(value) <= LARGEST_HEIGHT), np.nan, value)


def crs_of(text: str, esri: bool = False) -> Any:
    """Return the rasterio CRS (coordinate reference system) of an EPSG code, WKT or PROJJSON text."""
    from rasterio.crs import CRS

    if text.upper().startswith("EPSG:"):
        return CRS.from_epsg(int(text[5:]))
    return CRS.from_wkt(text, morph_from_esri_dialect=esri) if esri else CRS.from_user_input(text)


def crs(text: str, site: tuple[float, float], esri: bool) -> dict[str, Any]:
    """Return wkt, name, kind, wgs84 and accuracy of a reference system's horizontal part, near a site [deg]."""
    found = crs_of(text, esri)
    content = found.to_dict(projjson=True)
    while content.get("type") in ("CompoundCRS", "BoundCRS"):
        content = content["components"][0] if content["type"] == "CompoundCRS" else content["source_crs"]
        found = crs_of(json.dumps(content))
    wgs84 = found == crs_of("EPSG:4326")
    kind = "geographic" if found.is_geographic else "projected" if found.is_projected else content.get("type", "")
    base = content.get("base_crs", content).get("id", {})
    code = content.get("id", {})
    return {
        "wkt": "EPSG:4326" if wgs84 else found.to_wkt(),
        "name": f"{code['authority']}:{code['code']}" if "code" in code else content.get("name", "unnamed"),
        "kind": kind,
        "wgs84": wgs84,
        "accuracy": accuracy(base, *site),
    }


def accuracy(base: dict[str, object], latitude: float, longitude: float) -> float | None:
    """Return the accuracy [m] of the best gridless shift from a datum to WGS 84, by PROJ's database; None if unknown.

    0: its coordinates are those of WGS 84 to 1 m or 2 (ETRS89 and NAD83 among them).
    """
    import sqlite3

    import rasterio

    if base.get("authority") != "EPSG" or base.get("code") in (4326, 4979, 4258, 4269):
        return 0.0
    database = Path(os.environ.get("PROJ_DATA", str(Path(rasterio.__file__).parent / "proj_data"))) / "proj.db"
    query = """
        SELECT min(t.accuracy) FROM helmert_transformation t JOIN usage u ON u.object_table_name =
        'helmert_transformation' AND u.object_auth_name = t.auth_name AND u.object_code = t.code
        JOIN extent e ON e.auth_name = u.extent_auth_name AND e.code = u.extent_code
        WHERE t.source_crs_auth_name = 'EPSG' AND t.source_crs_code = ? AND t.target_crs_code IN ('4326', '4979')
        AND t.deprecated = 0 AND ? BETWEEN e.south_lat AND e.north_lat AND ? BETWEEN e.west_lon AND e.east_lon"""
    try:
        with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as known:
            (found,) = known.execute(query, (str(base["code"]), latitude, longitude)).fetchone()
    except sqlite3.Error:
        return None
    return None if found is None else float(found)


def transform(
    source: str, target: str, x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return points converted to another reference system, as one array: all x, then all y; infinite if impossible."""
    import numpy as np
    from rasterio.warp import transform as transformed

    return np.array(transformed(crs_of(source), crs_of(target), x, y)[:2], np.float64)
