"""Rovers driven by their controller: lines, circles, stops, places, velocities and paths."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest

import qrsim
from qrsim.control import Estimate, TrackSetpoint, VelocitySetpoint
from qrsim.control.rover import RoverController
from qrsim.errors import ScenarioError, UsageError

TRUTH = {"type": "rover", "feed": "truth"}
EAST = np.array([0.0, 500.0, 0.0])


def scenario(vehicle: Any = "rover", **fleet: Any) -> dict[str, Any]:
    own = {"vehicle": {"type": vehicle}, "controller": TRUTH, "vehicles": [{"position_ned": [0.0, 3.0, 0.0]}]}
    return {"name": "x", "duration": 30.0, "fleets": {"cars": {**own, **fleet}}}


def both(cars: list[Any], tracks: list[Any] | None = None, **fleet: Any) -> dict[str, Any]:
    """Return a scenario of a fleet of each kind of rover; however the numbers are chosen, it is one program.

    Args:
        cars: steered vehicles.
        tracks: those that turn on the spot; by default the same, 500 m further east.
        fleet: what both have.
    """
    wide = {"type": "box", "x_min": -6e4, "x_max": 6e4, "y_min": -6e4, "y_max": 6e4, "z_min": -100.0, "z_max": 0.0}
    own = {"controller": TRUTH, **fleet}
    fleets = {
        "cars": {**own, "vehicle": {"type": "rover"}, "vehicles": cars},
        "tracks": {
            **own,
            "vehicle": {"type": "differential_rover"},
            "vehicles": tracks or [farther_east(v) for v in cars],
        },
    }
    return {"name": "x", "duration": 30.0, "world": {"area": wide, "collision_distance": 0.2}, "fleets": fleets}


def farther_east(vehicle: dict[str, Any]) -> dict[str, Any]:
    """Return the same vehicle with its route, 500 m further east."""
    return {name: (np.array(value) + EAST).tolist() for name, value in vehicle.items()}


def at(*places: list[float]) -> list[Any]:
    return [{"position_ned": place} for place in places]


@pytest.mark.long
def test_pure_pursuit_of_a_line_from_three_metres_beside_it() -> None:
    """The published number of the law at 2.5 m/s: 0.000 m after 10 s, overshoot 0.13 m; and a circle within 3 %."""
    world = both(at([0.0, 3.0, 0.0], [0.0, -40.0, 0.0]))
    line, circle = np.zeros((2, 3)), np.array([[400.0, 0.0, 0.0], [0.0, -50.0, 0.0]])

    def policy(reading: Any) -> Any:
        numbers: list[Any] = [np.array([0.0, -10.0]), np.full(2, 2.5), np.zeros(2)]
        return qrsim.TrackSetpoint(qrsim.Vec3(*line.T), qrsim.Vec3(*circle.T), *numbers)

    flight = qrsim.play(world, {"cars": policy}, ticks=1500, policy_ticks=1500, record_every=10)
    beside_line = flight.position_ned[:, 0, 1]
    assert abs(beside_line[50]) < 0.01
    assert -np.min(beside_line) == pytest.approx(0.13, abs=0.03)
    away = np.hypot(flight.position_ned[75:, 1, 0], flight.position_ned[75:, 1, 1] + 50.0)
    np.testing.assert_allclose(away, 10.0, rtol=0.03)
    # Against the clock as seen from above.
    out = flight.position_ned[75:, 1] - circle[1]
    swing = np.diff(np.unwrap(np.arctan2(out[:, 1], out[:, 0])))
    assert (swing < 0.0).all()


def test_it_stops_at_the_last_waypoint_and_comes_to_a_place_inside_its_turning_circle() -> None:
    """Steering for a place 0.75 m beside it at the lookahead's curvature, 1/0.75 m, would go round it for ever."""
    places = np.array([[0.0, 0.75], [0.0, -0.4], [0.1, 0.6], [-0.3, 0.35], [0.3, 1.2]])
    starts = [[0.0, 10.0 * i, 0.0] for i in range(len(places))]
    targets = np.array([[*place, 0.0] for place in places]) + starts
    cars = [
        {"position_ned": start, "waypoints_ned": [target.tolist()]}
        for start, target in zip(starts, targets, strict=True)
    ]
    cars.append({"position_ned": [0.0, -60.0, 0.0], "waypoints_ned": [[20.0, -60.0, 0.0], [20.0, -45.0, 0.0]]})
    simulation = qrsim.load(both(cars, guidance={"type": "rover", "repeat": False}))
    simulation.reset()
    simulation.advance(ticks=1500)
    truth = simulation.truth
    for fleet in (slice(0, 6), slice(6, 12)):
        where = truth.position_ned[fleet] - (0.0 if fleet.start == 0 else EAST)
        np.testing.assert_allclose(where[:5], targets, atol=0.3)
        np.testing.assert_allclose(where[5], [20.0, -45.0, 0.0], atol=0.35)
    np.testing.assert_allclose(truth.velocity_ned, 0.0, atol=1e-3)


