"""Pictures of the ground from files, GeoTIFF and MBTiles; ``imagery.py`` calls these functions in a child process."""

from __future__ import annotations

import io
import math
import sqlite3
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError

# South, west, north, east [deg].
Bounds = tuple[float, float, float, float]
# Pixels of a tile; the most tiles of one picture, and the deepest zoom.
TILE, MOST_TILES, DEEPEST = 256, 144, 24
# Percentiles that become black and white, of pixels of more than eight bits.
DARK, BRIGHT = 2.0, 98.0


def read_geotiff(path: str, bounds: Bounds, size: tuple[int, int]) -> NumpyArray:
    """Return RGBA (rows, columns, 4) of a GeoTIFF within latitude and longitude bounds; row 0 is the north.

    Args:
        path: of the file.
        bounds: of the box.
        size: rows and columns.

    Raises:
        UsageError: the file has no place, no colours, or another place.
    """
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.transform import from_bounds
    from rasterio.vrt import WarpedVRT
    from rasterio.warp import transform_bounds

    south, west, north, east = bounds
    with rasterio.open(path, driver="GTiff") as found:
        if found.crs is None:
            raise UsageError("it has no coordinate reference system; expected a GeoTIFF with one")
        if found.count not in (1, 2, 3, 4):
            raise UsageError(f"it has {found.count} bands; expected 1 (grey or palette), 3 (RGB) or 4 (RGBA)")
        palette = found.colormap(1) if found.colorinterp[0].name == "palette" else None
        box = transform_bounds(found.crs, "EPSG:4326", *found.bounds)
        rows, columns = size
        grid = from_bounds(west, south, east, north, columns, rows)
        way = Resampling.nearest if palette else Resampling.bilinear
        alpha = found.count in (1, 3)
        with WarpedVRT(
            found, crs="EPSG:4326", transform=grid, width=columns, height=rows, add_alpha=alpha, resampling=way
        ) as warped:
            bands = warped.read()
    *colours, opacity = bands
    if not opacity.any():
        raise _elsewhere((box[1], box[0], box[3], box[2]), bounds)
    if palette:
        table = np.zeros((256, 3), np.uint8)
        for number, (red, green, blue, _) in palette.items():
            table[number % 256] = (red, green, blue)
        colours = list(np.moveaxis(table[colours[0] % 256], -1, 0))
    found_colours = np.stack(colours * 3 if len(colours) == 1 else colours, axis=-1)
    seen = (opacity > 0).astype(np.uint8) * 255
    return np.dstack([_eight_bits(found_colours, seen > 0), seen])


def _eight_bits(colours: NumpyArray, there: NumpyArray) -> NumpyArray:
    """Return colours as uint8, other types stretched over the values of the valid pixels (``there``)."""
    if colours.dtype == np.uint8:
        return colours
    low, high = np.nanpercentile(colours[there].astype(np.float64), [DARK, BRIGHT])
    return np.clip(255.0 * (colours - low) / max(high - low, 1e-9), 0.0, 255.0).astype(np.uint8)


def read_mbtiles(path: str, bounds: Bounds, size: tuple[int, int]) -> NumpyArray:
    """Return RGBA as ``read_geotiff`` does, from an MBTiles file (Web Mercator) at the zoom that suits ``size``.

    Raises:
        UsageError: it is no such file, its tiles are no pictures, or it shows another place.
    """
    try:
        with sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True) as database:
            return _from_tiles(database, bounds, size)
    except sqlite3.Error as error:
        raise UsageError(f"it is no MBTiles file ({error})") from None


