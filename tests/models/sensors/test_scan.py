"""A planar scan against distances by hand: walls, masts, prisms, the ground where it tilts, other vehicles."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from test_rangefinder import MAST, WALL, attitude, solids, vector

from qrsim import Simulation, make_scenario
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.prisms import PrismObstacle, prisms_of
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.rangefinder_presets import SCANS
from qrsim.models.sensors.scan import IdealScan, Scan, ray_angles

Array = np.ndarray[Any, Any]
SEED = 20261122
TURN = 2.0 * math.pi


def draw(vehicles: int = 1) -> Draw:
    stream = Key.root(SEED).stream("a/scan", jnp.arange(vehicles, dtype=jnp.uint32))
    return Draw(stream, jnp.int32(3), jnp.zeros((), jnp.float32))


def scanned(sensor: Any, place: tuple[float, float, float] = (0.0, 0.0, -12.0), **scene: Any) -> Array:
    """Return the ranges (R,) of one vehicle."""
    found = {"position_ned": vector(*place), "attitude": attitude(), "obstacles": solids(), "ground": FlatGround()}
    _, reading = sensor.init(draw(), **{**found, "traffic": None, **scene})
    return np.array([float(ray[0]) for ray in reading.range])


def test_rays_are_the_middles_of_even_sectors() -> None:
    np.testing.assert_allclose(np.degrees(ray_angles(4, TURN)), [-135.0, -45.0, 45.0, 135.0])
    np.testing.assert_allclose(np.degrees(ray_angles(3, math.pi / 2.0)), [-30.0, 0.0, 30.0])
    np.testing.assert_allclose(ray_angles(1, 1.0), [0.0])


@pytest.mark.long
def test_a_wall() -> None:
    """20 m/cos(angle + heading) where that looks at it, nothing else."""
    for yaw in (0.0, 0.7):
        found = scanned(IdealScan(rays=24), attitude=attitude(yaw=yaw), obstacles=solids(WALL))
        bearing = ray_angles(24, TURN) + yaw
        away = 20.0 / np.cos(bearing)
        # Its ends are 50 m to each side.
        expected = np.where((away > 0.0) & (np.abs(away * np.sin(bearing)) < 50.0) & (away < 100.0), away, np.nan)
        np.testing.assert_allclose(found, expected, rtol=1e-5)
        assert np.isfinite(expected).sum() >= 8


@pytest.mark.long
def test_a_mast_and_a_prism() -> None:
    found = scanned(
        IdealScan(rays=9, field_of_view_rad=math.radians(9.0)),
        attitude=attitude(yaw=math.pi / 2.0),
        obstacles=solids(cylinder=MAST),
    )
    angle = ray_angles(9, math.radians(9.0))
    chord = 0.25 - (10.0 * np.sin(angle)) ** 2
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(found, 10.0 * np.cos(angle) - np.sqrt(chord), rtol=1e-5)
    assert np.isfinite(found).sum() == 5
    house = PrismObstacle.of([[10.0, -10.0], [30.0, 0.0], [10.0, 10.0]], z_min=-15.0)
    town = replace(solids(), prisms=cast(prisms_of([house], [0], 1.0), np.float32))
    ahead = IdealScan(rays=3, field_of_view_rad=math.radians(90.0))
    np.testing.assert_allclose(
        scanned(ahead, obstacles=town), [20.0 / math.sqrt(3.0), 10.0, 20.0 / math.sqrt(3.0)], rtol=1e-5
    )
    assert np.isnan(scanned(ahead, (0.0, 0.0, -16.0), obstacles=town)).all()


@pytest.mark.long
def test_a_tilted_scan_meets_the_ground() -> None:
    """Nose down by p: the ray at angle a falls by sin p cos a."""
    found = scanned(Scan(noise_std=0.0, dropouts=0.0, rays=12, range_max=60.0), attitude=attitude(pitch=-0.4))
    falls = math.sin(0.4) * np.cos(ray_angles(12, TURN))
    expected = np.where(falls > 12.0 / 60.0, 12.0 / np.where(falls > 0.0, falls, 1.0), np.nan)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.isfinite(expected).sum() == 4


@pytest.mark.long
def test_other_vehicles_are_spheres() -> None:
    """At 10 m with 0.5 m: 9.5 m in the middle, 10 cos a - sqrt(0.25 - 100 sin^2 a) beside; itself it does not see."""
    places = Vec3(
        *(jnp.array(axis, jnp.float32) for axis in ([0.0, 10.0, -30.0], [0.0, 0.0, 0.0], [-12.0, -12.0, -12.0]))
    )
    still = places.map(jnp.zeros_like)
    flies = jnp.array([True, True, True])
    traffic = Traffic(places, still, flies, jnp.full(3, 0.5, jnp.float32), ("a", "b"), (1, 2))
    sensor = IdealScan(rays=5, field_of_view_rad=math.radians(5.0), sees_vehicles=True)
    angle = ray_angles(5, math.radians(5.0))
    expected = 10.0 * np.cos(angle) - np.sqrt(0.25 - (10.0 * np.sin(angle)) ** 2)
    np.testing.assert_allclose(scanned(sensor, traffic=traffic), expected, rtol=1e-5)
    assert np.isnan(scanned(replace(sensor, sees_vehicles=False), traffic=traffic)).all()
    gone = replace(traffic, flies=jnp.array([True, False, True]))
    assert np.isnan(scanned(sensor, traffic=gone)).all()
    # The second of fleet b looks the other way.
    there = scanned(sensor, (-30.0, 0.0, -12.0), traffic=replace(traffic, first=2))
    np.testing.assert_allclose(there[2], 29.5, rtol=1e-5)


@pytest.mark.long
def test_noise_and_losses() -> None:
    """4 000 scans of 12 rays of walls all around at 20 m: std, share of losses; 99.9 % of each."""
    count = 4000
    zero = jnp.zeros(count)
    room = solids((20.0, 21.0, -200.0, 200.0, -50.0, 0.0))
    ahead = Scan(rays=12, field_of_view_rad=0.2, noise_std=0.1, noise_per_range=0.01, dropouts=0.2)  # type: ignore[arg-type]
    level = replace(attitude(), roll=zero, pitch=zero, yaw=zero)
    _, found = ahead.init(draw(count), Vec3(zero, zero, zero - 12.0), level, room, FlatGround(), None)
    ranges = np.stack([np.asarray(ray) for ray in found.range])
    lost = np.isnan(ranges)
    assert lost.mean() == pytest.approx(0.2, abs=3.3 * math.sqrt(0.16 / ranges.size))
    error = ranges - 20.0 / np.cos(ray_angles(12, 0.2))[:, None]
    assert np.nanstd(error) == pytest.approx(0.3, rel=3.3 / math.sqrt(2.0 * ranges.size * 0.8))
    # Rays and losses are independent of each other.
    assert abs(np.corrcoef(error[0, ~lost[0] & ~lost[1]], error[1, ~lost[0] & ~lost[1]])[0, 1]) < 3.3 / math.sqrt(
        0.64 * count
    )
    assert np.mean(lost[0] & lost[1]) == pytest.approx(0.04, abs=3.3 * math.sqrt(0.04 / count))


def test_presets() -> None:
    """Of the data sheet of the RPLIDAR A1M8: 0.15 to 12 m, 360 samples at 5.5 Hz, 1 % of the distance."""
    found = SCANS["rplidar_a1"]
    assert (found["rays"], found["range_min"], found["range_max"]) == (360, 0.15, 12.0)
    assert found["noise_per_range"] == 0.01
    assert 1.0 / found["period"] == pytest.approx(5.5, abs=0.1)


@pytest.mark.long
def test_in_a_world() -> None:
    """Two vehicles between two walls, one behind the other: the code generator takes it, logs have a column each."""
    walls = [{"type": "box", "x_min": -50, "x_max": 50, "y_min": y, "y_max": y + 1, "z_min": -40} for y in (-9, 8)]
    sensors = {
        "scan": {"type": "ideal_scan", "rays": 4, "sees_vehicles": True},
        "worn": {"type": "scan", "rays": 8, "delay": 1, "dropouts": 0.5},
    }
    starts = [{"position_ned": [x, 0.0, -20.0], "yaw_rad": math.pi / 4.0} for x in (0.0, 15.0)]
    scenario = make_scenario(starts, sensors=sensors, obstacles=walls, controller={"type": "waypoint", "feed": "truth"})
    simulation = Simulation(scenario.world(), seed=SEED)
    reading = simulation.reset()
    # Left is at -90 degrees of the heading and so on: west, north, east, south.
    np.testing.assert_allclose(reading.scan.range, [[8.0, 14.0, 8.0, np.nan], [8.0, np.nan, 8.0, 14.0]], atol=1e-4)
    assert reading.scan.reasons == ["nothing came back along 1 of 4 rays"] * 2
    for _ in range(3):
        reading = simulation.step(ticks=5)
    assert reading.worn.range.shape == (2, 8)
    assert simulation.compiled_by == ("llvm", "")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rays": -3}, "scan.rays: -3 is out of range; allowed: 1 to 720"),
        ({"rays": 3.5}, "scan.rays: 3.5"),
        ({"field_of_view_deg": 400.0}, "scan.field_of_view_deg: 400"),
        ({"preset": "rplidar"}, "rplidar_a1"),
        ({"ray": 12}, "did you mean 'rays'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario(
            [[0.0, 0.0, -20.0]],
            sensors={"scan": {"type": "scan", **given}},
            controller={"type": "waypoint", "feed": "truth"},
        )
