"""Requests to GDAL and PROJ, which run in a separate process, so that a crash there is an error of the file."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, shortened
from qrsim.extras import require
from qrsim.files import Content
from qrsim.files.in_child import MEMORY, Child, ChildError
from qrsim.models.scene.terrain_files import gdal_requests

Float64 = npt.NDArray[np.float64]
T = TypeVar("T")

# Nothing but the file itself is opened, and nothing is fetched.
SETTINGS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_PAM_ENABLED": "NO",
    "GDAL_HTTP_TIMEOUT": "1",
    "GDAL_CACHEMAX": "64",
    "GDAL_NUM_THREADS": "1",
    "VSI_CACHE": "FALSE",
    "PROJ_NETWORK": "OFF",
}


class GdalError(UsageError):
    """GDAL or PROJ refused a request.

    Attributes:
        reasons: its messages, the outermost first.
    """

    def __init__(self, text: str, reasons: tuple[str, ...]):
        super().__init__(text)
        self.reasons = reasons


class Gdal:
    """A process with GDAL and PROJ, started by the first request and ended by ``with``.

    Each request names the file that it is about, for messages.
    """

    def __init__(self) -> None:
        self.child = Child(settings=SETTINGS)

    def __enter__(self) -> Gdal:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.__exit__()

    def describe(self, file: str, driver: str) -> Content:
        """Return a raster file's header by GDAL: bands, dtype, shape, transform, WKT, unit, overviews, palette."""
        return self._ask(file, gdal_requests.describe, _path(file), driver)

    def read(
        self,
        file: str,
        driver: str,
        rows: range,
        columns: range,
        *,
        coarse: bool,
        metres: float = 1.0,
        nodata: tuple[float, ...] = (),
    ) -> NumpyArray:
        """Return the heights [m] in a window (rows, columns) of a raster file, NaN where they are missing.

        Args:
            file: its path.
            driver: GDAL's name of its format.
            rows: of the window, with a step.
            columns: of the window, with the same step.
            coarse: True returns a height (float32) for each whole block of cells, from overviews if the file has
                them; False returns the heights at the given rows and columns (float64).
            metres: of a unit of height.
            nodata: further values for missing heights.
        """
        return self._ask(file, gdal_requests.read, _path(file), driver, rows, columns, coarse, metres, nodata)

    def crs(self, file: str, text: str, site: tuple[float, float], esri: bool = False) -> Content:
        """Return wkt, name, kind, wgs84 and accuracy of a reference system (EPSG:n or WKT), near a site [deg]."""
        return self._ask(file, gdal_requests.crs, text, site, esri)

    def transform(self, file: str, source: str, target: str, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Return x and y, any shape, in another reference system; longitude and latitude [deg] if geographic."""
        found = self._ask(file, gdal_requests.transform, source, target, x.ravel(), y.ravel()).reshape(2, *x.shape)
        return found[0], found[1]

    def _ask(self, file: str, function: Callable[..., T], *arguments: object) -> T:
        """Return a function's result from the GDAL child process; raise UsageError, naming the file, if it fails."""
        require("terrain", f"reading {file}", "rasterio")
        try:
            return self.child.call(function, *arguments)
        except ChildError as error:
            raise _refusal(file, error) from None


def _path(file: str) -> str:
    """Return a file's absolute path, with ``~`` expanded."""
    return os.path.abspath(os.path.expanduser(file))


def _refusal(file: str, error: ChildError) -> UsageError:
    """Return the UsageError, with a readable reason, for GDAL's failure ``error`` with a file."""
    reasons = error.reasons
    if not reasons:
        return UsageError(f"{file}: cannot be read: {error}")
    if any("out of memory" in reason.lower() for reason in reasons):
        return GdalError(f"{file}: cannot be read: it needs more than {MEMORY / 2**30:g} GB of memory", reasons)
    if broken := next((each for each in reasons if each.startswith(("ImportError", "ModuleNotFoundError"))), None):
        # No fault of the file or of a code, so no GdalError.
        return UsageError(f"{file}: cannot be read: rasterio does not work here: {shortened(broken, 200)}")
    for reason in reasons:
        if block := re.search(r"X offset (\d+), Y offset (\d+)", reason):
            return GdalError(f"{file}: cannot be read: block ({block[2]}, {block[1]}) is damaged", reasons)
    inner = reasons[-1].partition(": ")[2].replace(_path(file), Path(file).name)
    return GdalError(f"{file}: cannot be read: {shortened(inner or reasons[-1], 200)}", reasons)
