"""Limits of elevation files by hand: header, frames, edges, longitudes beyond 180 degrees, and cover."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.models.scene.elevation import Elevations, Landscape, landscape, read_elevations
from qrsim.models.site import Site


def asc(path: Path, cellsize: str, rows: list[list[float]], pad: str = "") -> str:
    """Write an ESRI ASCII grid whose cellsize comes last in the header."""
    text = f"ncols {len(rows[0])}\nnrows {len(rows)}\nxllcenter 0\nyllcenter 0{pad}\ncellsize {cellsize}\n"
    path.write_text(text + "\n".join(" ".join(map(str, row)) for row in rows) + "\n")
    return str(path)


def archive(path: Path, north: Any, east: Any, names: tuple[str, str] = ("north", "east")) -> str:
    """Write level ground at these points."""
    height: Any = np.zeros((len(north), len(east)))
    content: dict[str, Any] = {names[0]: np.asarray(north, float), names[1]: np.asarray(east, float), "height": height}
    np.savez(path, **content)
    return str(path)


DEGREES = ("latitude_deg", "longitude_deg")
TWO = [[1.0, 2.0], [3.0, 4.0]]


def test_cells_below_a_tenth_are_degrees(tmp_path: Path) -> None:
    for number, (cellsize, frame) in enumerate((("0.099", "geodetic"), ("0.11", "local"))):
        assert read_elevations(asc(tmp_path / f"{number}.asc", cellsize, TWO), "auto").frame == frame


def test_the_header_is_within_4096_bytes(tmp_path: Path) -> None:
    assert read_elevations(asc(tmp_path / "a.asc", "10", TWO, pad=" " * 3900), "auto").frame == "local"
    with pytest.raises(UsageError, match="header has no 'cellsize'"):
        read_elevations(asc(tmp_path / "b.asc", "10", TWO, pad=" " * 4400), "auto")


def test_a_grid_of_more_heights_than_words_in_its_header(tmp_path: Path) -> None:
    """Without a word on it, -9999 is no height (the format's default)."""
    rows = [[100.0 * i + j for j in range(6)] for i in range(6)]
    rows[0][5] = -9999.0
    rows[1][5] = -11998.8
    rows[2][5] = 9999.0
    found = read_elevations(asc(tmp_path / "a.asc", "10", rows), "auto")
    assert found.height.shape == (6, 6)
    assert found.height[0, 1] == 501.0
    assert np.argwhere(np.isnan(found.height)).tolist() == [[5, 5]]


@pytest.mark.parametrize("word", ["nan", "NaN", "-nan"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"], ids=["plain", "marked"])
def test_no_height_may_be_nan_and_the_file_may_begin_with_a_mark(tmp_path: Path, word: str, mark: bytes) -> None:
    path = tmp_path / "a.asc"
    header = f"ncols 3\r\nnrows 2\r\nxllcenter 0\r\nyllcenter 0\r\ncellsize 10\r\nNODATA_value {word}\r\n"
    path.write_bytes(mark + f"{header}{word} 1 2\r\n3 {word} 5\r\n".encode())
    found = read_elevations(str(path), "auto").height
    np.testing.assert_array_equal(found, [[3.0, np.nan, 5.0], [np.nan, 1.0, 2.0]])
    path.write_text(header.replace(word, "none") + "1 1 2\n3 4 5\n")
    with pytest.raises(UsageError, match="'nodata_value' of its header is 'none'; expected a number"):
        read_elevations(str(path), "auto")


def test_what_is_no_grid(tmp_path: Path) -> None:
    wrong: Any = (
        ([0.0], [0.0, 1.0], ("north", "east"), "no two or more"),
        ([], [0.0, 1.0], ("north", "east"), "two or more|shape|empty"),
        ([0.0, 1.0], [], ("north", "east"), "two or more|shape|empty"),
        # Steps of 1 and 1.0011: they differ by more than a thousandth.
        ([0.0, 1.0, 2.0011], [0.0, 1.0], ("north", "east"), "evenly"),
        ([80.0, 100.0], [0.0, 1.0], DEGREES, "no degrees"),
        ([80.0, 90.0], [390.0, 400.0], DEGREES, "no degrees"),
    )
    for number, (north, east, names, message) in enumerate(wrong):
        with pytest.raises(UsageError, match=message):
            read_elevations(archive(tmp_path / f"{number}.npz", north, east, names), "auto")
    # Steps that differ by 0.9 thousandths are even enough, and so are the poles and 360 degrees.
    read_elevations(archive(tmp_path / "even.npz", [0.0, 1.0, 2.0009], [0.0, 1.0]), "auto")
    read_elevations(archive(tmp_path / "pole.npz", [80.0, 90.0], [350.0, 360.0], DEGREES), "auto")
    for line in ("ncols 1\nnrows 2\n", "ncols 2\nnrows 1\n"):
        (tmp_path / "one.asc").write_text(line + "xllcenter 0\nyllcenter 0\ncellsize 1\n1 2\n")
        with pytest.raises(UsageError, match="at least 2"):
            read_elevations(str(tmp_path / "one.asc"), "auto")


def test_two_rows_and_columns_backwards_are_turned(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", north=[5.0, 0.0], east=[7.0, 0.0], height=[[1.0, 2.0], [3.0, 4.0]])
    found = read_elevations(str(tmp_path / "a.npz"), "auto")
    assert found.rows.tolist() == [0.0, 5.0]
    assert found.columns.tolist() == [0.0, 7.0]
    assert found.height.tolist() == [[4.0, 3.0], [2.0, 1.0]]


def test_a_millionth_of_a_cell_beyond_the_edge_is_on_it() -> None:
    land = Elevations("local", np.arange(3.0), np.arange(3.0), np.full((3, 3), 1e6))
    on, beyond = 0.9e-6, 1.1e-6
    rows = np.array([-on, 2.0 + on, 1.0, 1.0])
    found = land.at(rows, rows[::-1])
    # The height of the edge itself, not one beyond.
    np.testing.assert_array_equal(found, 1e6)
    for off in (-beyond, 2.0 + beyond, 2.5, 3.5):
        assert np.isnan(land.at(np.array(off), np.array(1.0)))
        assert np.isnan(land.at(np.array(1.0), np.array(off)))


def test_longitudes_that_count_to_360() -> None:
    """Heights that are longitudes, all around the Earth: 10 degrees west is 350, and 5 degrees east is 5."""
    columns = np.arange(361.0)
    around = Elevations("geodetic", np.arange(-2.0, 3.0), columns, np.broadcast_to(columns, (5, 361)))
    for longitude, counted in ((-10.0, 350.0), (5.0, 5.0), (100.0, 100.0)):
        land = Landscape(around, Site.from_degrees(0.0, longitude), (0.0, 0.0), 0.0)
        assert float(land.down(np.array(0.0), np.array(0.0))) == pytest.approx(-counted, abs=1e-6)


def test_a_box_must_be_covered_but_for_a_millionth_of_a_cell(tmp_path: Path) -> None:
    """Cells of 10 m: 0.01 mm."""
    file = archive(tmp_path / "a.npz", [0.0, 10.0, 20.0], [0.0, 10.0, 20.0])
    for off, refused in ((0.9e-5, False), (1.1e-5, True)):
        for box in (
            (-off, 20.0, 0.0, 20.0),
            (0.0, 20.0 + off, 0.0, 20.0),
            (0.0, 20.0, -off, 20.0),
            (0.0, 20.0, 0.0, 20.0 + off),
        ):
            if refused:
                with pytest.raises(UsageError, match=r"covers .* needs"):
                    landscape(file, "local", Site(), (0.0, 0.0), 0.0, box)
            else:
                landscape(file, "local", Site(), (0.0, 0.0), 0.0, box)


def test_a_side_of_a_box_is_looked_at_every_eighth(tmp_path: Path) -> None:
    """A side straight to the east is farthest north where it is nearest: there the file ends too early by 20 m.

    Its eighths are 100 km, and the second look is at the origin, at 60 degrees north; 20 km off, the tangent to the
    parallel is already 20 000^2 tan(60) / (2 * 6 371 000) = 54 m south of it.
    """
    file = archive(tmp_path / "a.npz", np.linspace(50.0, 59.9998, 5), np.linspace(0.0, 40.0, 5), DEGREES)
    box = (-100_000.0, 0.0, -100_000.0, 700_000.0)
    with pytest.raises(UsageError, match=r"to 60 and"):
        landscape(file, "geodetic", Site.from_degrees(60.0, 10.0), (0.0, 0.0), 0.0, box)
