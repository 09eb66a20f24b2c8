"""Winds as forecasts give them: a mean speed at a height over land of a roughness, and a gust."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest

from qrsim.errors import ScenarioError
from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.scenario import load_scenario

FORECAST: dict[str, Any] = {
    "type": "log_shear",
    "speed": 6.0,
    "at_height": 10.0,
    "gust": 10.0,
    "roughness": 0.1,
    "wind_from_deg": 225.0,
}


def forecast(**changes: Any) -> Any:
    wind = {name: value for name, value in {**copy.deepcopy(FORECAST), **changes}.items() if value is not None}
    return make_scenario([[0, 0, -10]], wind=wind).spec.world


def test_the_speed_is_that_at_its_height() -> None:
    """6 ln(6.096/0.1)/ln(10/0.1) = 5.3551 m/s at 20 ft; and the wind at 10 m is 6 m/s again."""
    assert forecast().wind.speed_20ft == pytest.approx(5.3551, abs=1e-4)
    wind = make_scenario([[0, 0, -10]], wind=FORECAST).world().wind
    found = wind.velocity_ned(np.float32([10.0, 0.05]))
    np.testing.assert_allclose(np.hypot(found.x, found.y), [6.0, 0.0], atol=1e-5)


def test_gusts_are_two_and_a_half_deviations() -> None:
    """(10 - 6)/2.5 = 1.6 m/s at 32.8 ft: W20 = 16 (0.177 + 0.000823 x 32.81)^0.4 = 8.4718 m/s."""
    turbulence = forecast().turbulence
    assert (turbulence.type, turbulence.speed_20ft) == ("dryden_field", pytest.approx(8.4718, abs=1e-4))
    assert forecast(gust=None).turbulence.type == "still"


@pytest.mark.parametrize(("speed", "at_20_ft"), [(6.0, 8.4718), (12.0, 16.9436), (0.0, 0.0)])
def test_a_gust_factor_follows_the_speed(speed: float, at_20_ft: float) -> None:
    """10/6 times 6 m/s is the gust of 10 m/s above; at twice the speed the gusts are twice as large."""
    assert forecast(gust=None, gust_factor=10.0 / 6.0, speed=speed).turbulence.speed_20ft == pytest.approx(
        at_20_ft, abs=1e-4
    )


def test_one_form_of_the_gust_replaces_the_other() -> None:
    """(9 - 6)/2.5 = 1.2 m/s: 8.4718 x 1.2/1.6 = 6.3539 m/s."""
    given = [f"world.wind={json.dumps(FORECAST)}", "world.wind.gust_factor=1.5"]
    found = load_scenario("hover_ideal", given).spec.world.turbulence
    assert found.speed_20ft == pytest.approx(6.3539, abs=1e-4)
    again = load_scenario("hover_ideal", [*given, "world.wind.gust=10"]).spec.world.turbulence
    assert again.speed_20ft == pytest.approx(8.4718, abs=1e-4)


def test_a_wind_at_20_ft_stays_what_it_was() -> None:
    plain = make_scenario([[0, 0, -10]], wind={"type": "log_shear", "speed_20ft": 5.0, "wind_from_rad": 0.0})
    assert plain.spec.world.wind.roughness == pytest.approx(0.15 * 0.3048)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"gust": 5.0},
            "world.wind.gust: 5 m/s; allowed: the mean speed, 6, to 75; gust_factor, a multiple of the speed, may take",
        ),
        ({"gust_factor": 1.6}, "world.wind.gust: gives both 'gust' and 'gust_factor'; give one"),
        ({"gust": None, "gust_factor": 0.9}, "world.wind.gust_factor: 0.9; allowed: 1 to 10"),
        ({"gust": None, "gust_factor": "1.6x"}, "world.wind.gust_factor: expected a number, found '1.6x'"),
        (
            {"gust": None, "speed": 40.0, "gust_factor": 2.0},
            "world.wind.gust_factor: 2 times 40 m/s is 80 m/s; allowed: to 75",
        ),
        ({"at_height": 0.0}, "world.wind.at_height: 0 m; allowed: above 0.2 (twice the roughness), at most 300"),
        ({"speed": None}, "world.wind.speed: missing; expected the mean speed [m/s] beside at_height and gust"),
        ({"speed_20ft": 5.0}, "world.wind.speed: gives both 'speed' and 'speed_20ft'; give one"),
        ({"speed": "6 m/s"}, "world.wind.speed: expected a number, found '6 m/s'"),
        ({"roughness": 0.0}, "world.wind.roughness: 0 m; allowed: above 0, at most 2"),
        ({"guts": 9.0}, "world.wind.guts: no such parameter of 'log_shear'; did you mean 'gust'?"),
        ({"speed": None, "sped": 6.0}, "world.wind.sped: no such parameter of 'log_shear'; did you mean 'speed'?"),
    ],
)
def test_what_cannot_be_meant(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        forecast(**changes)
    assert words in str(caught.value)


@pytest.mark.parametrize("speed", [4, 4.0, np.float32(4.0)])
def test_a_number_is_a_speed_at_10_m_from_the_north(speed: Any) -> None:
    """4 ln(20/0.15)/ln(32.808/0.15) = 3.6325 m/s at 20 ft."""
    found = make_scenario([[0, 0, -10]], wind=speed)
    assert found.spec.world.wind.speed_20ft == pytest.approx(3.6325, abs=1e-4)
    air = found.world().wind.velocity_ned(np.float32([10.0]))
    np.testing.assert_allclose([air.x[0], air.y[0]], [-4.0, 0.0], atol=1e-5)


@pytest.mark.parametrize(("wind", "words"), [(-4.0, "speed: -4 m/s; allowed: 0 to 50"), (True, "expected keys")])
def test_a_number_that_is_no_speed(wind: Any, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        make_scenario([[0, 0, -10]], wind=wind)
