"""Whom a camera or a radar sees: places in its axes by hand, cone, walls, misses, false alarms, noise, identity."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_rangefinder import solids

from qrsim import Simulation, make_scenario
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.neighbours import IdealNeighbours, NeighbourSensor

Array = np.ndarray[Any, Any]
SEED = 20261122
TRUTH: Any = {"type": "waypoint", "feed": "truth"}
STARTS = [[0.0, 0.0, -20.0], [30.0, 0.0, -20.0], [0.0, 25.0, -24.0]]
CLEAN: dict[str, Any] = {"bearing_noise": 0.0, "range_noise_share": 0.0, "missed": 0.0, "false_alarms": 0.0}


def pairs(count: int, ahead: float = 20.0, side: float = 0.0) -> dict[str, Any]:
    """Return as many vehicles, far apart of each other, each with one other before it, and what they may look at."""
    number = jnp.arange(count)
    north, east = (200.0 * part.astype(jnp.float32) for part in (number % 50, number // 50))
    own = Vec3(north, east, jnp.full(count, -30.0))
    other = Vec3(own.x + ahead, own.y + side, own.z)
    place = Vec3(*(jnp.concatenate(both) for both in zip(own.axes, other.axes, strict=True)))
    still = place.map(jnp.zeros_like)
    traffic = Traffic(place, still, jnp.ones(2 * count, bool), jnp.ones(2 * count), ("a", "b"), (count, count))
    level = Euler(*(jnp.zeros(count),) * 3)
    return {"position_ned": own, "attitude": level, "obstacles": solids(), "ground": FlatGround(), "traffic": traffic}


def looked(sensor: Any, count: int, scene: dict[str, Any]) -> Any:
    """Return the reading of vehicles (n,), compiled."""
    stream = Key.root(SEED).stream("a/seen", jnp.arange(count, dtype=jnp.uint32))
    draw = Draw(stream, jnp.int32(3), jnp.zeros((), jnp.float32))
    return jax.jit(lambda given: sensor.init(draw, **given)[1])(scene)


@pytest.mark.long
class TestInAWorld:
    def test_where_others_are_by_hand(self) -> None:
        """Headings 0, 90 and 0 degrees; nearest first; the axes are the body's; mounting moves them."""
        vehicles = [
            {"position_ned": place, "yaw_rad": yaw}
            for place, yaw in zip(STARTS, (0.0, math.pi / 2.0, 0.0), strict=True)
        ]
        sensors = {
            "all": {"type": "ideal_neighbours", "slots": 3},
            "one": {"type": "ideal_neighbours", "slots": 1},
            "nose": {"type": "ideal_neighbours", "mount_position_body": [2.0, 0.0, 0.0]},
        }
        scenario = make_scenario(vehicles, sensors=sensors, controller=TRUTH)
        reading = Simulation(scenario.world(), seed=SEED).reset()
        nan = [math.nan] * 3
        by_hand = [
            [[0.0, 25.0, -4.0], [30.0, 0.0, 0.0], nan],
            [[0.0, 30.0, 0.0], [25.0, 30.0, -4.0], nan],
            [[0.0, -25.0, 4.0], [30.0, -25.0, 4.0], nan],
        ]
        np.testing.assert_allclose(reading.all.position, by_hand, atol=1e-4)
        np.testing.assert_array_equal(reading.all.vehicle[:, :2], [[2, 1], [0, 2], [0, 1]])
        np.testing.assert_allclose(reading.all.distance, np.linalg.norm(by_hand, axis=-1), rtol=1e-5)
        np.testing.assert_array_equal(reading.one.vehicle[:, 0], [2, 0, 0])
        np.testing.assert_array_equal(reading.one.count, [1, 1, 1])
        np.testing.assert_allclose(reading.nose.position[0, 0], [-2.0, 25.0, -4.0], atol=1e-4)
        assert "velocity" not in reading.all.fields
        with pytest.raises(AttributeError, match="sensor 'all' has no 'velocity'; give it velocity: true"):
            _ = reading.all.velocity

    def test_a_wall_hides(self) -> None:
        wall = {"type": "box", "x_min": 10, "x_max": 12, "y_min": -5, "y_max": 5, "z_min": -40}
        sensors = {"seen": {"type": "neighbours", **CLEAN}, "slow": {"type": "neighbours", "delay": 2, "jitter": 0.1}}
        fault = {"sensor": "seen", "kind": "biased", "field": "position.y", "bias": 3.0, "start": 0.3}
        scenario = make_scenario(STARTS, sensors=sensors, controller=TRUTH, obstacles=[wall], faults=[fault])
        simulation = Simulation(scenario.world(), seed=SEED)
        first = simulation.reset().seen
        assert first.count.tolist() == [1.0, 1.0, 2.0]
        np.testing.assert_array_equal(first.vehicle[:, 0], [2, 2, 0])
        assert first.reasons[0] == "sees 1, and has room for 4"
        side = first.position[0, 0, 1]
        last = simulation.step(ticks=20).seen
        assert last.position[0, 0, 1] == pytest.approx(side + 3.0, abs=0.5)
        assert simulation.compiled_by == ("llvm", "")


