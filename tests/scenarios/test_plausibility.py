"""What is allowed and cannot fly is warned of, with numbers worked out by hand; what flies is not."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.cli import main
from qrsim.models.atmosphere.turbulence import low_altitude_scales
from qrsim.scenarios import wind_limits
from qrsim.scenarios.scenario import built_in_names, load_scenario

VEHICLE = "fleets.pelicans.vehicle"


def warned(*overrides: str) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario("patrol_plain", overrides)
    return [str(each.message) for each in caught]


@pytest.mark.parametrize("name", built_in_names())
def test_what_comes_with_qrsim_flies(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scenario(name)


@pytest.mark.parametrize(
    "overrides",
    [
        ["world.wind.speed_20ft=7", "world.turbulence=still"],
        ["world.wind.speed_20ft=8"],
        [f"{VEHICLE}.mass=2.4", "world.wind.speed_20ft=4"],
        [f"{VEHICLE}={{type: quadrotor}}"],
        [f"{VEHICLE}={{type: expression, tilt_law: 179.8*(0.75*command - angle) - 24.4*rate}}"],
        ["fleets.pelicans.battery={type: lithium_polymer}"],
        ["time_step=0.001"],
    ],
)
def test_what_is_usual_gives_no_warning(overrides: list[str]) -> None:
    assert warned(*overrides) == []


@pytest.mark.parametrize(
    ("override", "words"),
    [
        # 4 kg x 9.81 m/s^2; -18.0007 N + 4.23754 N/V x 12 V.
        ("mass=4", "mass: 4 kg weigh 39.2 N and the largest thrust, at 12 V, is 32.8 N, 0.84 of the weight: it cannot"),
        ("mass=3", "3 kg weigh 29.4 N and the largest thrust, at 12 V, is 32.8 N, 1.12 of the weight: little is left"),
        ("mass=[1.6, 1.6, 4, 1.6, 1.6]", "vehicle.mass.2: 4 kg weigh 39.2 N"),
        ("mass=0.05", "0.05 kg weigh 0.491 N, and without throttle the thrust is 0.664 N (cth0): it cannot come down"),
        ("gravity=1.62", "gravity: 1.62 m/s^2; on Earth"),
        # Roots of s^2 + 24.3536 s - 10, s^2 - 5 s + 179.797 (real part 5 / 2).
        ("kpq1=-10", "the tilt loop is unstable: stiffness -10 1/s^2 and damping 24.3536 1/s have a root at 0.404 1/s"),
        ("kpq2=5", "stiffness 179.797 1/s^2 and damping -5 1/s have a root at 2.5 1/s"),
        # 0.5 / (2 sqrt(179.797)).
        ("kpq2=-0.5", "hardly damped: stiffness 179.797 1/s^2 and damping 0.5 1/s have a damping ratio of 0.0186"),
        # A root beyond -2 / 0.02 s.
        ("kpq2=-200", "is too fast for a time step of 0.02 s"),
        ("kr1=3", "kr1: the yaw rate is unstable: 3 1/s"),
        ("kuv=-101", "kuv: -101 1/s is too fast for a time step of 0.02 s"),
    ],
)
def test_what_cannot_fly_is_told_with_its_numbers(override: str, words: str) -> None:
    found = warned(f"{VEHICLE}.{override}")
    assert found[0].startswith("patrol_plain: fleets.pelicans.vehicle.")
    assert words in found[0]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        # Damping ratios of 0.11 and 0.09: 2 sqrt(179.797) is 26.8177.
        ("kpq2=-2.95", ""),
        ("kpq2=-2.4136", "hardly damped"),
        # Mountains and poles, and no place on Earth.
        ("gravity=9.76", ""),
        ("gravity=9.84", ""),
        ("gravity=9.6", "on Earth"),
        ("gravity=10.1", "on Earth"),
    ],
)
def test_from_where_on_it_is_told(override: str, words: str) -> None:
    assert words in " ".join(warned(f"{VEHICLE}.{override}"))
    assert bool(warned(f"{VEHICLE}.{override}")) == bool(words)


def test_loops_of_their_own_are_judged_too() -> None:
    assert "kq1: the pitch loop is unstable" in warned(f"{VEHICLE}={{type: quadrotor, kq1: -5}}")[0]
    assert (
        "tilt_law: the tilt loop is unstable"
        in warned(f"{VEHICLE}={{type: expression, tilt_law: 9*(angle - command)}}")[0]
    )
    # Its roots overflow.
    huge = "{type: expression, tilt_law: -1e308*(command - angle) - 24.35*rate}"
    assert "tilt_law: the tilt loop is unstable" in warned(f"{VEHICLE}={huge}")[0]


def test_the_law_of_the_warning_is_that_of_the_flight() -> None:
    """The lean that a command of 0.9 rad gives, flown open loop, and the airspeed at which drag balances it."""
    from qrsim.models.vehicles.quadrotor import Quadrotor
    from qrsim.simulation.openloop import hover_state, simulate_open_loop

    vehicle = Quadrotor(process_noise=0.0, kw=-1e3, rate_max=99.0)
    lean = 0.9 * 3.2506e-4 / math.radians(0.025)
    start = hover_state(vehicle)
    commands = np.tile([-0.9, 0.0, 0.78, 0.0, 12.0], (1500, 1))
    flown = simulate_open_loop(vehicle, commands, start, dt=0.001)[-1]
    assert flown[4] == pytest.approx(-lean, abs=0.02)
    # With so much thrust that it is the lean that ends it.
    (found,) = warned("world.wind.speed_20ft=50", "world.turbulence=still", f"{VEHICLE}.cvb0=100")
    assert f"0.67 rad (38 deg), it holds an airspeed of {9.81 * math.tan(lean) / 0.497391:.3g} m/s" in found


def test_wind_is_that_of_the_highest_place() -> None:
    # 12 ln(60 / 0.3048 / 0.15) / ln(20 / 0.15) and twice 1.2 / (0.177 + 0.000823 x 196.85)^0.4.
    (found,) = warned("world.wind.speed_20ft=12")
    assert "world.wind: 17.6 m/s and gusts of 3.7 m/s at 60 m, where fleets.pelicans.vehicles.4 is to fly" in found
    # Eq. 6 in balance, where the thrust ends: -18.0007 N + 4.23754 N/V x 12 V.
    assert "with all its thrust, 32.8 N at 12 V, leaning 36 deg, it holds an airspeed of 14.5 m/s" in found
    # The published tilt limit.
    (found,) = warned("fleets.pelicans.controller={type: waypoint, tilt_limit: 0.34}")
    assert "0.34 rad, it holds an airspeed of 5.11 m/s" in found


@pytest.mark.parametrize(
    ("speed", "words"),
    [
        # At 60 m 1.467 times as much, and gusts of 0.154 times as much: 12.8 and 13.0 m/s against 13.8.
        (7.9, ""),
        (8.6, "leaning as far as its controller lets it, 0.611 rad, it holds an airspeed of 13.8 m/s"),
    ],
)
def test_a_cascade_leaves_room_for_gusts(speed: float, words: str) -> None:
    more = f"{VEHICLE}.cvb0=100"
    found = warned(f"world.wind.speed_20ft={speed}", "fleets.pelicans.controller={type: cascade}", more)
    assert words in " ".join(found)
    assert bool(found) == bool(words)


def test_loops_without_an_integral_stand_short_of_their_waypoints() -> None:
    # 0.09 rad s/m x 0.9 1/s x 3 m of error lean it by 0.745 as much (eq. 6): 0.181 rad, 9.81 tan(0.181) / 0.497391.
    loops = "fleets.pelicans.controller=waypoint", "fleets.pelicans.guidance={type: route, repeat: false}"
    (found,) = warned(*loops, "world.wind.speed_20ft=3")
    assert "world.wind: 4.4 m/s at 60 m, where fleets.pelicans.vehicles.4 is to fly; above 3.61 m/s" in found
    assert warned(*loops, "world.wind.speed_20ft=3", "fleets.pelicans.guidance.acceptance_radius=4") == []
    assert warned(*loops, "world.wind.speed_20ft=2.4") == []


def test_recorded_wind(tmp_path: Path) -> None:
    path = tmp_path / "wind.csv"
    path.write_text("time,north,east,down\n" + "".join(f"{i},{30 if i == 50 else 0},0,0\n" for i in range(130)))
    found = warned(f"world.wind={{type: series, file: {path}}}", "world.turbulence=still")
    assert len(found) == 1
    assert "world.wind: 30 m/s at " in found[0]


def test_a_pack_of_six_cells_flies_and_is_told() -> None:
    battery = "fleets.pelicans.battery={type: lithium_polymer, voltage_full: 25.2, voltage_empty: 19.8}"
    found = warned(battery)
    # -18.0007 + 4.23754 x 25.2.
    assert "battery.voltage_full: 25.2 V; the largest thrust (cvb0, cvb1) was identified from 9 to 12 V" in found[0]
    assert "88.8 N" in found[0]
    # The line of a vehicle of one's own.
    assert warned(battery, f"{VEHICLE}.cvb0=-18.0", f"{VEHICLE}.cvb1=2.0") == []


def test_a_capacity_in_mah_is_told() -> None:
    (found,) = warned("fleets.pelicans.battery={type: lithium_polymer, capacity: 6250}")
    assert found.endswith("fleets.pelicans.battery.capacity: 6250 Ah; 6250 mAh of a label are 6.25 Ah")
    assert warned("fleets.pelicans.battery={type: lithium_polymer, capacity: 62.5}") == []


def test_a_pack_of_six_cells_gives_its_voltage() -> None:
    """In flight it is neither brought into the range of commands nor counted as clipped."""
    content: dict[str, Any] = {
        "name": "six",
        "fleets": {
            "a": {
                "vehicle": {"type": "pelican", "cvb0": -18.0, "cvb1": 2.0},
                "battery": {"type": "lithium_polymer", "voltage_full": 25.2, "voltage_empty": 19.8},
                "controller": {"type": "waypoint", "feed": "truth"},
                "vehicles": [{"position_ned": [0.0, 0.0, -20.0]}],
            }
        },
    }
    sim = qrsim.load(content)
    sim.reset()
    sim.step(ticks=5)
    # Full, less 0.02 ohm x 6.25 Ah x 3600 s / 960 s at hover.
    assert float(sim.state.fleets[0].command.battery[0]) == pytest.approx(25.2 - 0.02 * 23.4375, abs=0.02)
    assert not sim.state.fleets[0].command_clipped.any()


def test_the_command_line_says_each_once(capsys: Any) -> None:
    assert main(["show", "patrol_plain", "--set", f"{VEHICLE}.mass=4"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "cannot stay in the air" in line]
    assert len(lines) == 1
    assert lines[0].startswith("warning: patrol_plain: fleets.pelicans.vehicle.mass: 4 kg weigh 39.2 N")


@pytest.mark.parametrize(
    "wind",
    [
        {"type": "calm"},
        {"type": "log_shear", "speed_20ft": 7.0, "wind_from_deg": 30},
        {"type": "veering_shear", "speed_20ft": 7.0, "wind_from_deg": 30, "profile": "log"},
        {"type": "veering_shear", "speed_20ft": 7.0, "wind_from_deg": 30, "profile": "power", "exponent": 0.2},
    ],
    ids=lambda wind: f"{wind['type']} {wind.get('profile', '')}",
)
def test_its_wind_and_gusts_are_those_of_the_models(wind: dict[str, Any]) -> None:
    """It has them in NumPy, because a first use of JAX would take longer than to read the scenario."""
    turbulence = {"type": "dryden", **({} if "speed_20ft" in wind else {"speed_20ft": 4.0, "wind_from_deg": 30})}
    scenario = load_scenario(
        {"name": "x", "extends": "hover_ideal", "world": {"wind": wind, "turbulence": turbulence}}, quiet=True
    )
    world, heights = scenario.world("float64"), np.array([0.01, 3.0, 20.0, 120.0, 280.0])
    with jax.enable_x64(True):
        air = world.wind.velocity_ned(jnp.asarray(heights), jnp.asarray(0), jnp.asarray(0.0))
        speed = np.sqrt(np.asarray(air.dot(air)))
        _, ratios = low_altitude_scales(jnp.asarray(heights))
    np.testing.assert_allclose(wind_limits.mean_wind(scenario.spec, heights), speed, rtol=1e-9, atol=1e-12)
    sigma = 0.1 * wind.get("speed_20ft", 4.0) * np.asarray(ratios.x)
    np.testing.assert_allclose(wind_limits.gust_sigma(scenario.spec, heights), sigma, rtol=1e-9)


def test_a_mass_in_grams_is_one_warning_with_one_thrust() -> None:
    """1650 kg x 9.81 m/s^2; wind is no matter for what cannot fly."""
    (found,) = warned(f"{VEHICLE}.mass=1650", "world.wind.speed_20ft=4")
    assert "1650 kg weigh 1.62e+04 N and the largest thrust, at 12 V, is 32.8 N" in found
    assert found.endswith("it cannot stay in the air; masses are in kg: 1650 g are 1.65 kg")


@pytest.mark.parametrize(("speed", "expected"), [(60.0, 0), (500.0, 1)])
def test_a_recorded_wind_that_is_none(speed: float, expected: int, tmp_path: Path) -> None:
    path = tmp_path / "wind.csv"
    path.write_text(f"time,north,east,down\n0,1,2,0\n5,{speed},0,0\n15,0,0,0\n50,0,0,0\n100,0,0,0\n")
    found = warned(f"world.wind={{type: series, file: {path}, max_gap: 100}}", "world.turbulence=still", "duration=20")
    about = [words for words in found if "plausible" in words]
    assert len(about) == expected
    for words in about:
        assert f"{path}: the air moves at 500 m/s at 5 s of the run; plausible: up to 75 m/s" in words


def test_a_motor_table_of_a_scenario_is_warned_of_once() -> None:
    table = {"throttle_percent": [50, 100], "thrust_g": [510, 1390], "rpm": [39, 64], "power_W": [58, 270]}
    own = {"mass": 3.5, "arm": 0.35, "rotors": 6, "attitude_bandwidth": 6.0, "motor_table": table}
    vehicle = {"type": "multirotor", "own": own}
    fleet = {"vehicle": vehicle, "sensors": "ideal", "vehicles": [{"position_ned": [0, 0, -20]}]}
    content = {
        "name": "hexas",
        "fleets": {"a": fleet},
    }
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario(content)
    (found,) = [str(each.message) for each in caught if "plausible" in str(each.message)]
    assert found.startswith("hexas: fleets.a.vehicle.own.motor_table: rpm of row 2 is 64: the tips")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scenario(content, quiet=True)
