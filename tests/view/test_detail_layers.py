"""Layers of further quantities: ellipsoids, wakes, rays to satellites, thermals, states in labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.scenarios.scenario import load_scenario
from qrsim.view.details import Details
from qrsim.view.ellipsoids import UNCERTAINTY
from qrsim.view.frame import Frame, cast_of
from qrsim.view.jets import WAKES
from qrsim.view.labels import STATES, lines_of
from qrsim.view.rays import RAYS, dashes
from qrsim.view.scene import Scene
from qrsim.view.server import start_server
from qrsim.view.thermals import centres

PLACES = np.array([[0.0, 0.0, -50.0], [0.0, 60.0, -8.0]])
STILL = np.zeros((2, 3))
NOTHING = np.full((2, 3), np.nan)
BELIEVED, STD = PLACES + np.array([1.0, 0.0, 0.0]), np.full((2, 3), 2.0)
HOVER = Details(STILL, np.full(2, 10.0), BELIEVED, STD, np.array([0.5, np.nan]), np.zeros(2), {1: "failsafe: return"})
FRAME = Frame(1.0, PLACES, STILL, PLACES, NOTHING, STILL, STILL, np.ones(2, bool), details=lambda: HOVER)


@pytest.fixture(scope="module")
def scene() -> Iterator[Scene]:
    """Two vehicles with an estimator and a receiver of single satellites; a wall stands 20 m east of the first."""
    content = {
        "name": "two",
        "duration": 1.0,
        "world": {
            "area": {"type": "box", "x_min": -100, "x_max": 100, "y_min": -100, "y_max": 100, "z_min": -90},
            "obstacles": [{"type": "box", "x_min": -40, "x_max": 40, "y_min": 20, "y_max": 30, "z_min": -80}],
        },
        "fleets": {
            "a": {
                "controller": {"type": "waypoint"},
                "estimator": "ekf",
                "sensors": {"gnss": {"type": "gnss", "per_satellite": True}, "gyroscope": {"type": "gyroscope"},
                            "accelerometer": {"type": "accelerometer"}, "barometer": {"type": "barometer"},
                            "attitude": {"type": "attitude_estimator"}, "magnetometer": {"type": "magnetometer"}},
                "vehicles": [{"position_ned": place.tolist()} for place in PLACES],
            }
        },
    }  # fmt: skip
    world = load_scenario(content, quiet=True).world()
    server = start_server(0)
    yield Scene(server, cast_of(world, PLACES), world)
    server.stop()


def drawn(scene: Scene, title: str, frame: Frame = FRAME) -> Any:
    """Return a layer of which a frame was drawn."""
    layer = scene.layers[title]
    layer.draw(frame)
    return layer


def test_an_ellipsoid_is_where_the_estimate_is_and_holds_95_percent(scene: Scene) -> None:
    balls = drawn(scene, UNCERTAINTY)._handle
    np.testing.assert_allclose(balls.batched_positions[0], [1.0, 0.0, -50.0])
    # The 95 % quantile of chi squared with three degrees of freedom is 7.815.
    np.testing.assert_allclose(balls.batched_scales[0], 2.0 * 7.815**0.5, rtol=1e-4)
    stopped = replace(FRAME, valid=np.array([False, True]))
    assert not drawn(scene, UNCERTAINTY, stopped)._handle.batched_scales[0].any()


def test_a_wake_ends_at_1_m_per_s_or_at_the_ground(scene: Scene) -> None:
    cones = drawn(scene, WAKES)._handle
    # By the momentum of a round jet: sqrt(3 (sqrt(2) - 1) 10 N / (1.225 pi)) = 1.797 m^2/s, and a spread of 0.096.
    np.testing.assert_allclose(cones.batched_scales[0], [18.72, 1.797, 1.797], rtol=1e-3)
    np.testing.assert_allclose(cones.batched_scales[1], [8.0, 0.768, 0.768], rtol=1e-3)
    # Without wind it hangs below: the x axis of the mesh turned down.
    w, x, y, z = cones.batched_wxyzs[0]
    np.testing.assert_allclose(
        [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], [0, 0, 1], atol=1e-6
    )


def test_rays_are_dashed_by_what_the_receiver_reports(scene: Scene) -> None:
    assert [len(dashes(kind)) for kind in (1, 2, 3, 4)] == [1, 14, 8, 24]
    scene.stage.chosen = frozenset({0})
    # In the north, tracked; low in the east, behind the wall; below the horizon there is none.
    scene.stage.sky = lambda vehicle: [("G-A1", 0, 0, 45, 1), ("G-A2", 90, 0, 0, 3)]
    segments, received = scene.layers[RAYS]._of(scene.stage.sky(0), PLACES[0])  # type: ignore[attr-defined]
    assert received.tolist() == [True] + [False] * 8
    reach = 0.4 * scene.stage.cast.extent
    np.testing.assert_allclose(segments[0], [PLACES[0], PLACES[0] + [reach, 0.0, 0.0]])
    # The last of eight dashes ends half a dash before the wall, 20 m to the east.
    np.testing.assert_allclose(segments[-1, 1], PLACES[0] + [0.0, 20.0 * 7.5 / 8.0, 0.0], atol=1e-3)
    drawn(scene, RAYS)
    scene.stage.chosen = frozenset()


def test_labels_state_what_is_known(scene: Scene) -> None:
    told: list[Any] = []
    scene.layers[STATES].tell = told.append  # type: ignore[attr-defined]
    scene.frame = FRAME
    scene.show(STATES, True)
    assert told[-1] == {
        0: ["0.0 m/s, 50.0 m high", "battery 50 %", "estimate 1 m off (sigma 3.5 m)"],
        1: ["0.0 m/s, 8.0 m high", "failsafe: return", "estimate 1 m off (sigma 3.5 m)"],
    }
    # Hidden, only the selected vehicle has them.
    scene.show(STATES, False)
    assert told[-1] == {}
    scene.choose(1)
    assert list(told[-1]) == [1]
    scene.choose()
    scene.frame = None
    nothing = Details(NOTHING, np.full(2, np.nan), NOTHING, NOTHING, np.full(2, np.nan), np.full(2, np.nan), {})
    assert lines_of(FRAME, nothing, 0, 0) == []
    assert lines_of(FRAME, replace(HOVER, waypoint=np.array([2, 0])), 0, 4)[1] == "waypoint 3 of 4, battery 50 %"


def test_thermals_drift_and_come_in_again_on_the_other_side() -> None:
    wind = SimpleNamespace(mean_velocity_ned=lambda height: Vec3(*(jnp.full(1, v) for v in (3.0, -1.0, 0.0))))
    thermals: Any = SimpleNamespace(
        places_ned=np.array([[90.0, 0.0]]),
        drifts=True,
        drift_height=100.0,
        corner=(-100.0, -50.0),
        sides=(200.0, 100.0),
    )
    world: Any = SimpleNamespace(wind=wind)
    np.testing.assert_allclose(centres(thermals, None, world, 10.0), [[-80.0, -10.0]])
    thermals.drifts = False
    np.testing.assert_allclose(centres(thermals, None, world, 10.0), [[90.0, 0.0]])
