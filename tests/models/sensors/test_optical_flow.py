"""Optical flow against angles by hand: straight and turning flight, distance, light, speed, the signs of MAVLink."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from test_rangefinder import attitude, solids, vector

from qrsim import Simulation, make_scenario
from qrsim.core.noise import Drawn
from qrsim.errors import ScenarioError
from qrsim.models.scene.ground import FlatGround
from qrsim.models.sensors.optical_flow import PRESETS, IdealOpticalFlow, OpticalFlow

SEED = 20261122
QUIET = {"noise_rate": 0.0, "gyroscope_noise": 0.0}


def seen(
    sensor: Any,
    velocity: Any = (0.0, 0.0, 0.0),
    rates: Any = (0.0, 0.0, 0.0),
    height: float = 10.0,
    roll: float = 0.0,
    normals: Any = (0.0,) * 5,
    obstacles: Any = None,
) -> dict[str, Any]:
    draw = Drawn(tuple(jnp.array([value], jnp.float32) for value in normals))
    scene = (attitude(roll), vector(*velocity), vector(*rates), obstacles or solids(), FlatGround())
    _, found = sensor.init(draw, vector(0.0, 0.0, -height), *scene)
    turned = np.ravel(found.delta_angle.stack())
    return {
        "flow": (float(found.flow_x[0]), float(found.flow_y[0])),
        "turned": turned,
        "quality": float(found.quality[0]),
        "status": int(found.status[0]),
    }


@pytest.mark.parametrize("sensor", [OpticalFlow(**QUIET, range_half=1e4), IdealOpticalFlow()])  # type: ignore[arg-type]
def test_signs_and_angles(sensor: Any) -> None:
    """Over a period of 0.02 s: forward is positive about y, to the right negative about x; turns are their angle."""
    assert seen(sensor, (3.0, 0.0, 0.0))["flow"] == pytest.approx((0.0, 0.006), abs=1e-7)
    assert seen(sensor, (0.0, 3.0, 0.0))["flow"] == pytest.approx((-0.006, 0.0), abs=1e-7)
    found = seen(sensor, rates=(0.5, -0.2, 0.9))
    assert found["flow"] == pytest.approx((0.01, -0.004), abs=1e-7)
    np.testing.assert_allclose(found["turned"], [0.01, -0.004, 0.018], rtol=1e-5)
    # Tilted by 0.4 rad the ground is 10 m/cos 0.4 away.
    assert seen(sensor, (3.0, 0.0, 0.0), roll=0.4)["flow"][1] == pytest.approx(0.006 * math.cos(0.4), rel=1e-5)
    # A roof 4 m high is nearer.
    roof = solids((-5.0, 5.0, -5.0, 5.0, -4.0, 0.0))
    assert seen(sensor, (3.0, 0.0, 0.0), obstacles=roof)["flow"][1] == pytest.approx(0.01, rel=1e-5)


def test_between_readings_motion_changes_linearly() -> None:
    sensor, still = OpticalFlow(**QUIET), vector(0.0, 0.0, 0.0)  # type: ignore[arg-type]
    draw = Drawn((jnp.zeros(1),) * 5)
    at: Any = (vector(0.0, 0.0, -10.0), attitude())
    state, _ = sensor.init(draw, *at, still, still, solids(), FlatGround())
    _, found = sensor.step(state, draw, *at, vector(4.0, 0.0, 0.0), vector(0.0, 1.0, 0.0), solids(), FlatGround())
    assert float(found.flow_y[0]) == pytest.approx(0.5 * (1.0 + 0.4) * 0.02, rel=1e-5)
    assert float(found.delta_angle.y[0]) == pytest.approx(0.01, rel=1e-5)


def test_quality_and_noise() -> None:
    """1/(1 + (d/15)^2) L/(L + 60): at 15 m in 60 lux 1/4, and four times the noise."""
    sensor = OpticalFlow(illuminance=60.0)  # type: ignore[arg-type]
    found = seen(sensor, height=15.0, normals=(1.5, -1.0, 2.0, 0.0, -1.0))
    assert found["quality"] == pytest.approx(0.25, rel=1e-5)
    assert found["flow"] == pytest.approx((4.0 * 1.5 * 0.05 * 0.02, -4.0 * 0.05 * 0.02), rel=1e-4)
    np.testing.assert_allclose(found["turned"], [2.0 * 0.003 * 0.02, 0.0, -0.003 * 0.02], atol=1e-8)
    assert seen(OpticalFlow(), height=1.0)["quality"] == pytest.approx(
        10_000.0 / 10_060.0 / (1.0 + 1.0 / 225.0), rel=1e-5
    )


@pytest.mark.parametrize(
    ("given", "status"),
    [
        ({"height": 0.07}, 1),
        ({"height": 0.09}, 0),
        ({"height": 44.0}, 0),
        # 1/(1 + (46/15)^2) is below 0.1.
        ({"height": 46.0}, 3),
        ({"height": 51.0}, 2),
        ({"roll": math.pi}, 2),
        ({"velocity": (73.0, 0.0, 0.0)}, 0),
        ({"velocity": (75.0, 0.0, 0.0)}, 4),
        ({"rates": (0.0, 7.5, 0.0)}, 4),
    ],
)
def test_limits(given: dict[str, Any], status: int) -> None:
    found = seen(OpticalFlow(**QUIET), **given)  # type: ignore[arg-type]
    assert found["status"] == status
    assert math.isnan(found["flow"][0]) == (status > 0)
    assert np.isfinite(found["turned"]).all()


def test_dark() -> None:
    for lux, status in ((5.0, 3), (9.0, 0)):
        assert seen(OpticalFlow(illuminance=lux, range_half=1e4), height=1.0)["status"] == status  # type: ignore[arg-type]


def test_presets() -> None:
    """7.4 and 7.2 rad/s, from 80 mm on."""
    assert [PRESETS[name]["flow_max"] for name in ("pmw3901", "paa3905")] == [7.4, 7.2]
    assert {found["range_min"] for found in PRESETS.values()} == {0.08}


@pytest.mark.long
def test_a_flight_by_flow_and_range() -> None:
    """Velocity over ground from flow, rotation and distance, in the axes of a vehicle that speeds up and tilts."""
    sensors = {
        "flow": {"type": "ideal_optical_flow"},
        "range": {"type": "ideal_rangefinder"},
        "worn": {"type": "optical_flow", "delay": 1},
    }
    scenario = make_scenario(
        [{"position_ned": [0.0, 0.0, -12.0], "waypoints_ned": [[30.0, 20.0, -12.0]]}],
        sensors=sensors,
        controller={"type": "waypoint", "feed": "truth"},
    )
    simulation = Simulation(scenario.world("float64"), seed=SEED)
    simulation.reset()
    before = simulation.truth.velocity_body[0]
    distance, errors = simulation.reading.range.range[0], []
    for _ in range(200):
        reading = simulation.step()
        flow, now = reading.flow, simulation.truth.velocity_body[0]
        mean = 0.5 * (distance + reading.range.range[0]) / 0.02
        found = [(flow.flow_y[0] - flow.delta_angle[0, 1]) * mean, (flow.delta_angle[0, 0] - flow.flow_x[0]) * mean]
        errors.append(np.array(found) - 0.5 * (before + now)[:2])
        before, distance = now, reading.range.range[0]
    assert np.abs(errors).max() < 0.01
    assert np.abs(now[:2]).max() > 1.0
    assert (reading.worn.status == 0.0).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"preset": "pmw3091"}, "pmw3901"),
        ({"illuminance": -1.0}, "flow.illuminance: -1.0 is out of range"),
        ({"flowmax": 3.0}, "did you mean 'flow_max'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario(
            [[0.0, 0.0, -20.0]],
            sensors={"flow": {"type": "optical_flow", **given}},
            controller={"type": "waypoint", "feed": "truth"},
        )
