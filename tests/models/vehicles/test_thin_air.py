"""What the density of the air does to vehicles: against ISO 2533 and momentum theory."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.models.atmosphere.standard import SiteAir
from qrsim.models.vehicles.contracts import Around
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.scenarios.derived import derived_of
from qrsim.scenarios.scenario import load_scenario

# sqrt(1.2250/0.909122): ISO 2533 has 0.909122 kg/m^3 at 3000 m (geopotential).
THIN = 1.160803


def hovering(height: float = 0.0, battery: str = "lithium_cells", offset: float = 0.0, **vehicle: Any) -> Any:
    return {
        "name": "thin_air",
        "duration": 10.0,
        "site": {"height": height, "temperature_offset": offset},
        "fleets": {
            "quads": {
                "vehicle": {"type": "multirotor", **({"model": "x500"} | vehicle)},
                "controller": {"type": "cascade", "feed": "truth"},
                "battery": {"type": battery},
                "vehicles": [{"position_ned": [0.0, 0.0, -10.0]}],
            }
        },
    }


@pytest.mark.parametrize(("dtype", "rtol"), [(np.float32, 2e-5), (np.float64, 1e-5)])
def test_densities_of_the_standard_atmosphere(dtype: Any, rtol: float) -> None:
    """ISO 2533 at 0, 1000, 3000 and 6000 m, from the site and from above it; at sea level to the last bit."""
    with jax.enable_x64(dtype == np.float64):
        for height in (0.0, -400.0, 2500.0):
            above = np.array([0.0, 1000.0, 3000.0, 6000.0]) - height
            place: Any = Vec3(*(jnp.asarray(part, dtype) for part in (0.0 * above, 0.0 * above, -above)))
            found = np.asarray(cast(SiteAir.of(height), dtype).density(place))
            assert found.dtype == dtype
            np.testing.assert_allclose(found, [1.2250, 1.11164, 0.909122, 0.659697], rtol=rtol)
            assert height != 0.0 or found[0] == dtype(1.225)


def test_a_cold_day_is_dense() -> None:
    """At -40 C and 1013.25 hPa 1.225 x 288.15/233.15 kg/m^3; 20 K warmer at 3000 m 0.909122 x 268.65/288.65."""
    assert float(SiteAir.of(0.0, -55.0).site_density) == pytest.approx(1.51397, abs=1e-5)
    assert float(SiteAir.of(3000.0, 20.0).site_density) == pytest.approx(0.846131, abs=2e-6)


def test_hover_at_three_thousand_metres() -> None:
    """Speed and power by the root of the density, thrust by the density; 5 W are those of the avionics."""
    low, high = (derived_of(load_scenario(hovering(height)))["quads"] for height in (0.0, 3000.0))
    assert low["hover_speed_rad_s"] == pytest.approx(769.56, abs=0.01)
    assert high["hover_speed_rad_s"] / low["hover_speed_rad_s"] == pytest.approx(THIN, abs=1e-4)
    assert low["hover_power_W"] == pytest.approx(337.5, abs=0.1)
    assert (high["hover_power_W"] - 5.0) / (low["hover_power_W"] - 5.0) == pytest.approx(THIN, abs=2e-4)
    assert high["thrust_to_weight"] / low["thrust_to_weight"] == pytest.approx(0.742140, abs=1e-4)
    assert high["hover_throttle"] / low["hover_throttle"] == pytest.approx(THIN, abs=1e-4)
    assert high["air_density_kg_m3"] == pytest.approx(0.909122, abs=1e-6)
    # A pack by its endurance has that of sea level over the same.
    of_thrust = derived_of(load_scenario(hovering(3000.0, "lithium_polymer")))["quads"]
    assert of_thrust["hover_endurance_s"] == pytest.approx(960.0 / THIN, rel=1e-3)


def test_thin_air_that_is_ignored_changes_nothing() -> None:
    low, high = (derived_of(load_scenario(hovering(h, thin_air="ignored")))["quads"] for h in (0.0, 3000.0))
    assert low == high


@pytest.mark.long
def test_a_flight_at_three_thousand_metres_takes_more_speed_power_and_throttle() -> None:
    found = []
    for height in (0.0, 3000.0):
        scenario = load_scenario(hovering(height))
        simulation = qrsim.Simulation(scenario.world())
        simulation.reset(seed=1)
        simulation.step(ticks=400)
        state = simulation.state.fleets[0]
        vehicle: Any = simulation.world.fleets[0].vehicle
        load = vehicle.load(state.vehicle)
        assert float(load.thrust[0]) == pytest.approx(20.2508, abs=0.02)
        assert float(simulation.truth.position_ned[0, 2]) == pytest.approx(-10.0, abs=0.01)
        command: Any = state.command
        found.append((float(state.vehicle.rotor_speed[0][0]), float(load.power[0]) - 5.0, float(command.throttle[0])))
    np.testing.assert_allclose(np.array(found[1]) / np.array(found[0]), THIN, rtol=2e-3)


def test_drag_and_thrust_of_an_instant_go_with_the_density() -> None:
    """In 10 m/s of wind from the north at 3000 m: 0.909122/1.225 of the force at the same speeds of the rotors."""
    forces = []
    with jax.enable_x64(True):
        zero = jnp.zeros(1)
        still = Vec3(zero, zero, zero)
        for height in (0.0, 3000.0):
            vehicle: Any = cast(SETS["hummingbird"]().in_air(SiteAir.of(height)), np.float64)
            place = Vec3(zero, zero, zero)
            state = vehicle.initial_state(place, qrsim.Euler(zero, zero, zero), still, still)
            state = replace(state, rotor_speed=(zero + 500.0,) * 4)
            command, wind = vehicle.idle_command(zero), Vec3(zero - 10.0, zero, zero)
            around = Around(lambda place: (zero + 5000.0, Vec3(zero, zero, zero - 1.0)), still)
            noise = ProcessNoise(still, still)
            force = vehicle.specific_force(state, command, lambda trig, wind=wind: wind, noise, 0.02, around)
            forces.append([float(axis[0]) for axis in force.axes])
    assert forces[0][0] < -1.0
    np.testing.assert_allclose(np.array(forces[1])[[0, 2]] / np.array(forces[0])[[0, 2]], 0.742140, rtol=1e-4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"height": 6000.0},
            r"cannot hover: 4 rotors lift 18\.41 N at speed_max in the air of the site, 0\.6597 kg/m\^3",
        ),
        ({"offset": -300.0}, r"site\.temperature_offset: -300\.0 is out of range; allowed: -80 to 50"),
        ({"height": 20000.0}, r"site\.height: 20000\.0 is out of range; allowed: -500 to 9000"),
    ],
)
def test_air_in_which_nothing_flies(changes: dict[str, float], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        load_scenario(hovering(**changes))  # type: ignore[arg-type]


def test_a_strong_vehicle_flies_at_six_thousand_metres_at_forty_below() -> None:
    """ISO 2533 has 249.15 K there, so that -40 C is 16 K less: 0.659697 x 249.15/233.15 kg/m^3."""
    found = derived_of(load_scenario(hovering(6000.0, offset=-16.0, model="hummingbird")))["quads"]
    assert found["air_density_kg_m3"] == pytest.approx(0.704969, abs=2e-6)
    assert found["thrust_to_weight"] == pytest.approx(4 * 5.57e-6 * 1500**2 * 0.704969 / 1.225 / 4.905, rel=1e-4)


@pytest.mark.parametrize(
    ("model", "efficiency"), [("x500", 0.386), ("hummingbird", 0.261), ("pelican", 0.417), ("hexa4", 0.518)]
)
def test_how_much_of_the_power_is_induced_in_hover(model: str, efficiency: float) -> None:
    """T^1.5/sqrt(2 rho A) of each rotor over the electrical power; 0.65 x 0.8 is a good drive (Leishman)."""
    vehicle: Any = SETS[model]()
    thrust = vehicle.mass * vehicle.gravity / len(vehicle.rotors)
    ideal = thrust**1.5 / math.sqrt(2.0 * 1.225 * math.pi * vehicle.rotor_radius**2)
    zero = np.zeros(1)
    still: Any = Vec3(zero, zero, zero)
    state = vehicle.initial_state(still, qrsim.Euler(zero, zero, zero), still, still)
    power = (float(vehicle.load(state).power[0]) - vehicle.avionics_power) / len(vehicle.rotors)
    assert ideal / power == pytest.approx(efficiency, abs=0.001)


@pytest.mark.parametrize(("arm", "rotors"), [(0.12, 4), (0.225, 4), (0.45, 6)])
def test_half_of_the_power_of_a_multirotor_of_ones_own_is_induced(arm: float, rotors: int) -> None:
    vehicle: Any = qrsim.own_multirotor(
        mass=1.2, arm=arm, rotors=rotors, hover_throttle=0.5, thrust_to_weight=2.2, attitude_bandwidth=6.0
    )
    thrust = 1.2 * 9.81 / rotors
    ideal = thrust**1.5 / math.sqrt(2.0 * 1.225 * math.pi * vehicle.rotor_radius**2)
    speed = math.sqrt(thrust / vehicle.thrust_coefficient)
    assert ideal / (vehicle.torque_ratio * thrust * speed / vehicle.efficiency) == pytest.approx(0.52, rel=1e-6)


@pytest.mark.long
def test_a_wing_at_three_thousand_metres_flies_at_a_larger_angle() -> None:
    """In 0.8998 kg/m^3 at 3100 m the lift of (W2) is 107.9 N at 25 m/s: about 107.9/(0.5 rho V^2 S) = 0.697 of CL.

    CL0 = 0.23 and CLa = 5.61 leave 0.083 rad, with what the elevator pushes down 0.0879; at sea level it is 0.053. On a
    day 20 K warmer its pitot tube has 25 m/s less by the root of the density, 0.8381 kg/m^3.
    """
    found = []
    for offset in (0.0, 20.0):
        content = hovering(3000.0, offset=offset)
        content["world"] = {"area": {"type": "box", "x_min": -2000.0, "x_max": 2000.0, "z_min": -400.0}}
        content["fleets"]["quads"] = {
            "vehicle": {"type": "fixed_wing"},
            "controller": {"type": "fixed_wing", "feed": "truth"},
            "guidance": {"type": "fixed_wing", "radius": 300.0},
            "sensors": {"pitot": {"type": "ideal_airspeed"}},
            "vehicles": [{"position_ned": [-1000.0, 0.0, -100.0], "waypoints_ned": [[1500.0, 0.0, -100.0]]}],
        }
        simulation = qrsim.Simulation(load_scenario(content).world())
        simulation.reset(seed=1)
        simulation.step(ticks=1000)
        state: Any = simulation.state.fleets[0].vehicle
        pitot = simulation.reading.pitot
        found.append((float(state.angle_of_attack[0]), float(state.airspeed[0])))
        density = 0.8998 if offset == 0.0 else 0.8381
        ratio = float(pitot.indicated_airspeed[0] / pitot.true_airspeed[0])
        assert ratio == pytest.approx(math.sqrt(density / 1.225), rel=1e-3)
        assert float(pitot.true_airspeed[0]) == pytest.approx(found[-1][1] * math.cos(found[-1][0]), rel=1e-3)
    assert found[0] == pytest.approx((0.0879, 25.0), abs=0.002)
    assert found[1] == pytest.approx((0.0976, 25.0), abs=0.002)