@pytest.mark.long
def test_places_velocities_and_missions() -> None:
    world = both(at([0.0, 3.0, 0.0], [0.0, -40.0, 0.0]))

    def flown(setpoint: Any) -> Any:
        told = {"cars": lambda reading: setpoint(0.0), "tracks": lambda reading: setpoint(EAST)}
        return qrsim.play(world, told, ticks=1000, policy_ticks=1000, record_every=50)

    place = np.array([[-10.0, 3.0, 0.0], [-10.0, -40.0, 0.0]])
    flight = flown(lambda east: qrsim.WaypointSetpoint.of(place + east))
    np.testing.assert_allclose(flight.position_ned[-1], [*place, *(place + EAST)], atol=0.35)
    flight = flown(lambda east: qrsim.VelocitySetpoint.of([[-1.0, 1.0, 0.0]] * 2))
    np.testing.assert_allclose(flight.velocity_ned[-1], [[-1.0, 1.0, 0.0]] * 4, atol=0.02)
    legs = [{"to_ned": [20, 3, 0], "speed": 2.0}, {"to_ned": [20, 20, 0], "speed": 2.0, "stop": True}]
    each = {"position_ned": [0, 3, 0], "legs": legs}
    further = [{**leg, "to_ned": (np.array(leg["to_ned"]) + EAST).tolist()} for leg in legs]
    simulation = qrsim.load(both([each], [{"position_ned": [0.0, 503.0, 0.0], "legs": further}]))
    simulation.reset()
    simulation.advance(ticks=1500)
    where = [[20.0, 20.0, 0.0], [20.0, 520.0, 0.0]]
    np.testing.assert_allclose(simulation.truth.position_ned, where, atol=0.5)


@pytest.mark.long
def test_it_drives_slowly_far_away_and_its_floor_is_no_margin() -> None:
    """0.2 m/s at 49 km in single precision, where a step is less than its rounding: 2 m less the lag in 10 s."""
    world = both(at([49_000.0, 0.0, 0.0], [49_000.0, 50.0, 0.0]))

    def north(reading: Any) -> Any:
        return qrsim.VelocitySetpoint.of([[0.2, 0.0, 0.0]] * 2)

    told = {"cars": north, "tracks": north}
    flight = qrsim.play(world, told, ticks=500, policy_ticks=500, record_every=500)
    assert flight.position_ned[-1, 0, 0] - 49_000.0 == pytest.approx(1.991, abs=1e-3)
    # Who drives on the floor of the area is not for that at its edge.
    assert np.isnan(qrsim.rollout(world, ticks=10).metrics["fence_distance_min_m"]).all()


