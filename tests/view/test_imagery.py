"""Pictures of the ground from files: which pixel is where, and what is refused."""

from __future__ import annotations

import io
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from qrsim.errors import UsageError
from qrsim.models.site import Site
from qrsim.view.frame import Cast
from qrsim.view.image_files import read_geotiff, read_mbtiles
from qrsim.view.imagery import Imagery, places_in, read_imagery

# Around 51.7 N, 0.2 W: south, west, north, east.
BOX = (51.70, -0.21, 51.72, -0.19)
pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning:rasterio")
RED, BLUE = (255, 0, 0), (0, 0, 255)


def tiff(path: Path, colours: np.ndarray, crs: str | None = "EPSG:4326", east: float = 0.0) -> str:
    """Write a GeoTIFF of bands (B, rows, columns) over the box, moved to the east [deg]."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import from_bounds

    bands, rows, columns = colours.shape
    grid = from_bounds(BOX[1] + east, BOX[0], BOX[3] + east, BOX[2], columns, rows)
    options = {"width": columns, "height": rows, "count": bands, "dtype": colours.dtype, "crs": crs, "transform": grid}
    with rasterio.open(path, "w", driver="GTiff", **options) as file:
        file.write(colours)
    return str(path)


def halves() -> np.ndarray:
    """Return bands of a picture with a red north and a blue south."""
    found = np.zeros((3, 20, 20), np.uint8)
    found[0, :10] = found[2, 10:] = 255
    return found


def test_a_geotiff_is_read_where_it_is_asked_for(tmp_path: Path) -> None:
    path = tiff(tmp_path / "a.tif", halves())
    pixels = read_geotiff(path, BOX, (40, 30))
    assert pixels.shape == (40, 30, 4)
    assert pixels[2, 15].tolist() == [*RED, 255]
    assert pixels[37, 15].tolist() == [*BLUE, 255]
    # A box that reaches farther west has nothing there.
    wider = read_geotiff(path, (BOX[0], BOX[1] - 0.02, BOX[2], BOX[3]), (40, 40))
    assert wider[5, 5, 3] == 0
    assert wider[5, 35].tolist() == [*RED, 255]


def test_grey_and_sixteen_bits_become_colours(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(1000, 3000, 20, dtype=np.uint16), (1, 20, 1))
    pixels = read_geotiff(tiff(tmp_path / "grey.tif", ramp), BOX, (20, 20))
    assert pixels[10, 0, :3].tolist() == [0, 0, 0]
    assert pixels[10, 19, :3].tolist() == [255, 255, 255]
    assert 110 < pixels[10, 10, 0] < 150


@pytest.mark.parametrize(
    ("bands", "crs", "east", "said"),
    [
        (3, "EPSG:4326", 5.0, "it shows another place, 51.7100, 4.8000; the run is at 51.7100, -0.2000"),
        (3, None, 0.0, "it has no coordinate reference system"),
        (5, "EPSG:4326", 0.0, "it has 5 bands; expected 1"),
    ],
)
def test_what_is_no_picture_of_the_place_is_refused(
    bands: int, crs: str | None, east: float, said: str, tmp_path: Path
) -> None:
    path = tiff(tmp_path / "a.tif", np.full((bands, 4, 4), 9, np.uint8), crs, east)
    with pytest.raises(UsageError) as error:
        read_geotiff(path, BOX, (10, 10))
    assert said in str(error.value)


def tiles(path: Path, data: bytes, zoom: int = 14) -> str:
    """Write an MBTiles file with one tile, that of 51.71 N, 0.2 W at zoom 14: column 8182, row 5433 from the north."""
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data)")
        database.execute("INSERT INTO tiles VALUES (?, 8182, ?, ?)", (zoom, 2**14 - 1 - 5433, data))
    database.close()
    return str(path)


def test_tiles_are_read_from_a_file(tmp_path: Path) -> None:
    picture = np.zeros((256, 256, 3), np.uint8)
    picture[:128], picture[128:] = RED, BLUE
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG")
    # The tile reaches from 51.6998 to 51.7134 N and from 0.2197 to 0.1978 W.
    pixels = read_mbtiles(tiles(tmp_path / "a.mbtiles", data.getvalue()), (51.702, -0.215, 51.712, -0.205), (50, 50))
    assert pixels[2, 25].tolist() == [*RED, 255]
    assert pixels[47, 25].tolist() == [*BLUE, 255]
    with pytest.raises(UsageError, match="its tiles are no pictures"):
        read_mbtiles(tiles(tmp_path / "b.mbtiles", b"<svg onload=alert(1)>"), (51.702, -0.215, 51.712, -0.205), (9, 9))
    with pytest.raises(UsageError, match=r"it has no tile of zoom 14 at 11\.0000"):
        read_mbtiles(str(tmp_path / "a.mbtiles"), (10.99, 10.99, 11.01, 11.01), (9, 9))
    (tmp_path / "c.mbtiles").write_text("name: hills", "utf-8")
    with pytest.raises(UsageError, match="it is no MBTiles file"):
        read_mbtiles(str(tmp_path / "c.mbtiles"), BOX, (9, 9))


def test_corners_are_at_their_places_in_the_picture() -> None:
    site = Site.from_degrees(51.71, -0.20)
    imagery = Imagery(np.zeros((2, 2, 4), np.uint8), BOX, np.zeros((2, 2)), site)
    # The middle, and a place 1000 m to the north: 0.008989 deg of 0.02 deg (a degree has 111.25 km there).
    found = places_in(imagery, np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0]], np.float32))
    np.testing.assert_allclose(found, [[0.5, 0.5], [0.5, 0.5 + 0.4494]], atol=2e-4)


def test_a_wrong_name_and_a_run_without_a_place_are_refused(tmp_path: Path) -> None:
    cast = Cast(("a",), np.zeros(1, int), np.zeros((1, 3)))
    with pytest.raises(UsageError, match=r"photo\.jpg: expected a name that ends in \.tif"):
        read_imagery(tmp_path / "photo.jpg", cast, None)
    with pytest.raises(UsageError, match="does not say where on the Earth"):
        read_imagery(tmp_path / "photo.tif", cast, None)
