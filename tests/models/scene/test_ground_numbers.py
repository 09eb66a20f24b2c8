"""The ground by hand: points of a file's grid, its horizon, who sees whom over a ridge, and normals at its edges."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.elevation import Elevations, Landscape
from qrsim.models.scene.elevation_file import ElevationFile, _points
from qrsim.models.scene.ground import GridGround
from qrsim.models.site import Site

# The Earth's mean radius [m].
RADIUS = 6_371_000.0


def vec(north: Any, east: Any, down: Any) -> Vec3:
    return Vec3(*np.broadcast_arrays(*(np.asarray(v, np.float32) for v in (north, east, down))))  # type: ignore[arg-type]


def grid(down: Any, corner: tuple[float, float] = (0.0, 0.0), spacing: tuple[float, float] = (1.0, 1.0)) -> GridGround:
    nothing: Any = np.zeros((8, 180), np.float32)
    return GridGround(np.asarray(down, np.float32), corner, spacing, nothing, (0.0, -200.0))  # type: ignore[arg-type]


class TestPoints:
    def land(self, frame: Any, rows: Any, columns: Any) -> Landscape:
        return Landscape(
            Elevations(frame, rows, columns, np.zeros((2, 2))), Site.from_degrees(60.0, 10.0), (0.0, 0.0), 0.0
        )

    def test_by_latitude_they_are_half_a_cell_apart(self) -> None:
        """0.001 degrees of a circle of the mean radius are 111.195 m, and as far are 0.002 of longitude at 60 north."""
        land = self.land("geodetic", 60.0 + 0.001 * np.arange(-9, 10), 10.0 + 0.002 * np.arange(-9, 10))
        rows, columns = _points("f", land, (0.0, 1000.0, 0.0, 500.0))
        # 1000 / 55.597 = 17.99 and 500 / 55.597 = 8.99 cells.
        assert (len(rows), len(columns)) == (19, 10)
        # Never fewer than two, the sides.
        rows, columns = _points("f", land, (0.0, 30.0, 5.0, 5.0))
        assert rows.tolist() == [0.0, 30.0]
        assert columns.tolist() == [5.0, 5.0]

    def test_no_more_than_four_millions(self) -> None:
        with pytest.raises(UsageError, match=r"4202500 points in world\.area; allowed: 4000000"):
            _points("f", self.land("local", np.arange(2050.0), np.arange(2050.0)), None)

    def test_a_limit_may_be_a_millionth_of_a_cell_off(self) -> None:
        land = self.land("local", 10.0 * np.arange(-5, 10), 10.0 * np.arange(-5, 10))
        for off, last in ((0.9e-5, 40.0), (1.1e-5, 50.0)):
            rows, columns = _points("f", land, (0.0, 40.0 + off, 0.0, 40.0 + off))
            assert (rows[-1], columns[-1]) == (last, last)


def ridge(path: Path, north: float, width: float = 0.0, height: float = 100.0) -> GridGround:
    """Level ground in steps of 100 m to 60 km north, and across it a ridge; it ends 200 m west and 400 m east."""
    rows, columns = 100.0 * np.arange(-10, 601), 100.0 * np.arange(-2, 5)
    up = np.where((rows >= north) & (rows <= north + width), height, 0.0)
    np.savez(path, north=rows, east=columns, height=up[:, None] + 0.0 * columns)
    return ElevationFile(str(path)).at(Site(), (-50.0, 50.0, -50.0, 50.0))


class TestHorizon:
    def test_of_level_ground(self, tmp_path: Path) -> None:
        """From a height h the horizon dips by sqrt(2 h / R); a wall beyond 50 km is not looked at."""
        ground = ridge(tmp_path / "a.npz", 50_500.0, 9500.0, 30_000.0)
        assert ground.horizon.shape == (8, 180)
        assert (float(ground.eyes[0]), float(ground.eyes[1])) == (-1.0, -201.0)
        horizon = np.asarray(ground.horizon)
        assert horizon[0, 0] == pytest.approx(-math.sqrt(2.0 / RADIUS), rel=1e-3)
        # From 201 m the horizon is 50.6 km away; at 50 km the ground is lower by 201 m and by 50 km^2 / 2 R.
        far = 201.0 + 50_000.0**2 / (2.0 * RADIUS)
        assert horizon[7, 0] == pytest.approx(-far / 50_000.0, rel=1e-3)
        # To the east the file ends after 400 m, and to the west after 200 m.
        assert horizon[0, 45] == pytest.approx(-(1.0 + 400.0**2 / (2.0 * RADIUS)) / 400.0, rel=1e-3)
        assert horizon[0, 135] == pytest.approx(-(1.0 + 200.0**2 / (2.0 * RADIUS)) / 200.0, rel=1e-3)

    def test_of_a_ridge_by_where_it_is_looked_at(self, tmp_path: Path) -> None:
        """Every quarter of a cell up to 199 of them, which meets its crest on a row; then 0.5 % farther each time.

        The crest at 5600 m is passed by 9.3 m at 199 * 25 m * exp(24 * 0.005).
        """
        passed = 4975.0 * math.exp(0.12)
        for crest, look in ((500.0, 500.0), (4900.0, 4900.0), (5600.0, passed)):
            horizon = np.asarray(ridge(tmp_path / f"{crest:g}.npz", crest).horizon)
            up = 100.0 * (1.0 - (look - crest) / 100.0) - 1.0 - look**2 / (2.0 * RADIUS)
            assert horizon[0, 0] == pytest.approx(up / math.hypot(up, look), rel=1e-4)

    def test_is_that_of_the_middle(self, tmp_path: Path) -> None:
        """Up 1 m in 10 to the north and down 1 m in 20 to the east: 0 in the middle at 20, 40; -4 in the north-west."""
        rows, columns = 10.0 * np.arange(-10, 11), 20.0 * np.arange(-5, 6)
        height = rows[:, None] / 10.0 - columns / 20.0
        np.savez(tmp_path / "a.npz", north=rows, east=columns, height=height)
        ground = ElevationFile(str(tmp_path / "a.npz")).at(Site(), (0.0, 40.0, 0.0, 80.0))
        np.testing.assert_allclose([float(eye) for eye in ground.eyes], [-1.0, -204.0], atol=1e-9)

    def test_between_eyes_and_bearings_it_is_interpolated(self) -> None:
        """Four bearings and eyes at 0, 10 and 20 m, by hand."""
        table: Any = np.array([[1, 2, 4, 8], [16, 32, 64, 128], [256, 512, 1024, 2048]], np.float32)
        ground = GridGround(np.zeros((2, 2)), (0.0, 0.0), (1.0, 1.0), table, (0.0, -20.0))  # type: ignore[arg-type]
        down = [-5.0, -5.0, -15.0, -30.0, 5.0, 5.0]
        bearing = np.radians([45.0, -45.0, 135.0, 202.5, 0.0])
        east = np.append(np.sin(bearing), -1e-9)[None]
        sight = vec(np.append(np.cos(bearing), 1.0)[None], east, 0.0)
        found = jax.jit(lambda place, to: ground.horizon_sine(place, to))(vec(0.0, 0.0, down), sight)
        expected = [(1.5 + 24.0) / 2, (4.5 + 72.0) / 2, (48.0 + 768.0) / 2, 0.75 * 1024 + 0.25 * 2048, 1.0, 1.0]
        np.testing.assert_allclose(found, [expected], rtol=1e-5)


class TestSight:
    def sight(self) -> Any:
        """Return a function of a ground and two places to whether one is seen from the other."""
        look = jax.jit(lambda ground, begin, end: ground.line_of_sight(begin, end)[0])

        def seen(ground: GridGround, begin: tuple[float, ...], end: tuple[float, ...]) -> bool:
            point: Any = Vec3(*(np.float32(part) for part in end))  # type: ignore[arg-type]
            return bool(look(ground, vec([begin[0]], begin[1], begin[2]), point))

        return seen

    def test_a_spike_hides_where_it_is_looked_at(self) -> None:
        """A way of 2048 m, half of it over cells of 1 m: of that 512 places, odd metres, and of all each 64 m."""
        seen = self.sight()
        for place, clear in ((95, False), (98, True), (192, False), (514, True), (1023, False)):
            down = np.zeros((1025, 2))
            down[place] = -100.0
            assert seen(grid(down), (0.0, 0.5, -10.0), (2048.0, 0.5, -10.0)) is clear

    def test_at_least_16_places_over_the_grid(self) -> None:
        """64 m of cells of 16 m, between looks 200 m apart: every 4 m, so 2 m beside a crest, 7/8 of its height."""
        seen = self.sight()
        down = np.zeros((5, 2))
        down[1] = -100.0
        for height, clear in ((91.0, True), (86.6, False)):
            ground = grid(down, (40.0, 0.0), (16.0, 16.0))
            assert seen(ground, (0.0, 8.0, -height), (6400.0, 8.0, -height)) is clear

    def test_edges(self) -> None:
        seen = self.sight()
        level = grid(np.zeros((1025, 2)), (11.0, 0.0))
        # Nothing behind what is looked at matters, and 0.1 m below the ground nobody is hidden.
        assert seen(level, (0.0, 0.5, -100.0), (10.0, 0.5, 0.0))
        assert seen(level, (12.0, 0.5, 0.09), (18.0, 0.5, 0.09))
        assert not seen(level, (12.0, 0.5, 0.11), (18.0, 0.5, 0.11))
        # Along the western edge itself.
        assert seen(level, (12.0, 0.0, -1.0), (18.0, 0.0, -1.0))
        # A way that goes 1.1 micrometres to the east does not come over the grid, so its cells are not looked at.
        down = np.zeros((1025, 2))
        down[95] = -100.0
        beside = grid(down, (0.0, 5.0))
        assert seen(beside, (0.0, 0.0, -10.0), (2048.0, 1.1e-6, -10.0))
        assert not seen(beside, (0.0, 0.0, -10.0), (2048.0, 0.0, -10.0))


def test_the_normal_beyond_an_edge_is_that_of_the_last_cell() -> None:
    """Corners 0, 4 in the south and 2, 10 in the north; at its northern edge: slopes 0.4 and 0.8, by hand."""
    ground = grid([[0.0, 4.0], [2.0, 10.0]], spacing=(10.0, 10.0))
    for north in (10.0, 99.0):
        found = np.asarray(ground.normal(vec(north, 5.0, 0.0)).stack())
        np.testing.assert_allclose(found, np.array([0.4, 0.8, -1.0]) / math.sqrt(1.8), rtol=1e-6)
    # At the eastern edge 0.8 to the north, and 0.6 to the east in the middle of it.
    for east in (10.0, 99.0):
        found = np.asarray(ground.normal(vec(5.0, east, 0.0)).stack())
        np.testing.assert_allclose(found, np.array([0.6, 0.6, -1.0]) / math.sqrt(1.72), rtol=1e-6)
