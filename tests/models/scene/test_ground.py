"""The ground: heights above it, its normal, its horizon, elevations from files, and who is told of it."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.noise import Key
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.scene.ground import FlatGround, GridGround
from qrsim.models.site import Site
from qrsim.models.vehicles.contracts import Pose
from qrsim.scenarios.making import make_scenario, make_world
from qrsim.world.air import around_of
from qrsim.world.episode import surroundings
from qrsim.world.tick import reset

POINTS = Vec3(*np.array([[0.0, 3.0], [0.0, -4.0], [-12.5, 6.0]]))  # type: ignore[arg-type]
STILL = Vec3(*np.zeros((3, 2), np.float32))  # type: ignore[arg-type]
LEVEL = Pose(STILL, Euler(*np.zeros((3, 2), np.float32)), STILL, STILL)  # type: ignore[arg-type]
AREA = {"type": "box", "x_min": -50, "x_max": 50, "y_min": -40, "y_max": 40}
BOX = (-50.0, 50.0, -40.0, 40.0)
SITE = Site()


class TestFlat:
    def test_is_z_0_unless_told_otherwise(self):
        np.testing.assert_array_equal(FlatGround().down(POINTS), [0.0, 0.0])
        np.testing.assert_array_equal(FlatGround(height=7.0).down(POINTS), [-7.0, -7.0])
        assert FlatGround().at_zero
        assert not FlatGround(height=7.0).at_zero
        # Between two above it there is nothing; there may be a hill.
        assert FlatGround.flat
        assert not GridGround.flat

    def test_heights_of_a_world_are_counted_from_it(self):
        for height, expected in ((0.0, [12.5, -6.0]), (7.0, [5.5, -13.0])):
            world = make_world([[0.0, 0.0, -20.0]], ground={"type": "flat", "height": height})
            np.testing.assert_allclose(world.height_agl(POINTS), expected)
            np.testing.assert_allclose(world.ground_down(POINTS), [-height, -height])
            down, normal = around_of(world, LEVEL, None).ground(POINTS)
            np.testing.assert_allclose(down, [-height, -height])
            np.testing.assert_array_equal(normal.stack(), [[0.0, 0.0, -1.0]] * 2)

    def test_the_wind_counts_its_height_from_the_ground(self):
        # 4 m above the ground, wherever that is: 5 m/s times ln(4 / z0) / ln(6.096 / z0), z0 = 0.15 ft.
        expected = 5.0 * math.log(4.0 / 0.04572) / math.log(6.096 / 0.04572)
        for height in (0.0, 16.0):
            simulation = qrsim.Simulation(
                make_world(
                    [[0.0, 0.0, -height - 4.0]],
                    ground={"type": "flat", "height": height},
                    wind={"type": "log_shear", "speed_20ft": 5.0, "wind_from_rad": math.pi},
                )
            )
            simulation.reset()
            np.testing.assert_allclose(simulation.state.fleets[0].mean_wind_ned.x, [expected], rtol=1e-5)


def slope(tmp_path: Path, **changes: Any) -> str:
    """Write a slope that rises 1 m in 10 m to the north and falls 1 m in 20 m to the east, 105 m high at the origin."""
    north, east = 10.0 * np.arange(-10, 11), 20.0 * np.arange(-5, 6)
    height = 105.0 + north[:, None] / 10.0 - east[None, :] / 20.0
    content = {"north": north, "east": east, "height": height} | changes
    np.savez(tmp_path / "slope.npz", **{name: value for name, value in content.items() if value is not None})
    return str(tmp_path / "slope.npz")


def at(north: Any, east: Any, down: Any = 0.0) -> Any:
    return Vec3(*np.broadcast_arrays(*(np.asarray(v, float) for v in (north, east, down))))  # type: ignore[arg-type]


class TestGrid:
    def test_is_bilinear_and_its_origin_is_z_0(self):
        # One cell by hand: corners 0, 4 in the south and 2, 10 in the north; a quarter to the north, half to the east:
        # 2 + (6 - 2) / 4 = 3.
        grid = GridGround(
            np.array([[0.0, 4.0], [2.0, 10.0]]),
            (0.0, 0.0),
            (10.0, 10.0),
            np.zeros((8, 180)),
            (0.0, -200.0),  # type: ignore[arg-type]
        )
        np.testing.assert_allclose(grid.down(at(2.5, 5.0)), 3.0)
        np.testing.assert_allclose(grid.down(at([0.0, 10.0, -9.0, 99.0], [10.0, 0.0, -9.0, 99.0])), [4, 2, 0, 10])
        # Slopes there: to the north (2 + 6)/2 / 10 = 0.4, to the east (4 + (8 - 4)/4) / 10 = 0.5.
        normal = grid.normal(at(2.5, 5.0)).stack()
        np.testing.assert_allclose(normal, np.array([0.4, 0.5, -1.0]) / math.sqrt(1.41), rtol=1e-6)

    def test_of_a_file(self, tmp_path: Path):
        ground = ElevationFile(slope(tmp_path)).at(SITE, BOX)
        np.testing.assert_allclose(ground.down(at([0.0, 33.0, -50.0], [0.0, -7.0, 40.0])), [0.0, -3.65, 7.0], atol=1e-5)
        normal = np.array([-0.1, 0.05, -1.0]) / math.sqrt(1.0125)
        np.testing.assert_allclose(ground.normal(at(3.0, 4.0)).stack(), normal, rtol=1e-5)
        assert not ground.at_zero
        # Points beyond the cells of the area are left out: rows -50 to 50, columns -40 to 40.
        assert ground.grid.shape == (11, 5)

    def test_height_of_zero_and_an_origin_of_its_own(self, tmp_path: Path):
        file = slope(tmp_path, north=5e6 + 10.0 * np.arange(-10, 11), east=4e5 + 20.0 * np.arange(-5, 6))
        ground = ElevationFile(file, origin_north=5e6, origin_east=4e5, height_of_zero=100.0).at(SITE, BOX)
        np.testing.assert_allclose(ground.down(at([0.0, 50.0], [0.0, 0.0])), [-5.0, -10.0], atol=1e-4)

    def test_esri_ascii_grids_from_north_to_south(self, tmp_path: Path):
        text = "ncols 3\nnrows 2\nxllcorner -150\nyllcorner -100\ncellsize 100\nNODATA_value -1\n7 8 9\n1 2 3\n"
        (tmp_path / "a.asc").write_text(text)
        box = (-50.0, 50.0, -100.0, 100.0)
        ground = ElevationFile(str(tmp_path / "a.asc"), height_of_zero=0.0).at(SITE, box)
        # The corner of the south-western cell; its middle is at north -50, east -100.
        np.testing.assert_allclose(ground.down(at([-50, -50, 50, 0], [-100, 100, 0, 0])), [-1, -3, -8, -5], atol=1e-6)

    def test_latitude_and_longitude(self, tmp_path: Path):
        # 1 m up per 0.001 degrees north: a degree of latitude is 111.26 km at 51.7 degrees (WGS 84).
        latitude, longitude = 51.7119 + 0.0005 * np.arange(-9, 10), -0.21052 + 0.0005 * np.arange(-9, 10)
        height = (latitude - 51.7119)[:, None] * 1000.0 + 0.0 * longitude[None, :]
        np.savez(tmp_path / "b.npz", latitude_deg=latitude[::-1], longitude_deg=longitude, height=height[::-1])
        ground = ElevationFile(str(tmp_path / "b.npz"), frame="geodetic").at(Site.from_degrees(51.7119, -0.21052), BOX)
        np.testing.assert_allclose(ground.down(at([0.0, 44.5], [0.0, 20.0])), [0.0, -0.4], atol=2e-4)

    def test_every_second_point_and_missing_heights_filled(self, tmp_path: Path):
        file = slope(tmp_path)
        ground = ElevationFile(file, every=2).at(SITE, BOX)
        # Rows every 20 m, columns every 40 m, still of a plane.
        assert ground.grid.shape == (7, 4)
        np.testing.assert_allclose(ground.down(at([0.0, 33.0], [0.0, -7.0])), [0.0, -3.65], atol=1e-5)
        # At north 10, east 20: the nearest points differ by 1 m.
        item = ElevationFile(slope(tmp_path, height=np.where(without(127) == 1.0, 105.0, np.nan)), missing="fill")
        np.testing.assert_allclose(item.at(SITE, BOX).down(at(10.0, 20.0)), 0.0)
        assert item.notes(SITE, BOX)[0].endswith(
            "slope.npz: 1 missing heights are those of the nearest cells, at most 5 away"
        )

    @pytest.mark.long
    def test_the_horizon_is_what_stands_in_the_way(self, tmp_path: Path):
        # Up 100 m, 500 m to the north, all the way from east to west.
        north, east = 50.0 * np.arange(-20, 21), 50.0 * np.arange(-20, 21)
        height = np.where(north[:, None] >= 500.0, 100.0, 0.0) + 0.0 * east[None, :]
        np.savez(tmp_path / "wall.npz", north=north, east=east, height=height)
        ground = ElevationFile(str(tmp_path / "wall.npz")).at(SITE, BOX)
        bearings = ([1.0, 0.0, 0.7071], [0.0, 1.0, 0.7071], [0.0, 0.0, 0.0])
        sight = Vec3(*(jnp.stack([jnp.asarray(v)] * 2, axis=1) for v in bearings))
        seen = np.asarray(ground.horizon_sine(at([0.0, 0.0], [0.0, 0.0], [0.0, -100.0]), sight))
        # atan(100/500) to the north and atan(100/707) to the north-east from the ground; level from the top.
        expected = [100.0 / math.hypot(100.0, 500.0), 0.0, 100.0 / math.hypot(100.0, 707.1)]
        np.testing.assert_allclose(seen[:, 0], expected, atol=0.005)
        # Between the eyes of the table it is interpolated.
        np.testing.assert_allclose(seen[[0, 2], 1], 0.0, atol=0.01)

    @pytest.mark.long
    def test_who_sees_whom_over_ridges(self, tmp_path: Path):
        """A narrow ridge 60 m high, 310 m to the north of a grid of 10 m; what is asked is 2 km and more away."""
        north, east = 10.0 * np.arange(-40, 41), 10.0 * np.arange(-40, 41)
        height = np.where(north[:, None] == 310.0, 60.0, 0.0) + 0.0 * east[None, :]
        np.savez(tmp_path / "ridge.npz", north=north, east=east, height=height)
        ground = ElevationFile(str(tmp_path / "ridge.npz")).at(SITE, (-390.0, 390.0, -390.0, 390.0))
        eyes = at([0.0] * 5, [0.0, 0.0, 0.0, 50.0, 0.0], [-2.0, -55.0, -73.0, -2.0, 0.0]).map(jnp.float32)
        far = Vec3(*map(jnp.float32, (2000.0, 10.0, -2.0)))
        # The line from an eye at height h is at 2 + 0.845 (h - 2) m over the ridge: 47 m from 55, 62 m from 73.
        np.testing.assert_array_equal(ground.line_of_sight(eyes, far), [False, False, True, False, False])
        beside = Vec3(*map(jnp.float32, (-2000.0, 10.0, -2.0)))
        np.testing.assert_array_equal(ground.line_of_sight(eyes, beside), [True] * 5)
        # A place in the ground is seen by nobody.
        within = Vec3(*map(jnp.float32, (2000.0, 10.0, 30.0)))
        assert not np.asarray(ground.line_of_sight(eyes, within)).any()

    @pytest.mark.long
    def test_hides_satellites_and_moves_the_wind(self, tmp_path: Path):
        north = 50.0 * np.arange(-20, 21)
        height = np.where(north[:, None] >= 100.0, 400.0, 0.0) + 0.0 * north[None, :]
        np.savez(tmp_path / "cliff.npz", north=north, east=north, height=height)
        area = {**AREA, "z_min": -30}
        found = []
        for ground in ("flat", {"type": "dem", "file": str(tmp_path / "cliff.npz")}):
            pilot = {"type": "waypoint", "feed": "truth"}
            sensors = {"gnss": {"type": "gnss_receiver"}}
            scenario = make_scenario([[0, 0, -10]], area=area, ground=ground, sensors=sensors, controller=pilot)
            simulation = qrsim.Simulation(scenario.world())
            found.append(float(simulation.reset().gnss.satellites[0]))
        # The cliff fills the north up to 75 degrees, and of the satellites above 10 degrees some are there.
        assert found[1] <= found[0] - 2.0

    @pytest.mark.long
    def test_random_places_and_what_looks_at_the_ground_count_from_it(self, tmp_path: Path):
        vehicles = [[0.0, 0.0, -15.0], [0.0, 20.0, -15.0]]
        fleet = {
            "vehicles": vehicles,
            "placement": {"type": "uniform"},
            "controller": {"type": "waypoint", "feed": "truth"},
        }
        world = make_world(fleets={"a": fleet}, ground={"type": "dem", "file": slope(tmp_path)}, area=AREA)
        state = jax.jit(reset)(world, Key.root(3))
        place = state.fleets[0].vehicle.position_ned
        # The slope, as it was written: 1 m up in 10 m to the north, 1 m down in 20 m to the east.
        np.testing.assert_allclose(place.z, -15.0 - place.x / 10.0 + place.y / 20.0, atol=1e-4)
        seen = surroundings(world, state.contents, jnp.int32(0)).over_ground(place)
        np.testing.assert_allclose(seen.stack(), np.stack([place.x, place.y, [-15.0, -15.0]], axis=-1), atol=1e-4)

    @pytest.mark.long
    def test_a_start_on_it(self, tmp_path: Path):
        vehicles = [{"position_ned": [40.0, -20.0, 0.0], "on_ground": True}, {"position_ned": [0.0, 0.0, -20.0]}]
        fleet = {"vehicles": vehicles, "ground": "parked", "controller": {"type": "waypoint", "feed": "truth"}}
        ground = {"type": "dem", "file": slope(tmp_path)}
        scenario = make_scenario(fleets={"a": fleet}, ground=ground, area=AREA)
        # 4 m up to the north, 1 m up to the west.
        np.testing.assert_allclose(scenario.spec.fleets["a"].vehicles[0].position_ned, [40.0, -20.0, -5.0], atol=1e-5)
        state = jax.jit(reset)(scenario.world(), Key.root(3))
        np.testing.assert_array_equal(state.fleets[0].parked, [True, False])

    def test_who_flies_into_it_stops(self, tmp_path: Path):
        # Above the valley to the south-east z = 3 is in the air; at the origin it is below the ground.
        starts = [[-45.0, 30.0, 3.0], [0.0, 0.0, -2.0]]
        world = make_world(starts, ground={"type": "dem", "file": slope(tmp_path)}, area=AREA)
        np.testing.assert_allclose(world.height_agl(at([-45.0, 0.0], [30.0, 0.0], [3.0, -2.0])), [3.0, 2.0], atol=1e-5)
        simulation = qrsim.Simulation(world)
        simulation.reset()
        simulation.step([[0.0, 0.0, 0.59, 0.0, 12.0], [0.0, 0.0, 0.3, 0.0, 12.0]], ticks=60)
        assert simulation.reasons[0] == ""
        assert simulation.reasons[1].startswith("hit_ground: position_ned.z = ")


def without(where: int) -> Any:
    """Return heights without one of them."""
    return np.where(np.arange(231).reshape(21, 11) == where, np.nan, 1.0)


HEADER = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\n"


class TestRefused:
    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"height": np.zeros((3, 3))}, "'north' has shape (21,), 'east' (11,) and 'height' (3, 3); expected (R,)"),
            (
                {"north": 10.0 * np.arange(-4, 17)},
                "covers north -40 to 160 and east -100 to 100 m; world.area needs "
                "north -50 to 50 and east -40 to 40 m; give a smaller world.area or a larger file",
            ),
            (
                {"north": 10.0 * np.arange(500_000, 500_021)},
                "world.area needs north -50 to 50 and east -40 to 40 m; give origin_north and origin_east",
            ),
            ({"height": without(115)}, "has no height at the site's origin"),
            (
                {"height": without(127)},
                "has no height at 1 of 55 points in world.area, the first at north 10 m, east 20 m",
            ),
            ({"east": np.array([-100, -90, -50, -40, -20, 0, 20, 40, 60, 80, 100.0])}, "its east are not evenly"),
            ({"north": None, "norths": np.zeros(3)}, "has no 'north'; did you mean 'norths'?"),
            ({"height": np.full((21, 11), "a")}, "'height' is of type <U1; expected numbers"),
        ],
    )
    def test_archives(self, tmp_path: Path, changes: dict[str, Any], words: str):
        with pytest.raises(UsageError) as caught:
            ElevationFile(slope(tmp_path, **changes)).at(SITE, BOX)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            (f"{HEADER}cellsize 10\n1 2 3\n4 5\n", "5 heights; its header says 2 rows of 3"),
            (f"{HEADER}cellsize 10\n1 2 3\n4 5 6\n7\n", "more heights; its header says 2 rows of 3, which are 6"),
            (
                f"{HEADER}cellsize 10\n".replace("ncols 3", "ncols 30000").replace("nrows 2", "nrows 30000"),
                "30000 rows of 30000, 9e+08 heights; allowed: 8e+06",
            ),
            (f"{HEADER}1 2 3\n4 5 6\n", "its header has no 'cellsize'"),
            (f"{HEADER}cellsize 10\nNCOLS 3\n1 2 3\n4 5 6\n", "its header has 'ncols' twice"),
            ("ncols 3\nnrows 2.5\n", "'nrows' of its header is 2.5; expected a whole number"),
            (f"{HEADER}cellsize 10\n1 2 x 4 5 6\n", "line 6: the height 'x' is not a number"),
            ("", "its header has no 'ncols'"),
        ],
    )
    def test_ascii_grids(self, tmp_path: Path, text: str, words: str):
        (tmp_path / "a.asc").write_text(text)
        with pytest.raises(UsageError) as caught:
            ElevationFile(str(tmp_path / "a.asc")).at(SITE, BOX)
        assert words in str(caught.value)

    def test_files(self, tmp_path: Path):
        file = slope(tmp_path)
        (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 no archive")
        # Nine million heights in nine kilobytes, and a header that says more than there is.
        along = np.arange(3000.0)
        np.savez_compressed(tmp_path / "bomb.npz", height=np.zeros((3000, 3000), np.uint8), north=along, east=along)
        with zipfile.ZipFile(tmp_path / "claims.npz", "w") as archive, archive.open("height.npy", "w") as stream:
            said = {"descr": "<f8", "fortran_order": False, "shape": (2000, 2000)}
            np.lib.format.write_array_header_1_0(stream, said)
        for name, words in (
            ("slopes.npz", "did you mean 'slope.npz'?"),
            ("hill.txt", "expected one of .tif, .tiff, .img, .hgt, .asc, .vrt, .npz, or a folder of tiles"),
            ("bad.npz", "is no NumPy archive of numbers, or it is damaged"),
            ("bomb.npz", "'height' has shape (3000, 3000), 9e+06 numbers; allowed: 8e+06"),
            ("claims.npz", "is no NumPy archive of numbers, or it is damaged"),
        ):
            with pytest.raises(UsageError) as caught:
                ElevationFile(str(Path(file).parent / name)).at(SITE, BOX)
            assert words in str(caught.value)

    def test_starts_and_waypoints_below_it(self, tmp_path: Path):
        vehicle = {"position_ned": [40.0, 0.0, -3.0], "waypoints_ned": [[-40.0, 0.0, 3.0], [0.0, -20.0, 0.0]]}
        with pytest.raises(ScenarioError) as caught:
            make_scenario([vehicle], ground={"type": "dem", "file": slope(tmp_path)}, area=AREA)
        start, waypoint = caught.value.problems
        assert start == (
            "fleets.vehicles.vehicles.0.position_ned: z = -3 m is 1 m below the ground, which is at z = -4 m there; "
            "allowed: at most that"
        )
        assert waypoint.startswith("fleets.vehicles.vehicles.0.waypoints_ned.1: z = 0 m is 1 m below the ground")

    def test_a_start_on_the_ground_of_a_fleet_whose_flights_end_there(self):
        with pytest.raises(
            ScenarioError,
            match=r"vehicles\.0\.on_ground: touching the ground ends the flight of this fleet; set .* to parked",
        ):
            make_scenario([{"position_ned": [0, 0, 0], "on_ground": True}])

    def test_a_file_that_does_not_cover_the_area(self, tmp_path: Path):
        with pytest.raises(ScenarioError) as caught:
            make_scenario([[0.0, 0.0, -20.0]], ground={"type": "dem", "file": slope(tmp_path)})
        (problem,) = caught.value.problems
        assert problem.startswith("world.ground: ")
        assert "covers north -100 to 100 and east -100 to 100 m; world.area needs north -1000 to 1000" in problem

    def test_an_unknown_ground_is_named(self):
        with pytest.raises(UsageError, match=r"world\.ground"):
            make_world([[0.0, 0.0, -20.0]], ground="flatt")
