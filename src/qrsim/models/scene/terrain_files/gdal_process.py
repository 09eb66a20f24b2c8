"""The process that runs GDAL and PROJ, with a limit on its memory; ``gdal.py`` starts it and describes its requests.

It is run as a script and imports nothing of qrsim, so that it starts in a fraction of a second.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

LARGEST_MEMORY, LONGEST_CPU_S = 10**9, 120
# Cells in memory at once where every n-th of them is wanted.
STRIP = 4_000_000
OPEN_FILES = 8
# Values that files use for missing heights, whatever their tag says; and no height is so large [m].
MISSING, LARGEST_HEIGHT = (-9999.0, -32768.0), 20_000.0
HEAD = struct.Struct("<IQ")
Answer = tuple[dict[str, Any], bytes]


def limit() -> None:
    """Limit memory and processor time, where the system can."""
    try:
        import resource
    except ImportError:
        return
    # macOS refuses a limit on the address space.
    for what, most in (("RLIMIT_AS", LARGEST_MEMORY), ("RLIMIT_CPU", LONGEST_CPU_S), ("RLIMIT_CORE", 0)):
        try:
            resource.setrlimit(getattr(resource, what), (most, most))
        except (AttributeError, ValueError, OSError):
            continue


def dataset(request: dict[str, Any]) -> Any:
    """Open a file with one driver, or return it if it is open and has not changed."""
    status = os.stat(request["file"])
    return opened(request["file"], request["driver"], status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=OPEN_FILES)
def opened(file: str, driver: str, changed: int, size: int) -> Any:
    """Open a file with one driver."""
    import rasterio

    return rasterio.open(file, driver=driver)


def describe(request: dict[str, Any], payload: bytes) -> Answer:
    """Return size, type, place and tags of a file."""
    found = dataset(request)
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
    }, b""


def read(request: dict[str, Any], payload: bytes) -> Answer:
    """Return every n-th height [m] of a window in float64, or means of n by n in float32; NaN: missing."""
    import numpy as np
    from rasterio.windows import Window

    found = dataset(request)
    (r0, r1), (c0, c1), n = request["rows"], request["columns"], request["every"]
    if request["coarse"]:
        shape = ((r1 - r0) // n, (c1 - c0) // n)
        data = heights(found, Window(c0, r0, c1 - c0, r1 - r0), request, shape).astype(np.float32)
        return {"shape": list(data.shape)}, data.tobytes()
    parts, strip = [], max(1, STRIP // (c1 - c0) // n) * n
    for first in range(r0, r1, strip):
        window = Window(c0, first, c1 - c0, min(strip, r1 - first))
        parts.append(heights(found, window, request, None)[::n, ::n])
    data = np.concatenate(parts)
    return {"shape": list(data.shape)}, data.tobytes()


def heights(found: Any, window: Any, request: dict[str, Any], shape: tuple[int, int] | None) -> Any:
    """Return the heights [m] of a window; NaN: missing."""
    import numpy as np
    from rasterio.enums import MaskFlags

    raw = found.read(1, window=window, out_shape=shape)
    value = raw.astype(np.float64)
    missing = ~np.isfinite(value)
    for none in (*MISSING, *request["nodata"]):
        missing |= value == none
    if found.nodatavals[0] is not None:
        missing |= value == found.nodatavals[0]
    if MaskFlags.per_dataset in found.mask_flag_enums[0]:
        missing |= found.read_masks(1, window=window, out_shape=shape) == 0
    value = (value * found.scales[0] + found.offsets[0]) * request["metres"]
    return np.where(missing | ~(np.abs(value) <= LARGEST_HEIGHT), np.nan, value)


def crs_of(text: str, esri: bool = False) -> Any:
    """Return a coordinate reference system from EPSG:n, WKT or PROJJSON."""
    from rasterio.crs import CRS

    if text.upper().startswith("EPSG:"):
        return CRS.from_epsg(int(text[5:]))
    return CRS.from_wkt(text, morph_from_esri_dialect=esri) if esri else CRS.from_user_input(text)


def crs(request: dict[str, Any], payload: bytes) -> Answer:
    """Return the horizontal part of a coordinate reference system, its kind, and the accuracy of its datum shift."""
    found = crs_of(request["text"], request["esri"])
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
        "accuracy": accuracy(base, *request["site"]),
    }, b""


def accuracy(base: dict[str, Any], latitude: float, longitude: float) -> float | None:
    """Return the accuracy [m] of the best shift from a datum to WGS 84 without grids, by PROJ's database; None: none.

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


def transform(request: dict[str, Any], payload: bytes) -> Answer:
    """Return points in another coordinate reference system: x of all, then y; infinite beyond its area."""
    import numpy as np
    from rasterio.warp import transform as transformed

    x, y = np.frombuffer(payload, np.float64).reshape(2, -1)
    found = np.array(transformed(crs_of(request["from"]), crs_of(request["to"]), x, y)[:2], np.float64)
    return {}, found.tobytes()


REQUESTS: dict[str, Callable[[dict[str, Any], bytes], Answer]] = {
    "describe": describe,
    "read": read,
    "crs": crs,
    "transform": transform,
}


def reasons(error: BaseException | None) -> list[str]:
    """Return the messages of an error and of those that led to it."""
    found: list[str] = []
    while error is not None and len(found) < 10:
        found.append(f"{type(error).__name__}: {error}")
        error = error.__cause__ or error.__context__
    return found


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are no more."""
    while len(head := requests.read(HEAD.size)) == HEAD.size:
        length, size = HEAD.unpack(head)
        request = json.loads(requests.read(length))
        payload = requests.read(size)
        try:
            content, data = REQUESTS[request["ask"]](request, payload)
        except Exception as error:  # whatever GDAL makes of a file goes back as text
            content, data = {"error": reasons(error)}, b""
        text = json.dumps(content).encode()
        answers.write(HEAD.pack(len(text), len(data)) + text)
        answers.write(data)
        answers.flush()


if __name__ == "__main__":
    limit()
    warnings.simplefilter("ignore")
    # Libraries that print must not disturb the answers.
    own = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, own)