def test_faults_of_a_scenario_are_said_in_a_line() -> None:
    with pytest.raises(ScenarioError) as caught:
        qrsim.load(scenario(vehicles=[{"position_ned": [0.0, 0.0, -10.0]}]))
    assert caught.value.problems == [
        "fleets.cars.vehicles.0.position_ned: z = -10 m, but a 'rover' drives on the ground; expected z = 0, or "
        "on_ground: true"
    ]
    with pytest.raises(ScenarioError, match="controller: 'cascade' does not fly a 'rover'; allowed: rover"):
        qrsim.load({**scenario(controller={"type": "cascade"})})
    simulation = qrsim.load(scenario(vehicles=[{"position_ned": [0.0, 0.0, 5.0], "on_ground": True}]))
    assert simulation.reset() is not None
    assert simulation.truth.position_ned[0, 2] == 0.0
    with pytest.raises(UsageError, match=r"steering of vehicle 0 .* is 1; allowed: -0.8 to 0.8"):
        simulation.step(np.array([[1.0, 0.0]]))
    assert math.isfinite(simulation.truth.position_ned[0, 0])


class Told:
    """A vehicle that repeats what it is told."""

    def drive(self, speed: Any, curvature: Any) -> Any:
        return speed, curvature


class TestByHand:
    """One step of a rover that stands at a place and looks north, with the documented constants of (D7) to (D9)."""

    def told(self, setpoint: Any, at: Any = (0.0, 0.0, 0.0), **changes: float) -> list[float]:
        with jax.enable_x64(True):
            still = np.zeros((1, 3))
            estimate = Estimate.of(np.array([at]), still, still)
            controller = RoverController(nominal=Told(), **changes)  # type: ignore[arg-type]
            step = jax.jit(lambda seen, wanted: controller.step(controller.init(seen), seen, wanted, 0.02)[1])
            return [float(number[0]) for number in step(estimate, setpoint)]

    @staticmethod
    def line(end: float, stops: float = 0.0) -> Any:
        return TrackSetpoint.line(np.zeros((1, 3)), np.array([[end, 0.0, 0.0]]), stops=stops)

    def test_line(self) -> None:
        """2 m/s; from 3 m to the right, for a point 0.75 m along it: 2 sin/1.5 m, and sqrt(3 / that)."""
        assert self.told(self.line(100.0)) == pytest.approx([2.0, 0.0])
        sine = 3.0 / math.hypot(3.0, 0.75)
        curvature = 2.0 * sine / 1.5
        beside = self.told(self.line(100.0), (0.0, 3.0, 0.0))
        assert beside == pytest.approx([math.sqrt(3.0 / curvature), -curvature])

    def test_stop(self) -> None:
        """With 1 m/s^2 from sqrt(2) m/s one metre before it, at rest within 0.3 m."""
        assert self.told(self.line(1.0, 1.0)) == pytest.approx([math.sqrt(2.0), 0.0])
        assert self.told(self.line(0.31, 1.0)) == pytest.approx([math.sqrt(0.62), 0.0])
        assert self.told(self.line(0.29, 1.0)) == [0.0, 0.0]

    def test_circle(self) -> None:
        """On it, the arc through the point 1.5 m ahead is its own: 1/10 m, to the right where it is clockwise."""
        for side in (1.0, -1.0):
            orbit = TrackSetpoint.orbit(np.array([[0.0, 10.0 * side, 0.0]]), 10.0 * side)
            assert self.told(orbit) == pytest.approx([2.0, 0.1 * side])

    def test_velocity(self) -> None:
        """Eastwards while it looks north: 0.3 of 1.5 m/s, and 2 /s times pi/2 at half a metre per second.

        That is within 0.5 m/s, so 0.2 /s times 0.02 s of it come on top.
        """
        assert self.told(VelocitySetpoint.of(np.array([[1.5, 0.0, 0.0]]))) == pytest.approx([1.5, 0.0])
        assert self.told(VelocitySetpoint.of(np.array([[0.0, 1.5, 0.0]]))) == pytest.approx(
            [0.45 * 1.004, 2.0 * math.pi]
        )

    def test_a_turn_wider_than_a_kilometre_is_one_of_a_kilometre(self) -> None:
        """So a side acceleration of 0.001 m/s^2 allows 1 m/s straight ahead."""
        assert self.told(self.line(100.0), side_acceleration=1e-3) == pytest.approx([1.0, 0.0])
        north = VelocitySetpoint.of(np.array([[1.5, 0.0, 0.0]]))
        assert self.told(north, side_acceleration=1e-3) == pytest.approx([1.0, 0.0])
