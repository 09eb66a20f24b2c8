"""What a scenario may not ask of turbulence and gusts, in one line each, and what it is warned of."""

from __future__ import annotations

import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.errors import ScenarioError
from qrsim.scenarios.air import convection_speed
from qrsim.scenarios.scenario import load_scenario
from qrsim.world.air import gust_at

FIELD = "world.turbulence={type: dryden_field"
GUST = "world.gust={type: discrete, start_time: 3, length: 20, along: 3"

CALM = ("world.wind=calm", "world.turbulence=still")


def warned(*overrides: str) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario("patrol_plain", overrides)
    return [str(each.message) for each in caught]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([f"{FIELD}, chains: 14}}"], "turbulence.chains: 14; allowed: a multiple of 4, the nearest are 12 and 16"),
        ([f"{FIELD}, spectrum: karman}}"], "'karman' is not allowed; allowed: dryden, von_karman; did you mean 'von_k"),
        ([f"{FIELD}, octaves: 20}}"], "turbulence.octaves: 20 is out of range; allowed: 8 to 14"),
        ([f"{FIELD}, convection_height: -5}}"], "convection_height: -5 is out of range; allowed: 1 to 300"),
        ([f"{FIELD}, convection_ned: [1]}}"], "convection_ned: expected 2 numbers, found 1"),
        ([f"{FIELD}, convection_ned: 3}}"], "convection_ned: expected 2 numbers, found 3"),
        ([f"{FIELD}, convection_ned: [1, 101]}}"], "convection_ned.1: 101 is out of range; allowed: -100 to 100"),
        ([f"{FIELD}, lifetime: 5}}"], "turbulence.lifetime: 5 is out of range; allowed: 10 to 10 000"),
        ([f"{FIELD}, evolution: taylor}}"], "'taylor' is not allowed; allowed: lifetime, frozen"),
        (
            ["world.turbulence={type: dryden, near_ground: block}"],
            "allowed: blocked, constant; did you mean 'blocked'?",
        ),
        ([f"{FIELD}, sweep: -1}}"], "turbulence.sweep: -1 is out of range; allowed: 0 to 10"),
        ([f"{FIELD}, residual: filter, spectrum: von_karman}}"], "residual: 'filter' continues the Dryden form only"),
        ([f"{FIELD}}}", "world.wind=calm"], "turbulence.speed_20ft: missing; it would be taken from world.wind.speed"),
        (["world.turbulence=dryden_fild"], "no such type 'dryden_fild'; did you mean 'dryden_field'?"),
        ([f"{GUST}}}"], "world.gust.speed: missing (at which vehicles cross it, m/s; only a travelling gust has"),
        ([f"{GUST}, front: travelling}}", *CALM], "world.gust.speed: missing; it would be that of the wind"),
        ([f"{GUST}, speed: 3}}", *CALM], "world.gust.wind_from_deg: missing; it would be that of the wind"),
    ],
)
def test_faults_are_said_in_one_line(overrides: list[str], words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario("patrol_plain", overrides)
    assert len(caught.value.problems) == 1
    assert words in caught.value.problems[0]


def test_a_field_that_stands_still_is_warned_of() -> None:
    (words,) = warned(f"{FIELD}, convection_ned: [0.3, 0], evolution: frozen}}")
    assert "the field moves at 0.3 m/s, its sweep is 0 m/s and it is frozen, so a vehicle that hovers meets" in words
    (words,) = warned(f"{FIELD}, speed_20ft: 3, lifetime: 210}}", "world.wind=calm")
    assert "moves at 0 m/s, its sweep is 0 m/s and its waves have a lifetime of 210 s, so" in words
    for fine in (
        [f"{FIELD}, speed_20ft: 3, lifetime: 200}}", "world.wind=calm"],
        [f"{FIELD}, convection_ned: [0.3, 0]}}"],
        [f"{FIELD}, convection_ned: [0.3, 0], sweep: 0.2, evolution: frozen}}"],
        [f"{FIELD}, speed_20ft: 0}}", "world.wind=calm"],
        [f"{FIELD}}}"],
    ):
        assert warned(*fine) == []


def test_what_carries_gusts_is_the_mean_wind_at_20_m_or_what_the_field_says(tmp_path: Path) -> None:
    """u20 ln(h/z0)/ln(20 ft/z0) with z0 = 0.15 ft; of a recorded wind the mean over time, 2 m/s for 1 s, then to 4."""

    def speed(*overrides: str) -> float:
        return convection_speed(load_scenario("patrol_plain", ["world.wind.speed_20ft=5", *overrides]).spec)

    assert speed("world.turbulence=still") == pytest.approx(5.0 * 6.08095 / 4.89285, rel=1e-4)
    assert speed(f"{FIELD}, convection_height: 6.096}}") == pytest.approx(5.0, rel=1e-5)
    assert speed(f"{FIELD}, convection_ned: [3, -4]}}") == 5.0
    file = tmp_path / "wind.csv"
    file.write_text("time,north,east,down\n0,2,0,0\n1,2,0,0\n2,4,0,1\n5,4,0,1\n")
    recorded = [f"world.wind={{type: series, file: {file}}}", "duration=4", "world.turbulence=still"]
    content = load_scenario("patrol_plain", recorded)
    assert convection_speed(content.spec) == pytest.approx((2.0 + 3.0 + 12.0) / 5.0)


@pytest.mark.long
def test_a_world_hands_a_travelling_gust_the_velocity_that_carries_the_turbulence() -> None:
    """That of the mean wind at 20 m, 5 m/s x 6.08095/4.89285."""
    gusts = []
    for more in ("", ", speed: 6.21412, wind_from_deg: 30"):
        wind = ["world.wind.speed_20ft=5", "world.wind.wind_from_deg=30", "world.turbulence=still"]
        world = load_scenario("patrol_plain", [*wind, f"{GUST}, front: travelling{more}}}"]).world()
        place = world.fleets[0].start.position_ned
        gusts.append(gust_at(world, None, None, -place.z, place, (jnp.int32(6), jnp.float32(0.0))).stack())
    assert float(jnp.ptp(gusts[1])) > 0.5
    np.testing.assert_allclose(*gusts, atol=1e-4)
