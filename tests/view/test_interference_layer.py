"""Masts and fences of what interferes with receivers, and what they cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.view.test_scene import PLACES, cast, frame

from qrsim.runs.interferers import of_scenario, of_world
from qrsim.scenarios.scenario import load_scenario
from qrsim.view.interference import Interference, fence
from qrsim.view.layers import Stage
from qrsim.view.server import start_server

ENTRIES: list[dict[str, Any]] = [
    {"kind": "jammer", "position_ned": [200.0, 0.0, -2.0], "power_w": 1.0e-3, "start": 20.0, "end": 40.0},
    {"kind": "outage", "systems": "R", "start": 10.0},
    {"kind": "disc", "position_ned": [0.0, 50.0, 0.0], "radius": 60.0},
    {"kind": "spoofer", "start": 5.0},
]


@pytest.fixture
def layer() -> Iterator[Interference]:
    server = start_server(0)
    stage = Stage(server.scene, cast(PLACES), 1.0)
    yield Interference(stage, tuple(item for item in of_scenario(ENTRIES) if item.place_ned is not None))
    server.stop()


class Watched:
    """Stands for a node, and counts what is sent to browsers."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "sent":
            super().__setattr__(name, value)
        else:
            self.sent.append((name, value))


def test_fences_stand_while_something_acts_and_cost_nothing_else(layer: Interference) -> None:
    layer._fences = watched = Watched()
    for time in np.arange(0.0, 60.0, 0.5):
        layer.draw(replace(frame(PLACES), time=float(time)))
    # The disc from the start; the jammer comes and goes; a spoofer that is heard everywhere has no place.
    assert [name for name, _ in watched.sent] == ["batched_scales"] * 3
    radii = [value[:, 0].tolist() for _, value in watched.sent]
    assert radii[0] == radii[2] == [0.0, 60.0]
    # 1 mW ends tracking within 224 m (docs/howto/jam_and_spoof.md).
    assert radii[1] == pytest.approx([224.0, 60.0], rel=0.02)


def test_a_world_says_the_same_as_its_scenario() -> None:
    fleet = {
        "sensors": {"gnss": {"type": "gnss"}},
        "vehicles": [{"position_ned": [0.0, 0.0, -10.0]}],
        "controller": {"type": "waypoint", "feed": "truth"},
    }
    content = {"name": "x", "duration": 60.0, "world": {"interference": ENTRIES}, "fleets": {"a": fleet}}
    scenario = load_scenario(content)
    said = {item.text: item for item in of_scenario(scenario.spec.model_dump()["world"]["interference"])}
    found = {item.text: item for item in of_world(scenario.world())}
    assert set(said) == {"jammer 1 mW", "outage of R", "no satellites", "spoofer"}
    assert set(found) == {"jammer 1 mW", "outage", "no satellites", "spoofer"}
    for text in ("jammer 1 mW", "no satellites", "spoofer"):
        one, other = said[text], found[text]
        assert (one.kind, one.when, one.start) == (other.kind, other.when, other.start)
        assert one.radius == pytest.approx(other.radius)
        assert (one.place_ned is None) == (other.place_ned is None) == (text == "spoofer")
        if one.place_ned is not None:
            np.testing.assert_allclose(one.place_ned, other.place_ned)
    assert found["jammer 1 mW"].when == "20 to 40 s"
    assert said["outage of R"].when == "from 10 s"


def test_a_fence_is_a_band_of_radius_1() -> None:
    corners, faces = fence()
    assert np.hypot(corners[:, 0], corners[:, 1]) == pytest.approx(np.ones(len(corners)))
    a, b, c = (corners[faces[:, i]].astype(float) for i in range(3))
    # Nearly that of a cylinder of radius 1 and height 1.
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area == pytest.approx(2.0 * np.pi, rel=0.001)
