"""Fixed wings flown by their controller: lines, circles, heights and airspeeds in wind, measured and true."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import qrsim
from qrsim.control import Estimate, TrackSetpoint
from qrsim.control.fixed_wing import FixedWingController
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.vehicles.fixed_wing import FixedWing
from qrsim.scenarios.derived import derived_of

BOX = {
    "type": "box",
    "x_min": -2000.0,
    "x_max": 6000.0,
    "y_min": -2000.0,
    "y_max": 2000.0,
    "z_min": -300.0,
    "z_max": 0.0,
}
TRUTH = {"type": "fixed_wing", "feed": "truth"}


def scenario(wind: dict[str, Any] | None = None, **fleet: Any) -> dict[str, Any]:
    own = {"vehicle": {"type": "fixed_wing"}, "controller": TRUTH, "vehicles": [{"position_ned": [0.0, 0.0, -100.0]}]}
    world = {"area": BOX, "wind": wind or {"type": "calm"}}
    return {"name": "x", "duration": 120.0, "world": world, "fleets": {"planes": {**own, **fleet}}}


def steady(folder: Path, north: float, east: float) -> dict[str, Any]:
    """Return a wind of one velocity everywhere."""
    path = folder / "wind.csv"
    path.write_text(f"time,north,east,down\n0,{north},{east},0\n200,{north},{east},0\n")
    return {"type": "series", "file": str(path), "max_gap": 300.0}


# Published for this law: rms distance from a line, and from a circle of 150 m, in 0, 8 and 12 m/s across.
TRACKS = [(0.0, 0.07, 1.2), (8.0, 0.21, 1.7), (12.0, 0.32, 7.8)]


def in_steady_wind(folder: Path, north: float, east: float, vehicles: list[Any]) -> Any:
    """Return a simulation of two, which is one and the same program."""
    # A scenario would refuse a circle of 150 m in 12 m/s; a set-point may ask for it.
    fleet = {"vehicles": vehicles, "guidance": {"type": "fixed_wing", "radius": 200.0}}
    simulation = qrsim.load(scenario(steady(folder, north, east), **fleet))
    simulation.reset()
    return simulation


@pytest.mark.long
@pytest.mark.parametrize(("wind", "line", "circle"), TRACKS)
def test_beside_lines_and_circles_in_wind(tmp_path: Path, wind: float, line: float, circle: float) -> None:
    """Rms from 25 s on within 20 %; 100 m, then 120 m at 30 s; 25 m/s, then 30 m/s at 70 s.

    The first flies north along a line from 60 m east of it; the second begins on the circle, downwind.
    """
    centre = np.array([-1000.0, -1000.0])
    vehicles = [{"position_ned": [0.0, 60.0, -100.0]}, {"position_ned": [-850.0, -1000.0, -100.0], "yaw_deg": 90.0}]
    simulation = in_steady_wind(tmp_path, 0.0, wind, vehicles)
    rows = []
    for k in range(6000):
        z, speed = (-100.0 if k < 1500 else -120.0), (25.0 if k < 3500 else 30.0)
        begin, end = np.array([[-100.0, 0.0, z], [*centre, z]]), np.array([[5000.0, 0.0, z], [*centre, z]])
        numbers: list[Any] = [np.array([0.0, 150.0]), np.full(2, speed), np.zeros(2)]
        simulation.advance(qrsim.TrackSetpoint(qrsim.Vec3(*begin.T), qrsim.Vec3(*end.T), *numbers))
        places = simulation.truth.position_ned
        airspeed = np.asarray(simulation.state.fleets[0].vehicle.airspeed)
        away = np.hypot(*(places[1, :2] - centre)) - 150.0
        rows.append([[places[0, 1], away], -places[:, 2], airspeed])
    offset_m, height, fast = np.moveaxis(np.array(rows), 0, -1)
    np.testing.assert_allclose(np.sqrt(np.mean(offset_m[:, 1250:] ** 2, axis=1)), [line, circle], rtol=0.2)
    # Settled before the speed changes: 0.05 m published, a little more while it banks in and out.
    np.testing.assert_allclose(np.mean(height[:, 2900:3500], axis=1), 120.0, atol=0.1)
    assert np.max(height[:, 1500:3500]) - 120.0 < 0.85
    np.testing.assert_allclose(np.mean(fast[:, 2900:3500], axis=1), 25.0, atol=0.1)
    np.testing.assert_allclose(np.mean(fast[:, 5250:], axis=1), 30.0, atol=0.1)


@pytest.mark.long
def test_it_starts_in_level_flight_at_its_airspeed_whatever_the_wind(tmp_path: Path) -> None:
    """At 25 m/s where none is given, at 30 m/s where that is; the ground goes by faster downwind."""
    vehicles = [
        {"position_ned": [0.0, 0.0, -100.0]},
        {"position_ned": [0.0, 300.0, -100.0], "yaw_rad": 1.5707963, "velocity_body": [30.0, 0.0, 0.0]},
    ]
    simulation = in_steady_wind(tmp_path, 8.0, -3.0, vehicles)
    truth, state = simulation.truth, simulation.state.fleets[0].vehicle
    np.testing.assert_allclose(truth.velocity_ned, [[33.0, -3.0, 0.0], [8.0, 27.0, 0.0]], atol=1e-4)
    np.testing.assert_allclose(state.airspeed, [25.0, 30.0], rtol=1e-6)
    # The angles of attack of the trims at 100 m.
    np.testing.assert_allclose(truth.attitude[:, 1], [0.0539, 0.0241], atol=6e-4)
    simulation.advance(ticks=100)
    # The second has energy to spare, which the controller's 25 m/s turns into height.
    assert abs(simulation.truth.position_ned[0, 2] + 100.0) < 0.05


@pytest.mark.long
def test_a_route_ends_in_a_circle_and_sensors_fly_it() -> None:
    """Through two waypoints and round the last one, by noisy sensors in turbulence; it is near the circle then."""
    sensors = {
        "gnss": {"type": "gnss_receiver"},
        "barometer": {"type": "barometer"},
        "attitude": {"type": "attitude_estimator"},
        "airspeed": {"type": "airspeed"},
    }
    route = [[600.0, 0.0, -100.0], [600.0, 500.0, -120.0]]
    fleet = {
        "controller": {"type": "fixed_wing"},
        "sensors": sensors,
        "guidance": {"type": "fixed_wing", "radius": -180.0},
    }
    vehicles = [{"position_ned": [0.0, 0.0, -100.0], "waypoints_ned": route}]
    world = scenario({"type": "log_shear", "speed_20ft": 4.0, "wind_from_deg": 300.0}, **fleet, vehicles=vehicles)
    world["world"]["turbulence"] = {"type": "dryden"}
    simulation = qrsim.load(world, seed=2)
    simulation.reset()
    simulation.advance(ticks=4000)
    places = []
    for _ in range(40):
        simulation.advance(ticks=50)
        places.append(simulation.truth.position_ned[0])
    away = np.array(places) - route[-1]
    assert simulation.reasons == [""]
    np.testing.assert_allclose(np.hypot(away[:, 0], away[:, 1]), 180.0, atol=20.0)
    assert np.abs(away[:, 2]).max() < 8.0
    # Against the clock, as its radius is negative.
    assert (np.diff(np.unwrap(np.arctan2(away[:, 1], away[:, 0]))) < 0.0).all()
    assert int(np.asarray(simulation.state.fleets[0].guidance.reached)[0]) == 2


def round_a_waypoint(wind: float, vehicles: list[Any]) -> dict[str, Any]:
    """Return two in gusts that circle 180 m from where they are told to go; all are one and the same program."""
    blown = {"type": "log_shear", "speed_20ft": wind, "wind_from_deg": 200.0}
    content = scenario(blown, guidance={"type": "fixed_wing", "radius": 180.0}, vehicles=vehicles)
    content["world"]["turbulence"] = {"type": "dryden"}
    return {**content, "duration": 20.0}


@pytest.mark.long
def test_a_circle_is_tracked_by_the_distance_from_it(tmp_path: Path) -> None:
    """In metrics and in the summary of a run, not by that from its centre."""
    from qrsim.runs.summary import summarise

    vehicles = [{"position_ned": [0.0, y - 180.0, -100.0], "waypoints_ned": [[0.0, y, -100.0]]} for y in (0.0, 1000.0)]
    world = round_a_waypoint(0.0, vehicles)
    metrics = qrsim.rollout(world, ticks=1000).metrics
    # They start on the circle, level, and take their bank within a second or two.
    assert np.all((metrics["tracking_error_rms_m"] > 0.1) & (metrics["tracking_error_rms_m"] < 3.0))
    qrsim.fly(qrsim.load_scenario(world), tmp_path / "run", seed=0, precision="float32")
    run = qrsim.open_run(tmp_path / "run")
    found = [each.tracking_error_rms_m for each in summarise(run)]
    assert found == pytest.approx(metrics["tracking_error_rms_m"][0], rel=1e-3)


@pytest.mark.long
def test_rollouts_have_the_bits_of_a_simulation_and_surfaces_fly_too() -> None:
    vehicles = [
        {"position_ned": [0.0, y, -100.0 - y / 30.0], "waypoints_ned": [[400.0, y, -100.0]]} for y in (0.0, 300.0)
    ]
    world = round_a_waypoint(3.0, vehicles)
    kept = qrsim.rollout(
        world, ticks=200, worlds=3, seed=4, record=lambda state: state.fleets[0].vehicle.position_ned.x
    )
    simulation = qrsim.load(world, seed=4)
    simulation.reset()
    simulation.advance(ticks=200)
    np.testing.assert_array_equal(kept.recorded[0, -1], np.asarray(simulation.state.fleets[0].vehicle.position_ned.x))
    from qrsim.models.vehicles.fixed_wing import SurfaceCommand

    each = [np.full(2, value) for value in (-0.125, 0.1, 0.0, 0.68)]
    before = np.array(simulation.truth.attitude[:, 0])
    simulation.advance(SurfaceCommand(*each), ticks=25)  # type: ignore[arg-type]
    # Ailerons alone roll it to the right.
    assert (simulation.truth.attitude[:, 0] - before > 0.2).all()


@pytest.mark.long
def test_show_says_what_level_flight_takes() -> None:
    """The trims at 25 m/s at sea level, within the 1 % or so of the formulas."""
    found = derived_of(qrsim.load_scenario(scenario()))["planes"]
    assert found["stall_speed_m_s"] == pytest.approx(11.5, abs=0.05)
    assert found["cruise_throttle"] == pytest.approx(0.775341, rel=0.01)
    assert found["cruise_angle_of_attack_rad"] == pytest.approx(0.052986, rel=0.01)
    assert found["cruise_elevator_rad"] == pytest.approx(-0.133011, rel=0.015)


def test_the_circle_round_a_waypoint_is_one_that_it_can_fly() -> None:
    """25² m²/s² / (9.81 m/s² tan 40°) = 75.9 m; the guidance ``route`` gives places, not circles."""
    tight = {"type": "fixed_wing", "feed": "truth", "loiter_radius": 60.0}
    vehicles = [{"position_ned": [0.0, 0.0, -100.0], "waypoints_ned": [[300.0, 0.0, -100.0], [300.0, 300.0, -100.0]]}]
    fleet = {
        "vehicle": {"type": "fixed_wing"},
        "controller": tight,
        "guidance": {"type": "route"},
        "vehicles": vehicles,
    }
    area = {
        "type": "box",
        "x_min": -900.0,
        "x_max": 900.0,
        "y_min": -900.0,
        "y_max": 900.0,
        "z_min": -300.0,
        "z_max": 0.0,
    }
    source = {"name": "x", "duration": 10.0, "world": {"area": area}, "fleets": {"planes": fleet}}
    with pytest.raises(ScenarioError, match=r"planes\.controller\.loiter_radius: 60 m is tighter .* at least 76, or"):
        qrsim.load_scenario(source)
    tight["loiter_radius"] = 80.0
    assert qrsim.load_scenario(source).name == "x"


@pytest.mark.long
def test_a_route_goes_on_from_the_circle_round_a_place() -> None:
    """Two places 400 m apart, at 25 m/s, with circles of 150 m: a waypoint counts within 3 m of its circle."""
    places = [[300.0, 0.0, -100.0], [300.0, 400.0, -100.0]]
    vehicles = [{"position_ned": [0.0, 0.0, -100.0], "waypoints_ned": places}]
    simulation = qrsim.load(scenario(guidance={"type": "route"}, vehicles=vehicles))
    simulation.reset()
    reached, nearest = [], [9e9, 9e9]
    for _ in range(60):
        for _ in range(50):
            simulation.step()
        reached.append(int(np.asarray(simulation.state.fleets[0].guidance.reached)[0]))
        here = simulation.truth.position_ned[0]
        nearest = [min(near, float(np.hypot(*(here - place)[:2]))) for near, place in zip(nearest, places, strict=True)]
    # 300 m less 153 m at 25 m/s are 6 s; from there the other circle is 275 m away, 11 s and a turn.
    assert reached[4] == 0
    assert reached[7] == 1
    assert reached[15] == 1
    assert reached[25] == 2
    assert reached[-1] >= 4
    assert max(nearest) < 160.0


def test_faults_of_a_scenario_are_said_in_a_line() -> None:
    wind = {"type": "log_shear", "speed_20ft": 6.0, "wind_from_deg": 270.0}
    slow = [{"position_ned": [0.0, 0.0, -100.0], "velocity_body": [8.0, 0.0, 0.0]}]
    with pytest.raises(ScenarioError) as caught:
        qrsim.load(scenario(wind, guidance={"type": "fixed_wing", "radius": 60.0}, vehicles=slow))
    assert caught.value.problems == [
        "fleets.planes.vehicles.0.velocity_body: starts at an airspeed of 8 m/s ahead, which is below its stall at "
        "11.5 m/s; allowed: above that; without it, it starts at 25 m/s",
        "fleets.planes.guidance.radius: 60 m is tighter than the wind allows: at an airspeed of 25 m/s in 9.43 m/s of "
        "wind a bank of 40 deg flies a circle of 144 m downwind; allowed: at least 145, or less airspeed",
    ]
    with pytest.raises(ScenarioError, match=r"no sensor gives true_airspeed; add one of type airspeed"):
        qrsim.load(scenario(controller={"type": "fixed_wing"}))
    with pytest.raises(ScenarioError, match=r"controller.airspeed: 9 m/s is below its stall"):
        qrsim.load(scenario(controller={**TRUTH, "airspeed": 9.0}))
    with pytest.raises(ScenarioError, match=r"'lithium_polymer' is drained by a thrust"):
        qrsim.load(scenario(battery={"type": "lithium_polymer"}))
    with pytest.raises(UsageError, match=r"a Command is not for the vehicles of fleet 'planes', which take"):
        qrsim.load(scenario()).step(qrsim.Command(*(np.zeros(1) for _ in range(5))))  # type: ignore[arg-type]


def test_rolls_to_the_right_by_hand() -> None:
    """Northwards at 25 m/s: L1 = 12 s 0.75/pi 25 m/s, a = 4 0.75^2 v^2/L1 sin(eta), roll = atan(a/g), at most 45 deg.

    To a line 20 m to the left of it, to one far away, along it, and straight to a place where there is no line.
    """
    lengths = 12.0 * 0.75 / math.pi * 25.0
    begins = np.array([[0.0, -20.0, 0.0], [0.0, 900.0, 0.0], [0.0, 0.0, 0.0], [400.0, 80.0, 0.0]])
    ends = np.array([[1000.0, -20.0, 0.0], [1000.0, 900.0, 0.0], [1000.0, 0.0, 0.0], [400.0, 80.0, 0.0]])
    with jax.enable_x64(True):
        still, north = np.zeros((4, 3)), np.tile([25.0, 0.0, 0.0], (4, 1))
        controller = FixedWingController().fitted(FixedWing())
        turn = jax.jit(lambda seen, track: controller.step(controller.init(seen), seen, track, 0.02)[1].roll)
        found = turn(Estimate.of(still, north, still), TrackSetpoint.line(begins, ends))
    wanted = [math.atan(4.0 * 0.5625 * 625.0 / lengths * sine / 9.81) for sine in (-20.0 / lengths, 80 / 407.92156)]
    np.testing.assert_allclose(found, [wanted[0], math.pi / 4, 0.0, wanted[1]], rtol=1e-6, atol=1e-9)
