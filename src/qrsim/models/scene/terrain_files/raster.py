"""The common form of terrain files: a grid of cells with a place on the Earth, and heights read by windows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError

Float64 = npt.NDArray[np.float64]
Heights = NumpyArray


@dataclass(frozen=True)
class Crs:
    """A horizontal coordinate reference system.

    Attributes:
        wkt: its definition, "EPSG:4326" for latitude and longitude of WGS 84.
        name: for messages.
        geographic: whether coordinates are longitude and latitude.
        accuracy: of the shift from its datum to WGS 84 without grids [m]; None: unknown; 0: below 2 m.
    """

    wkt: str
    name: str
    geographic: bool
    accuracy: float | None = 0.0

    @property
    def is_wgs84(self) -> bool:
        """True if the coordinates are longitude and latitude of WGS 84."""
        return self.wkt == "EPSG:4326"

    @property
    def unit(self) -> str:
        """Name of the coordinates' unit, for messages."""
        return "deg" if self.geographic else "m"


WGS84 = Crs("EPSG:4326", "EPSG:4326", True)


@dataclass(frozen=True)
class Grid:
    """The places of the cells of a raster.

    Attributes:
        rows, columns: numbers of cells.
        transform: (a, b, c, d, e, f) of x = a i + b j + c and y = d i + e j + f at column i and row j, counted from the
            outer corner of the first cell; its centre is at 0.5, 0.5.
        crs: of x and y.
    """

    rows: int
    columns: int
    transform: tuple[float, float, float, float, float, float]
    crs: Crs

    def place(self, row: Float64, column: Float64) -> tuple[Float64, Float64]:
        """Return map coordinates x and y of cell centres, by row and column of any shape."""
        a, b, c, d, e, f = self.transform
        return a * (column + 0.5) + b * (row + 0.5) + c, d * (column + 0.5) + e * (row + 0.5) + f

    def cell(self, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Return row and column of map points, any shape; whole numbers at cell centres."""
        a, b, c, d, e, f = self.transform
        size = a * e - b * d
        column, row = (e * (x - c) - b * (y - f)) / size, (a * (y - f) - d * (x - c)) / size
        return row - 0.5, column - 0.5

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances between rows and between columns, in the unit of the map coordinates."""
        a, b, _, d, e, _ = self.transform
        return math.hypot(b, e), math.hypot(a, d)


class Raster(Protocol):
    """Heights of one file."""

    @property
    def file(self) -> str:
        """Name of the raster's file, for messages."""
        ...

    @property
    def grid(self) -> Grid:
        """Grid of the raster's cells: shape, geotransform and coordinate reference system."""
        ...

    @property
    def note(self) -> str:
        """Message to the user about the unit from which heights were converted; "" if they are in metres."""
        ...

    @property
    def overviews(self) -> tuple[int, ...]:
        """Factors by which the file's overviews (reduced copies) are coarser than its cells."""
        ...

    def heights(self, rows: range, columns: range) -> Heights:
        """Return the heights [m] at rows and columns, NaN where they are missing."""
        ...

    def coarse(self, rows: range, columns: range) -> Heights:
        """Return one height [m] per block of cells (the ranges' steps), float32; ranges are multiples of their step."""
        ...


def grid_of(file: str, shape: tuple[int, int], transform: list[float], crs: Crs) -> Grid:
    """Return a file's grid from its shape and GDAL geotransform; raise UsageError if these are invalid.

    Raises:
        UsageError: too few cells, or a transform that has no inverse.
    """
    rows, columns = shape
    if rows < 2 or columns < 2:
        raise UsageError(f"{file}: has {rows} x {columns} heights; expected at least 2 x 2")
    a, b, c, d, e, f = transform
    # NaN fails this comparison too.
    if not (abs(a * e - b * d) > 0.0 and all(map(math.isfinite, transform))):
        raise UsageError(f"{file}: its geotransform {tuple(transform)} has no inverse")
    grid = Grid(rows, columns, (a, b, c, d, e, f), crs)
    if crs.geographic:
        x, y = grid.place(np.array([0.0, 0.0, rows - 1, rows - 1]), np.array([0.0, columns - 1, 0.0, columns - 1]))
        if max(abs(y)) > 90.0 + grid.spacing[0] or max(abs(x)) > 360.0 + grid.spacing[1]:
            raise UsageError(
                f"{file}: goes from latitude {min(y):.6g} to {max(y):.6g} and from longitude {min(x):.6g} to "
                f"{max(x):.6g}, which are no degrees of {crs.name}"
            )
    return grid


@dataclass(frozen=True)
class ArrayRaster:
    """A raster with its heights (rows, columns) [m] in memory, NaN where they are missing."""

    file: str
    grid: Grid
    array: Heights
    note: str = ""
    overviews: tuple[int, ...] = ()

    def heights(self, rows: range, columns: range) -> Heights:
        """Return the heights [m] at rows and columns, NaN where they are missing."""
        part = self.array[rows.start : rows.stop : rows.step, columns.start : columns.stop : columns.step]
        return part.astype(np.float64)

    def coarse(self, rows: range, columns: range) -> Heights:
        """Return the height [m] at the middle of each block of cells (the ranges' steps), float32."""
        half = rows.step // 2
        part = self.heights(
            range(rows.start + half, rows.stop, rows.step), range(columns.start + half, columns.stop, columns.step)
        )
        return part.astype(np.float32)
