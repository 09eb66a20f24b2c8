"""The beam of a rangefinder against distances by hand: plane, hills, boxes, tilt; its limits, noise and losses."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim import Simulation, make_scenario
from qrsim.core.noise import Drawn
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.ground import FlatGround, GridGround
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles
from qrsim.models.sensors.rangefinder import IdealRangefinder, Rangefinder
from qrsim.models.sensors.rangefinder_presets import RANGEFINDERS

Array = np.ndarray[Any, Any]
# A wall 4 m thick from 20 m north on, 30 m high.
WALL = (20.0, 24.0, -50.0, 50.0, -30.0, 0.0)
MAST = (0.0, 10.0, 0.5, -40.0, 0.0)
NONE = (np.zeros((0,)),) * 6
CLEAN = {"noise_std": 0.0, "noise_per_range": 0.0, "range_min": 0.1, "resolution": 0.0}
SEED = 20261122


def solids(box: tuple[float, ...] = (), cylinder: tuple[float, ...] = ()) -> Obstacles:
    boxes = BoxObstacle(*(np.array([v]) for v in box) if box else NONE)
    cylinders = CylinderObstacle(*(np.array([v]) for v in cylinder) if cylinder else NONE[:5])
    return cast(Obstacles(boxes, cylinders, np.arange(float(bool(box) + bool(cylinder)))), np.float32)  # type: ignore[arg-type]


def vector(*values: float) -> Vec3:
    return Vec3(*(jnp.array([value], jnp.float32) for value in values))


def attitude(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Euler:
    return Euler(*(jnp.array([value], jnp.float32) for value in (roll, pitch, yaw)))


def read(
    sensor: Any,
    place: tuple[float, float, float],
    pose: Euler | None = None,
    obstacles: Obstacles | None = None,
    ground: Ground | None = None,
    normals: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[float, int]:
    draw = Drawn(tuple(jnp.array([value], jnp.float32) for value in normals))
    _, found = sensor.init(
        draw, vector(*place), pose or attitude(), obstacles or solids(), FlatGround() if ground is None else ground
    )
    return float(found.range[0]), int(found.status[0])


def hills(amplitude: float = 6.0, length: float = 80.0, spacing: float = 2.0) -> tuple[GridGround, Any]:
    """A grid of a cosine along north, and its height."""
    axis = np.arange(-200.0, 201.0, spacing)

    def height(north: Any) -> Any:
        return amplitude * np.cos(2.0 * math.pi * north / length)

    grid = -np.broadcast_to(height(axis)[:, None], (len(axis), len(axis)))
    found = GridGround(np.array(grid), (-200.0, -200.0), (spacing, spacing), np.zeros((2, 2)), (0.0, -1.0))  # type: ignore[arg-type]
    return cast(found, np.float32), height


class TestBeam:
    @pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.4, 0.0), (0.0, -0.5), (0.3, 0.6)])
    def test_a_tilted_beam_over_a_plane(self, roll: float, pitch: float) -> None:
        """h/(cos roll cos pitch)."""
        for ground, height in ((FlatGround(), 12.0), (FlatGround(3.0), 9.0)):
            sensor = Rangefinder(**CLEAN)
            found, status = read(sensor, (5.0, -3.0, -12.0), attitude(roll, pitch, 1.0), ground=ground)
            assert status == 0
            assert found == pytest.approx(height / (math.cos(roll) * math.cos(pitch)), rel=1e-5)

    @pytest.mark.parametrize(
        ("axis", "yaw", "expected"),
        [
            ("forward", 0.0, 20.0),
            ("backward", math.pi, 20.0),
            ("right", -0.5 * math.pi, 20.0),
            ("left", 0.5 * math.pi, 20.0),
            ("forward", math.pi / 3.0, 40.0),
            ("down", 0.0, 12.0),
        ],
    )
    def test_a_wall_straight_and_at_a_slant(self, axis: Any, yaw: float, expected: float) -> None:
        for sensor in (Rangefinder(**CLEAN, axis=axis, range_max=100.0), IdealRangefinder(axis=axis)):
            found, _ = read(sensor, (0.0, 0.0, -12.0), attitude(yaw=yaw), solids(WALL))
            assert found == pytest.approx(expected, rel=1e-4)

    def test_up_there_is_nothing_but_what_stands_above(self) -> None:
        roof = solids((-5.0, 5.0, -5.0, 5.0, -20.0, -15.0))
        assert read(IdealRangefinder(axis="up"), (0.0, 0.0, -12.0), obstacles=roof) == (3.0, 0)
        found, status = read(IdealRangefinder(axis="up"), (0.0, 0.0, -12.0))
        assert math.isnan(found)
        assert status == 2

    def test_a_mast(self) -> None:
        found, _ = read(Rangefinder(**CLEAN, axis="right"), (0.0, 0.0, -12.0), obstacles=solids(cylinder=MAST))
        assert found == pytest.approx(9.5, rel=1e-5)

    @pytest.mark.long
    def test_hills_from_above_and_along_their_slopes(self) -> None:
        """Within 2 cm, by which the bilinear grid lies below the cosine, of the first crossing found by small steps."""
        ground, height = hills()
        for north, pitch in ((7.0, 0.0), (-33.0, 0.7), (15.0, 1.1), (3.0, -1.3)):
            sensor = Rangefinder(**CLEAN, range_max=150.0)
            found, _ = read(sensor, (north, 4.0, -20.0), attitude(pitch=pitch), ground=ground)
            way = np.arange(0.0, 150.0, 0.001)
            above = 20.0 - way * math.cos(pitch) - height(north + way * math.sin(pitch))
            first = way[np.argmax(above <= 0.0)]
            assert found == pytest.approx(first, abs=0.02 / math.cos(pitch) ** 2)

    def test_a_roof_hides_the_ground(self) -> None:
        roof = solids((-5.0, 5.0, -5.0, 5.0, -4.0, 0.0))
        assert read(Rangefinder(**CLEAN), (0.0, 0.0, -12.0), obstacles=roof)[0] == pytest.approx(8.0, rel=1e-6)
        assert read(Rangefinder(**CLEAN), (0.0, 0.0, 1.0))[1] == 1

    def test_an_edge_within_2_cm_of_the_beam_is_a_wall_along_it(self) -> None:
        for edge, status in ((0.021, 0), (0.019, 2)):
            wall = solids((20.0, 24.0, -50.0, edge, -30.0, 0.0))
            assert read(Rangefinder(**CLEAN, axis="forward"), (0.0, 0.0, -12.0), obstacles=wall)[1] == status


class TestReach:
    def test_a_slant_is_seen_less_far(self) -> None:
        """range_max sqrt(cos i): at 60 degrees 0.7071 of 30 m, of ground, wall and mast alike."""
        sensor = Rangefinder(**CLEAN, range_max=30.0)
        tilted = attitude(roll=math.pi / 3.0)
        for height, status in ((10.5, 0), (10.7, 2)):
            assert read(sensor, (0.0, 0.0, -height), tilted)[1] == status, height
        ahead = Rangefinder(**CLEAN, range_max=30.0, axis="forward")
        for away, status in ((10.5, 0), (10.7, 2)):
            found = read(ahead, (20.0 - away, 0.0, -12.0), attitude(yaw=math.pi / 3.0), solids(WALL))
            assert found[1] == status, away
            # The same of a nose that is up by 60 degrees.
            found = read(ahead, (20.0 - away, 0.0, -5.0), attitude(pitch=math.pi / 3.0), solids(WALL))
            assert found[1] == status, away

    def test_what_reflects_less_is_seen_less_far(self) -> None:
        """12 m at 90 % of reflection are 4 m at 10 %."""
        dark = Rangefinder(**CLEAN, range_max=12.0, reflectivity=1.0 / 9.0)
        assert [read(dark, (0.0, 0.0, -height))[1] for height in (3.95, 4.05)] == [0, 2]

    def test_limits(self) -> None:
        sensor = Rangefinder(**{**CLEAN, "range_min": 0.3}, range_max=12.0)
        for height, status in ((0.25, 1), (0.35, 0), (11.9, 0), (12.1, 2)):
            found = read(sensor, (0.0, 0.0, -height))
            assert found[1] == status
            assert math.isnan(found[0]) == (status > 0)


class TestErrors:
    def test_noise_grows_with_range(self) -> None:
        sensor = Rangefinder(noise_std=0.1, noise_per_range=0.02, resolution=0.0)  # type: ignore[arg-type]
        for height in (5.0, 20.0):
            found, _ = read(sensor, (0.0, 0.0, -height), normals=(1.5, 0.0, 0.0))
            assert found == pytest.approx(height + 1.5 * (0.1 + 0.02 * height), rel=1e-6)

    def test_a_pulse_is_lost_by_two_normals(self) -> None:
        """exp(-(1.5^2 + 0.5^2)/2) = 0.2865."""
        for share, status in ((0.28, 0), (0.29, 3)):
            sensor = Rangefinder(**CLEAN, dropouts=share)
            assert read(sensor, (0.0, 0.0, -10.0), normals=(0.0, 1.5, 0.5))[1] == status

    def test_steps(self) -> None:
        sensor = Rangefinder(**{**CLEAN, "resolution": 0.25})
        assert read(sensor, (0.0, 0.0, -10.1))[0] == pytest.approx(10.0)
        assert read(sensor, (0.0, 0.0, -10.15))[0] == pytest.approx(10.25)

    @pytest.mark.long
    def test_as_many_are_lost_as_it_says(self) -> None:
        """20 000 pulses; 99.9 % of the binomial distribution of 0.3 is 0.3 +- 0.0107."""
        count = 20_000
        rows = np.random.default_rng(SEED).standard_normal((3, count))
        many = Vec3(*(jnp.full(count, value) for value in (0.0, 0.0, -10.0)))
        level = Euler(*(jnp.zeros(count),) * 3)
        draw = Drawn(tuple(map(jnp.asarray, rows)))
        sensor = Rangefinder(**CLEAN, dropouts=0.3)
        _, found = sensor.init(draw, many, level, solids(), FlatGround())
        lost = np.asarray(found.status) == 3
        assert lost.mean() == pytest.approx(0.3, abs=0.0107)
        np.testing.assert_array_equal(np.isnan(found.range), lost)

    def test_presets(self) -> None:
        """Of the TFmini's manual: 0.3 to 12 m, 4 cm up to 6 m and 6 cm beyond; of the v3HP's: 5 cm to 40 m, 2.5 cm."""
        small, lite = RANGEFINDERS["tfmini"], RANGEFINDERS["lidar_lite_v3hp"]
        assert (small["range_min"], small["range_max"], small["resolution"]) == (0.3, 12.0, 0.005)
        stds = [small["noise_std"] + small["noise_per_range"] * middle for middle in (3.15, 9.0)]
        np.testing.assert_allclose(stds, [0.04, 0.06], rtol=1e-9)
        assert (lite["noise_std"], lite["resolution"]) == (0.025, 0.01)
        assert (lite["range_min"], lite["range_max"]) == (0.05, 40.0)


@pytest.mark.long
def test_in_a_world_mounted_and_with_reasons() -> None:
    """A beam that looks 30 degrees ahead from 0.5 m before the centre; the code generator takes it."""
    sensors = {
        "low": {"type": "ideal_rangefinder", "mount_attitude_deg": [0.0, 30.0, 0.0]},
        "nose": {"type": "rangefinder", "preset": "tfmini", "axis": "forward", "mount_position_body": [0.5, 0.0, 0.0]},
    }
    box = {"type": "box", "x_min": 8.0, "x_max": 9.0, "y_min": -3.0, "y_max": 3.0, "z_min": -40.0}
    scenario = make_scenario(
        [[0.0, 0.0, -6.0], [0.0, 30.0, -20.0]],
        sensors=sensors,
        obstacles=[box],
        controller={"type": "waypoint", "feed": "truth"},
    )
    simulation = Simulation(scenario.world(), seed=SEED)
    reading = simulation.reset()
    np.testing.assert_allclose(
        reading.low.range, [6.0 / math.cos(math.pi / 6.0), 20.0 / math.cos(math.pi / 6.0)], rtol=1e-4
    )
    assert reading.nose.range[0] == pytest.approx(7.5, abs=0.3)
    assert reading.nose.reasons == ["", "nothing within its reach"]
    for _ in range(5):
        reading = simulation.step(ticks=10)
        assert reading.nose.status.tolist() == [0.0, 2.0]
    assert simulation.compiled_by == ("llvm", "")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"preset": "tfmin"}, "tfmini"),
        ({"axis": "forwards"}, "forward"),
        ({"range_max": -1.0}, "rf.range_max: -1.0 is out of range"),
        ({"dropouts": 1.5}, "rf.dropouts: 1.5 is out of range"),
        ({"rang_max": 3.0}, "did you mean 'range_max'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario(
            [[0.0, 0.0, -20.0]],
            sensors={"rf": {"type": "rangefinder", **given}},
            controller={"type": "waypoint", "feed": "truth"},
        )
