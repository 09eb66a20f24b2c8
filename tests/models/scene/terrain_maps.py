"""One hill of known shape, written in every format of terrain that is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from qrsim.core.vectors import Vec3
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.site import Site

LATITUDE, LONGITUDE = 51.7119, -0.21052
SITE = Site.from_degrees(LATITUDE, LONGITUDE)
# Metres of a degree on WGS 84 at this latitude, near enough for the shape of a hill.
NORTH_M, EAST_M = 111_260.0, 69_120.0
BOX = (-500.0, 500.0, -500.0, 500.0)


def hill(latitude: Any, longitude: Any) -> Any:
    """Return the height [m]: 40 m over a slope, 300 m north-east of the site; its curvature is at most 2.5e-4 / m."""
    north, east = (latitude - LATITUDE) * NORTH_M, (longitude - LONGITUDE) * EAST_M
    top = 40.0 * np.exp(-((north - 200.0) ** 2 + (east - 220.0) ** 2) / (2.0 * 400.0**2))
    return 100.0 + 0.03 * north - 0.02 * east + top


def geotiff(
    path: Path,
    crs: str,
    spacing: float,
    *,
    dtype: str = "float32",
    reach: float = 900.0,
    centre: tuple[float, float] = (LATITUDE, LONGITUDE),
    turn_deg: float = 0.0,
    change: Any = None,
    tags: dict[str, Any] | None = None,
    tagged: bool = True,
    **profile: Any,
) -> str:
    """Write the hill around a place on a map whose unit is metres or degrees; ``reach`` and spacing are in metres."""
    import rasterio
    from rasterio.warp import transform

    degrees = crs in ("EPSG:4326", "EPSG:4979", "EPSG:4258", "EPSG:4269")
    (x,), (y,) = transform("EPSG:4326", crs, [centre[1]], [centre[0]])[:2]
    dx, dy = (spacing / EAST_M, spacing / NORTH_M) if degrees else (spacing, spacing)
    n = 2 * int(reach / spacing)
    cell = rasterio.Affine.translation(x, y) @ rasterio.Affine.rotation(turn_deg) @ rasterio.Affine.scale(dx, -dy)
    place = cell @ rasterio.Affine.translation(-n / 2, -n / 2)
    columns, rows = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    xs, ys = place @ (columns, rows)
    longitude, latitude = transform(crs, "EPSG:4326", xs.ravel(), ys.ravel())[:2]
    heights = hill(np.array(latitude), np.array(longitude)).reshape(n, n)
    heights = heights if change is None else change(heights)
    data = (np.rint(heights) if dtype.startswith(("int", "uint")) else heights).astype(dtype)
    profile = {"count": 1, "crs": crs if tagged else None, "transform": place, **profile}
    with rasterio.open(path, "w", driver="GTiff", width=n, height=n, dtype=dtype, **profile) as file:
        for band in range(1, profile["count"] + 1):
            file.write(data, band)
        for name, value in (tags or {}).items():
            setattr(file, name, value)
    return str(path)


def hgt(path: Path, change: Any = None) -> str:
    """Write the hill as an SRTM tile of 3 seconds of arc, N51W001."""
    steps = np.arange(1201) / 1200.0
    heights = np.rint(hill((52.0 - steps)[:, None], (-1.0 + steps)[None, :]))
    # Far away the slope is no terrain.
    heights = np.clip(heights, -400, 4000)
    (heights if change is None else change(heights)).astype(">i2").tofile(path)
    return str(path)


def ascii_grid(path: Path, x: Any, y: Any, heights: Any, wkt: str | None = None) -> str:
    """Write an ESRI ASCII grid with centres of cells at x, to the east, and y, to the north; and its .prj."""
    head = f"ncols {len(x)}\nnrows {len(y)}\nxllcenter {x[0]!r}\nyllcenter {y[0]!r}\ncellsize {x[1] - x[0]!r}\n"
    rows = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in heights[::-1])
    path.write_text(head.replace("np.float64(", "").replace(")", "") + rows + "\n")
    if wkt is not None:
        path.with_suffix(".prj").write_text(wkt)
    return str(path)


def vrt(path: Path, *names: str, inner: str = "", kind: str = "SimpleSource") -> str:
    """Write a virtual raster of files in its folder, as gdalbuildvrt does."""
    sources = "".join(
        f'<{kind}><SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>{inner}</{kind}>'
        for name in names
    )
    path.write_text(
        '<VRTDataset rasterXSize="10" rasterYSize="10"><SRS>EPSG:4326</SRS><VRTRasterBand dataType="Float32" band="1">'
        f"<NoDataValue>-32767</NoDataValue>{sources}</VRTRasterBand></VRTDataset>"
    )
    return str(path)


def utm_ascii(path: Path, prj: bool = True) -> str:
    """Write the hill in UTM zone 30."""
    from rasterio.crs import CRS
    from rasterio.enums import WktVersion
    from rasterio.warp import transform

    (x0,), (y0,) = transform("EPSG:4326", "EPSG:32630", [LONGITUDE], [LATITUDE])
    x, y = np.round(x0) + 20.0 * np.arange(-45, 46), np.round(y0) + 20.0 * np.arange(-45, 46)
    xs, ys = np.meshgrid(x, y)
    longitude, latitude = transform("EPSG:32630", "EPSG:4326", xs.ravel(), ys.ravel())
    heights = hill(np.array(latitude), np.array(longitude)).reshape(91, 91)
    wkt = CRS.from_epsg(32630).to_wkt(version=WktVersion.WKT1_ESRI)
    return ascii_grid(path, x.tolist(), y.tolist(), heights, wkt if prj else None)


RNG = np.random.default_rng(5)
NORTH, EAST = RNG.uniform(-500.0, 500.0, (2, 1000))


def down(file: Any, box: Any = BOX, site: Site = SITE, **settings: Any) -> Any:
    """Return the down coordinate at the 1000 places."""
    ground = ElevationFile(file, **settings).at(site, box)
    return np.asarray(ground.down(Vec3(NORTH, EAST, 0.0 * NORTH)), np.float64)  # type: ignore[arg-type]
