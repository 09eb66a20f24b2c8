"""Parameters that PX4 is told of a vehicle, and vehicles and sensors that it cannot fly."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from px4_flown import PAIR, RATE, Flown, own, world_of

from qrsim.core.tree import replace
from qrsim.errors import UsageError
from qrsim.links.autopilot.fleet import prepared as in_the_air
from qrsim.links.autopilot.lockstep import FlownFleet, LockstepFlight
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.px4_flight import motor_order, prepared
from qrsim.links.autopilot.px4_parameters import parameters
from qrsim.models.vehicles.multirotor.geometry import Rotor
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation


@pytest.mark.long
@pytest.mark.parametrize(("geometry", "rotors", "kind"), [("hexa_x", 6, 13), ("octo_x", 8, 14)])
def test_the_geometry_that_px4_is_told_is_that_of_the_vehicle(geometry: str, rotors: int, kind: int) -> None:
    """Vehicle i has motor i 10 % faster than the others: it turns as a PX4 with these parameters expects."""
    scenario, _ = in_the_air(load_scenario(own(geometry, rotors), quiet=True), (), "x500", RATE, "PX4")
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    (fleet,) = simulation.world.fleets

    class Faster(FlownFleet):
        def speeds(self, number: int) -> list[float]:
            return [0.7 * (1.1 if motor == number else 1.0) for motor in range(rotors)]

    flown = Faster(simulation, fleet, motor_order(fleet), Losses(None))
    flight = LockstepFlight(simulation)
    flight.fleets.append(flown)
    flight.advance(12)
    told = parameters(fleet, flown.order, flown.sight, 0)
    rates = np.asarray(simulation.truth.rates_body)
    for motor in range(rotors):
        x, y, turn = (told[f"CA_ROTOR{motor}_{name}"] for name in ("PX", "PY", "KM"))
        # A motor on the right lifts the right side; one in front the nose; KM > 0 turns counter-clockwise from above,
        # and the vehicle clockwise.
        for rate, expected in zip(rates[motor], (-y, x, turn), strict=True):
            assert abs(expected) < 0.01 * abs(x + y) or rate * expected > 0.0, (motor, rates[motor], (x, y, turn))
    # A zero counts as not set, and the airframe's own place would hold.
    assert all(abs(told[f"CA_ROTOR{motor}_{axis}"]) >= 1e-4 for motor in range(rotors) for axis in ("PX", "PY"))
    assert (told["CA_ROTOR_COUNT"], told["MAV_TYPE"], told[f"PWM_MAIN_FUNC{rotors}"]) == (rotors, kind, 100 + rotors)


@pytest.mark.long
@pytest.mark.parametrize(("geometry", "rotors"), [("hexa_x", 6), ("quad_plus", 4)])
def test_other_vehicles_fly_by_what_px4_is_told_of_them(geometry: str, rotors: int) -> None:
    flown = Flown(own(geometry, rotors, 1))
    (told,) = flown.flight.parameters()
    names = ("PX", "PY", "KM")
    motors = [tuple(told[f"CA_ROTOR{motor}_{name}"] for name in names) for motor in range(rotors)]
    assert not flown.flight.fleets[0].is_iris
    low = flown.heights[0]
    flown.fly(6.0, rotors=[motors], hover=told["MPC_THR_HOVER"])
    assert flown.heights[0] - low == pytest.approx(3.0, abs=0.4)
    assert np.abs(np.asarray(flown.simulation.truth.attitude)[0]).max() < 0.2


def test_the_x500_has_the_motors_of_the_iris_and_its_own_geometry() -> None:
    flown = Flown()
    (fleet,) = flown.flight.fleets
    assert fleet.is_iris
    found = flown.flight.parameters()[1]
    flown.flight.close()
    # PX4-gazebo-models, x500: rotors at 0.174 m, motor 1 front right and counter-clockwise, 2 rear left, 3 front left.
    assert [found[f"CA_ROTOR{motor}_PX"] for motor in range(4)] == [0.174, -0.174, 0.174, -0.174]
    assert [found[f"CA_ROTOR{motor}_PY"] for motor in range(4)] == [0.174, -0.174, -0.174, 0.174]
    assert [found[f"CA_ROTOR{motor}_KM"] for motor in range(4)] == pytest.approx([0.016, 0.016, -0.016, -0.016])
    assert [found[f"PWM_MAIN_FUNC{motor}"] for motor in (1, 2, 3, 4)] == [101, 102, 103, 104]
    # 2.0643 kg, 9.81 m/s^2, four rotors of 8.54858e-6 N s^2 at 1000 rad/s, in air of 1.167 kg/m^3 at 488 m.
    assert found["MPC_THR_HOVER"] == pytest.approx(20.251 / (34.194 * 1.1681 / 1.225), rel=0.01)
    # A fix is reported after one period of 0.2 s.
    assert (found["SENS_GPS0_DELAY"], found["EKF2_DELAY_MAX"], found["THR_MDL_FAC"]) == (200, 250, 1.0)
    assert (found["EKF2_MULTI_IMU"], found["EKF2_MULTI_MAG"], found["MAV_TYPE"]) == (1, 1, 2)
    assert not {"SYS_HAS_MAG", "SYS_HAS_BARO"} & set(found)


def test_hover_thrust_and_torques_stay_within_what_px4_takes() -> None:
    bare = SimpleNamespace(sensors={})
    content = own("quad_x", 4, 1)
    numbers = content["fleets"]["field"]["vehicle"]["own"]
    for ratio, throttle, expected in ((2.0, 0.5, 0.5), (20.0, 0.1, 0.1), (1.2, 0.9, 0.8)):
        numbers |= {"thrust_to_weight": ratio, "hover_throttle": throttle}
        told = parameters(world_of(content), (0, 1, 2, 3), bare, 0)
        # The air at 488 m is 4.6 % thinner than that of the data sheet.
        assert told["MPC_THR_HOVER"] == pytest.approx(
            min(expected / 0.9535, 0.8) if ratio == 2.0 else expected, rel=0.01
        )
    x500 = replace(world_of(PAIR).vehicle, torque_ratio=0.05)
    fleet = SimpleNamespace(vehicle=x500)
    # 0.05 is what PX4 is built with, and the airframe's -0.05 would hold for motors 3 and 4.
    told = parameters(fleet, (0, 1, 2, 3), bare, 0)
    assert sorted(told[f"CA_ROTOR{motor}_KM"] for motor in range(4)) == [-0.05, -0.05, 0.0501, 0.0501]


def test_more_rotors_than_px4_has_motors_are_refused() -> None:
    rotors = [Rotor((math.cos(i), math.sin(i), 0.0), 1) for i in range(13)]
    with pytest.raises(UsageError, match="fleet 'many': 13 rotors, and PX4 has at most 12 motors"):
        motor_order(SimpleNamespace(name="many", vehicle=SimpleNamespace(rotors=rotors)))


def test_what_it_cannot_fly_is_refused() -> None:
    with pytest.raises(UsageError, match="a fixed_wing is flown by no PX4 here"):
        prepared(load_scenario("mixed_team"), ("planes",), "x500", RATE)
    with pytest.raises(UsageError, match="a rover is flown by no PX4 here"):
        prepared(load_scenario("mixed_team"), ("rovers",), "x500", RATE)


def test_periods_that_are_no_whole_number_of_ticks_become_one() -> None:
    content = {**PAIR, "fleets": {"field": {**PAIR["fleets"]["field"], "sensors": {"magnetometer": {
        "type": "magnetometer", "period": 0.01}}}}, "time_step": 0.01}  # fmt: skip
    fleet = world_of(content)
    assert {type(sensor).__name__: sensor.period for sensor in fleet.sensors}["Magnetometer"] == 0.008


@pytest.mark.long
def test_sensors_that_px4_needs_are_asked_for_by_name() -> None:
    """A fleet that is fed with the truth still needs sensors: PX4 takes equal readings for a failure."""
    field = {
        "vehicle": {"type": "multirotor", "model": "x500"},
        "controller": {"type": "cascade", "feed": "truth"},
        "vehicles": [{"position_ned": [0.0, 0.0, -0.2]}],
    }
    content: dict[str, Any] = {"name": "bare", "duration": 10.0}
    with pytest.raises(UsageError, match="fleet 'pelicans' has no gyroscope, and an autopilot needs one: add a sensor"):
        Flown({**content, "fleets": {"pelicans": {**field, "sensors": {"gnss": {"type": "gnss_receiver"}}}}})
    imu = {"imu": {"type": "imu"}}
    with pytest.raises(
        UsageError, match=r"no GNSS receiver, .*; --set 'fleets\.pelicans\.sensors\.gnss={type: gnss_rec"
    ):
        Flown({**content, "fleets": {"pelicans": {**field, "sensors": imu}}})
    imu = {"imu": {"type": "ideal_imu"}, "gnss": {"type": "gnss_receiver"}}
    with (
        pytest.warns(UserWarning, match="no magnetometer, and PX4 knows no heading"),
        pytest.warns(UserWarning, match=r"ideal sensors \(imu\) repeat themselves at rest"),
    ):
        flown = Flown({**content, "fleets": {"pelicans": {**field, "sensors": imu}}})
    told = flown.flight.parameters()[0]
    flown.flight.close()
    assert [told[name] for name in ("SYS_HAS_MAG", "SYS_HAS_BARO", "EKF2_HGT_REF")] == [0, 0, 1]