def _from_tiles(database: sqlite3.Connection, bounds: Bounds, size: tuple[int, int]) -> NumpyArray:
    """Return RGBA within latitude and longitude bounds, put together from the tiles of an MBTiles database."""
    zooms = [row[0] for row in database.execute("SELECT DISTINCT zoom_level FROM tiles ORDER BY zoom_level")]
    zooms = [zoom for zoom in zooms if isinstance(zoom, int) and 0 <= zoom <= DEEPEST]
    if not zooms:
        raise UsageError("it has no tiles")
    south, west, north, east = bounds
    fitting = [zoom for zoom in zooms if _count(bounds, zoom) <= MOST_TILES] or zooms[:1]
    if _count(bounds, fitting[-1]) > MOST_TILES:
        raise UsageError(f"its coarsest zoom, {zooms[0]}, has too many tiles of this place; expected {MOST_TILES}")
    zoom = next((zoom for zoom in fitting if (east - west) / 360.0 * TILE * 2**zoom >= size[1]), fitting[-1])
    (x0, y0), (x1, y1) = _tile(north, west, zoom), _tile(south, east, zoom)
    first = (math.floor(x0), math.floor(y0))
    mosaic = np.zeros(((math.floor(y1) - first[1] + 1) * TILE, (math.floor(x1) - first[0] + 1) * TILE, 4), np.uint8)
    for row in range(first[1], math.floor(y1) + 1):
        for column in range(first[0], math.floor(x1) + 1):
            # Rows of the file are counted from the south.
            place = (zoom, column, 2**zoom - 1 - row)
            data = database.execute(
                "SELECT tile_data FROM tiles WHERE zoom_level=? AND tile_column=? AND tile_row=?", place
            ).fetchone()
            if data is not None:
                top, left = (row - first[1]) * TILE, (column - first[0]) * TILE
                mosaic[top : top + TILE, left : left + TILE] = _decoded(data[0])
    if not mosaic[..., 3].any():
        raise UsageError(f"it has no tile of zoom {zoom} at {_place(bounds)}, where the run is")
    latitudes = np.linspace(north, south, size[0])
    ys = np.array([_tile(latitude, west, zoom)[1] for latitude in latitudes]) - first[1]
    xs = np.linspace(x0, x1, size[1]) - first[0]
    rows, columns = ((part * TILE).astype(int) for part in (ys, xs))
    return mosaic[np.clip(rows, 0, len(mosaic) - 1)[:, None], np.clip(columns, 0, mosaic.shape[1] - 1)[None]]


def _tile(latitude: float, longitude: float, zoom: int) -> tuple[float, float]:
    """Return the fractional tile column and row (from the north) of a latitude and longitude [deg] at a zoom."""
    angle = math.radians(max(-85.0, min(85.0, latitude)))
    return (longitude + 180.0) / 360.0 * 2**zoom, (1.0 - math.asinh(math.tan(angle)) / math.pi) / 2.0 * 2**zoom


def _count(bounds: Bounds, zoom: int) -> int:
    """Return how many tiles cover these bounds at a zoom."""
    (x0, y0), (x1, y1) = _tile(bounds[2], bounds[1], zoom), _tile(bounds[0], bounds[3], zoom)
    return (math.floor(x1) - math.floor(x0) + 1) * (math.floor(y1) - math.floor(y0) + 1)


def _decoded(data: Any) -> NumpyArray:
    """Return the pixels (TILE, TILE, 4) of an encoded image tile."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP")) as found:
            if max(found.size) > 4 * TILE:
                raise UsageError(f"a tile of {found.size[0]} x {found.size[1]} pixels; expected {TILE}")
            return np.asarray(found.convert("RGBA").resize((TILE, TILE)))
    except (UnidentifiedImageError, OSError, TypeError, ValueError):
        raise UsageError("its tiles are no pictures; expected PNG, JPEG or WebP") from None


def _elsewhere(own: Bounds, wanted: Bounds) -> UsageError:
    """Return the error for an image that shows another place than the wanted bounds."""
    return UsageError(f"it shows another place, {_place(own)}; the run is at {_place(wanted)}")


def _place(bounds: Bounds) -> str:
    """Return the centre of latitude and longitude bounds as text."""
    return f"{0.5 * (bounds[0] + bounds[2]):.4f}, {0.5 * (bounds[1] + bounds[3]):.4f}"