@pytest.mark.long
class TestErrors:
    def test_cone(self) -> None:
        """60 degrees in all: 20 m ahead and 11.5 m aside is within 30 degrees of forward, 11.6 m is not."""
        camera = NeighbourSensor(**CLEAN, field_of_view_rad=math.pi / 3.0)
        for side, seen in ((11.5, 1.0), (-11.5, 1.0), (11.6, 0.0)):
            assert float(looked(camera, 2, pairs(2, side=side)).count[0]) == seen
        assert float(looked(camera, 2, pairs(2, ahead=-20.0)).count[0]) == 0.0
        assert float(looked(replace(camera, range_max=19.9), 2, pairs(2)).count[0]) == 0.0

    def test_missed_and_false(self) -> None:
        """20 000 looks; 99.9 % of a binomial distribution."""
        count, missed = 2000, 0.2
        sensor = NeighbourSensor(**{**CLEAN, "missed": missed, "false_alarms": 0.1}, slots=2)
        found = looked(sensor, count, pairs(count))
        true = np.asarray(found.vehicle[0]) >= 0.0
        second = np.asarray(found.vehicle[1]) >= 0.0
        assert (true | second).mean() == pytest.approx(0.8, abs=3.3 * math.sqrt(0.16 / count))
        false = (np.asarray(found.vehicle[0]) == -1.0) | (np.asarray(found.vehicle[1]) == -1.0)
        assert false.mean() == pytest.approx(0.1, abs=3.3 * math.sqrt(0.09 / count))
        # By their distance, whoever they are.
        both = np.isfinite(found.distance[1])
        assert np.all(np.asarray(found.distance[0])[both] <= np.asarray(found.distance[1])[both])

    def test_noise_along_and_across(self) -> None:
        """At 20 m: 1.1 m along, 0.4 m across; 99.9 % of 2 000."""
        count = 2000
        sensor = NeighbourSensor(**{**CLEAN, "bearing_noise": 0.02, "range_noise": 0.1, "range_noise_share": 0.05})
        found = looked(sensor, count, pairs(count))
        place = np.array([np.asarray(axis) for axis in found.position[0].axes])
        along = np.asarray(found.distance[0])
        assert along.mean() == pytest.approx(20.0, abs=3.3 * 1.1 / math.sqrt(count))
        assert along.std() == pytest.approx(1.1, rel=3.3 / math.sqrt(2 * count))
        np.testing.assert_allclose(np.linalg.norm(place, axis=0), along, rtol=1e-4)
        for axis in place[1:] / along:
            assert axis.std() == pytest.approx(0.02, rel=3.3 / math.sqrt(2 * count))

    def test_velocity(self) -> None:
        """Of one who flies at (3, -1, 0.5) m/s past who flies at (1, 0, 0), heading east; false ones stand still."""
        count = 2000
        scene = pairs(count)
        first = jnp.arange(2 * count) < count
        parts = ((1.0, 3.0), (0.0, -1.0), (0.0, 0.5))
        fast = Vec3(*(jnp.where(first, own, other) for own, other in parts))
        east = Euler(jnp.zeros(count), jnp.zeros(count), jnp.full(count, math.pi / 2.0))
        scene |= {"traffic": replace(scene["traffic"], velocity_ned=fast), "attitude": east}
        sensor = NeighbourSensor(**{**CLEAN, "false_alarms": 0.1}, velocity=True, velocity_noise=0.3, slots=2)
        found = looked(sensor, count, scene)
        number = np.asarray(found.vehicle[0])
        measured = np.array([np.asarray(axis) for axis in found.velocity[0].axes])
        for axis, expected in zip(measured[:, number >= 0.0], (-1.0, -2.0, 0.5), strict=True):
            assert axis.mean() == pytest.approx(expected, abs=3.3 * 0.3 / math.sqrt(0.9 * count))
            assert axis.std() == pytest.approx(0.3, rel=3.3 / math.sqrt(1.8 * count))
        assert (number < 0.0).sum() > 20
        still = measured[:, number < 0.0]
        np.testing.assert_allclose(still, np.broadcast_to([[0.0], [1.0], [0.0]], still.shape), atol=1e-5)
        nobody = np.isnan(np.asarray(found.vehicle[1]))
        assert np.isnan(np.asarray(found.velocity[1].x)[nobody]).all()

    def test_nobody_knows_who_they_are(self) -> None:
        found = looked(NeighbourSensor(**CLEAN, identity=False), 2, pairs(2))
        assert float(found.vehicle[0][0]) == -1.0
        assert math.isnan(float(found.vehicle[1][0]))


@pytest.mark.long
def test_who_has_stopped_is_nobody() -> None:
    scene = pairs(2)
    gone = replace(scene["traffic"], flies=jnp.array([True, True, False, True]))
    found = looked(IdealNeighbours(range_max=100.0), 2, {**scene, "traffic": gone})  # type: ignore[arg-type]
    assert np.asarray(found.count).tolist() == [0.0, 1.0]
    assert float(found.vehicle[0][1]) == 3.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"slots": 0}, r"seen\.slots: 0 is out of range; allowed: 1 to 32"),
        ({"field_of_view_deg": 361.0}, "field_of_view_deg: 361"),
        ({"missed": 1.2}, r"seen\.missed: 1.2 is out of range"),
        ({"slot": 3}, "did you mean 'slots'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario(STARTS, sensors={"seen": {"type": "neighbours", **given}}, controller=TRUTH)
