"""Why vehicles have stopped, in words."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from qrsim.models.scene.area import REASONS, reason_code
from qrsim.view.reasons import code_in_words, in_words

AREA = SimpleNamespace(x_min=-200.0, x_max=200.0, y_min=100.0, y_max=300.0, z_min=-120.0, z_max=0.0)


@pytest.mark.parametrize(
    ("kind", "field", "value", "said"),
    [
        ("out_of_area", "position_ned.x", 200.1, "left the area to the north"),
        ("out_of_area", "position_ned.x", -200.04, "left the area to the south"),
        ("out_of_area", "position_ned.y", 99.0, "left the area to the west"),
        ("out_of_area", "position_ned.y", 301.0, "left the area to the east"),
        ("out_of_area", "position_ned.z", -120.3, "left the area through its ceiling"),
        ("out_of_area", "position_ned.z", 0.2, "left the area through its floor"),
        ("out_of_area", "fence", -1.25, "left the area by 1.25 m"),
        ("state_limit", "attitude.pitch", 1.5708, "turned beyond what its model holds for, pitch = 90°"),
        ("state_limit", "velocity_body.y", -15.06, "faster than its model holds for, -15.1 m/s along its y axis"),
        ("state_limit", "rates_body.z", 3.04, "turned faster than its model holds for, 3.0 rad/s about its z axis"),
        ("collision", "distance", 0.481, "came too close to another vehicle, 0.48 m"),
        ("collision", "obstacle", 3.0, "flew into obstacle 3"),
        ("hit_ground", "tilt", 0.5236, "hit the ground, tilted by 30°"),
        ("crashed", "impact_speed", 2.56, "crashed, at 2.6 m/s"),
        ("battery_empty", "charge", 0.0, "its battery is empty"),
        # Of an event that nobody here knows.
        ("task_failed", None, None, "task failed"),
        ("own_limit", "heat", 351.25, "own limit, heat = 351.2"),
    ],
)
def test_words(kind: str, field: str | None, value: float | None, said: str):
    assert in_words(kind, field, value, AREA) == said
    if (kind, field) in REASONS:
        assert value is not None
        assert field is not None
        assert code_in_words(reason_code(kind, field), value, AREA) == said


def test_without_an_area_the_side_is_not_said():
    assert in_words("out_of_area", "position_ned.x", 200.1) == "left the area, x = 200.1 m"


def test_every_reason_has_words():
    said = [code_in_words(code, 1.5, AREA) for code in range(1, len(REASONS))]
    assert len(set(said)) == len(said)
    assert not any("_" in words for words in said)
