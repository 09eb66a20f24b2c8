"""The example of Symington et al., IROS 2014: one Pelican between random waypoints; only GNSS has errors.

A flight belongs to a seed: waypoints, landmarks, guesses and the noise of the ranges are the same in all its flights,
which differ in the errors of the GNSS receiver that the vehicle flies with.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.noise import Draw, ou_step
from qrsim.core.tree import parameter, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import RunError
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.sensors.contracts import Sensor
from qrsim.scenarios.scenario import load_scenario
from qrsim.scenarios.sky_of_receivers import ERRORS, ORBITS
from qrsim.simulation.rollout import rollout
from qrsim.studies.slam import ranging
from qrsim.studies.slam.flight import SIZE, Believed, Flight, Floats, make_flight, ticks_between
from qrsim.studies.slam.ranging import Ranging
from qrsim.world.sensing import measured_quantities
from qrsim.world.state import State, World, period_ticks

SCENARIO, DURATION, STATE_PERIOD, HEIGHT = "range_only_slam", 120.0, 0.1, 20.0
ROUTE = 60
# A time constant so short that nothing is left of an error after one period of the receiver.
WHITE = 1e-3
CENTRE = np.zeros(2)
# Of receivers of type gnss, by preset: the time in which the correlation of their errors falls to 1/e [s].
MEMORY = {"m8n": 5000.0, "f9p_single": 4000.0, "f9p_sbas": 700.0, "f9p_rtk": 30.0, "gps_2011": 5000.0}


@record
class CorrelatedGnss(Sensor):
    """A receiver with Ornstein-Uhlenbeck errors north and east; white for time constants far below a period.

    Down and the velocity are true: the published white noise is in latitude and longitude only.
    """

    std_north: Array = parameter(unit="m", doc="standard deviation of the error north", minimum=0.0)
    std_east: Array = parameter(unit="m", doc="standard deviation of the error east", minimum=0.0)
    time_constant: Array = parameter(unit="s", doc="of both errors", above=0.0)
    period: float = setting(default=0.2, unit="s", doc="interval between fixes", above=0.0)
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned", "sky")
    normals: ClassVar[int] = 2

    def init(
        self, draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: object
    ) -> tuple[tuple[Array, Array], GnssReading]:
        """Draw initial GNSS errors from their stationary distribution, and report the first fix."""
        north, east = draw.normals(2)
        return self._reading((self.std_north * north, self.std_east * east), position_ned, velocity_ned)

    def step(
        self, state: tuple[Array, Array], draw: Draw, position_ned: Vec3, velocity_ned: Vec3, sky: object
    ) -> tuple[tuple[Array, Array], GnssReading]:
        """Advance the GNSS errors by one period and return the fix of vehicles at position_ned (n,)."""
        north, east = draw.normals(2)
        error = (
            ou_step(state[0], north, self.period, self.std_north, self.time_constant),
            ou_step(state[1], east, self.period, self.std_east, self.time_constant),
        )
        return self._reading(error, position_ned, velocity_ned)

    @staticmethod
    def _reading(error: tuple[Array, Array], position: Vec3, velocity: Vec3) -> tuple[tuple[Array, Array], GnssReading]:
        """Return the errors, and the fix of vehicles at a position (n,) with these errors."""
        zero = jnp.zeros_like(position.x)
        place = Vec3(position.x + error[0], position.y + error[1], position.z)
        return error, GnssReading(place, velocity, zero, zero, zero)


def _record(state: State) -> dict[str, Array]:
    """Return name -> array (k, n) of the values that a ``Flight`` needs: truth, estimates, command, stop code."""
    fleet = state.fleets[0]
    seen = measured_quantities(fleet.readings)
    velocity, attitude = seen["velocity_ned"], seen["attitude"]
    position = seen["position_ned"]
    rows = {
        "truth": jax.tree.leaves(fleet.vehicle),
        "position_ned": (position.x, position.y, -seen["height"]),
        "velocity_ned": (velocity.x, velocity.y, -seen["height_rate"]),
        "attitude": (attitude.roll, attitude.pitch, attitude.yaw),
        "rates_body": jax.tree.leaves(seen["rates_body"]),
        "command": jax.tree.leaves(fleet.command),
        "code": (fleet.violation.code.astype(position.x.dtype),),
    }
    return {name: jnp.stack(parts) for name, parts in rows.items()}


def base_world(precision: str = "float32", gnss: str | None = None, **overrides: object) -> World:
    """Return the world of the example study of SLAM, before its waypoints are drawn; ``gnss`` is a preset.

    Args:
        precision: float32 or float64.
        gnss: preset of a receiver of type gnss to fly with, under the sky that it is made for; None: the published one.
        overrides: assign scenario values, with double underscores for dots.
    """
    assignments = [f"{name.replace('__', '.')}={value}" for name, value in overrides.items()]
    return load_scenario(SCENARIO if gnss is None else with_receiver(gnss), assignments).world(precision)


def with_receiver(preset: str) -> dict[str, object]:
    """Return the example's scenario content with a GNSS receiver preset and, if that needs one, a base station.

    Nothing of it is late, as in the example, and carrier phase is fixed.
    """
    sensor = {"type": "gnss", "preset": preset, "delay": 0, "first_fix": "fixed"}
    return {
        "name": SCENARIO,
        "extends": SCENARIO,
        "world": {"sky": {"orbits": ORBITS, "errors": ERRORS}, "base_station": {"position_ned": [0.0, 0.0, -2.0]}},
        "fleets": {"pelicans": {"sensors": {"gnss": sensor}}},
    }


def world_of(base: World, seed: int, vehicles: Sequence[int] = (0,)) -> World:
    """Return the world ``base`` with waypoints drawn from a seed; each vehicle starts at its first waypoint.

    Args:
        base: with as many vehicles as are given.
        seed: of the waypoints.
        vehicles: their numbers; the waypoints and the height of each are its own.
    """
    routes = [ranging.draw_landmarks(seed, ranging.WAYPOINTS, ROUTE, CENTRE, ranging.SIDE, i) for i in vehicles]
    heights = [np.full(ROUTE, -height_of(i)) for i in vehicles]
    fleet = base.fleets[0]
    dtype = fleet.start.position_ned.x.dtype
    north, east = ([route[:, axis] for route in routes] for axis in (0, 1))
    columns: list[Any] = [np.stack(each, axis=1).astype(dtype) for each in (north, east, heights)]
    route = replace(
        fleet.route,
        position_ned=Vec3(*columns),
        yaw=np.zeros((ROUTE, len(vehicles)), dtype),
        count=np.full_like(fleet.route.count, ROUTE),
    )
    start = replace(fleet.start, position_ned=Vec3(*(column[0] for column in columns)))
    return replace(base, fleets=(replace(fleet, route=route, start=start),))


def height_of(vehicle: int) -> float:
    """Return the height [m] of a vehicle's waypoints: 20, 19, 21, 18, 22, ... for vehicles 0, 1, 2, ..."""
    away = 0.5 * (vehicle + 1) if vehicle % 2 else -0.5 * vehicle
    return HEIGHT - away


def with_correlated(world: World, std: npt.ArrayLike, time_constant: float) -> World:
    """Return a world with a GNSS receiver of correlated errors: deviations (2,) [m] and a time constant [s]."""
    fleet = world.fleets[0]
    dtype = fleet.start.position_ned.x.dtype
    at = fleet.sensor_names.index("gnss")
    numbers = (*np.asarray(std, dtype), np.asarray(time_constant, dtype))
    receiver = CorrelatedGnss(numbers[0], numbers[1], numbers[2], fleet.sensors[at].period)
    sensors = (*fleet.sensors[:at], receiver, *fleet.sensors[at + 1 :])
    return replace(world, fleets=(replace(fleet, sensors=sensors),))


def coloured_flights(
    seeds: Sequence[int], duration: float = DURATION, state_period: float = STATE_PERIOD, base: World | None = None
) -> list[Flight]:
    """Fly the example with each seed, with the correlated GNSS errors of the simulator's sky and receiver."""
    base = base_world() if base is None else base
    return flown_alone("coloured", [world_of(base, seed) for seed in seeds], seeds, duration, state_period)


def correlated_flights(
    seeds: Sequence[int],
    coloured: Sequence[Flight],
    time_constant: float = WHITE,
    duration: float = DURATION,
    state_period: float = STATE_PERIOD,
    base: World | None = None,
) -> list[Flight]:
    """Fly the example with each seed, with GNSS errors of another correlation time [s], white by default.

    The deviations are the root mean square errors, north and east, of the coloured flight of the same seed.
    """
    base = base_world() if base is None else base
    stds = [np.sqrt(np.mean(np.square(flight.fix_error), axis=0)) for flight in coloured]
    worlds = [with_correlated(world_of(base, seed), std, time_constant) for seed, std in zip(seeds, stds, strict=True)]
    name = "white" if time_constant == WHITE else f"{time_constant:g} s"
    return flown_alone(name, worlds, seeds, duration, state_period)


def flown_alone(
    name: str, worlds: list[World], seeds: Sequence[int], duration: float, state_period: float
) -> list[Flight]:
    """Fly worlds of one vehicle; return a flight for each seed; raises RunError if a vehicle stops."""
    return [flights[0] for flights in flown_together(name, worlds, seeds, duration, state_period)]


def flown_together(
    name: str, worlds: list[World], seeds: Sequence[int], duration: float, state_period: float
) -> list[list[Flight]]:
    """Fly worlds of N vehicles; return a list of N flights for each seed; raises RunError if a vehicle stops."""
    first = worlds[0]
    ticks = ticks_between(state_period, first.time_step)
    flown = rollout(
        worlds,
        ticks=ticks_between(duration, first.time_step, "duration"),
        seeds=list(seeds),
        record=_record,
        record_every=1,
    )
    found = list(flown.recorded.items())
    return [
        [
            _flight_of(name, world, seed, {key: np.asarray(rows[i, ..., n], np.float64) for key, rows in found}, ticks)
            for n in range(world.fleets[0].size)
        ]
        for i, (world, seed) in enumerate(zip(worlds, seeds, strict=True))
    ]


def _flight_of(name: str, world: World, seed: int, recorded: dict[str, Floats], ticks: int) -> Flight:
    """Build a vehicle's ``Flight`` from recorded arrays of its world; raises RunError if the vehicle stopped."""
    stopped = recorded.pop("code")[:, 0] != 0.0
    if stopped.any():
        raise RunError(f"{name}, seed {seed}: the vehicle stopped at {np.argmax(stopped) * world.time_step:g} s")
    fleet = world.fleets[0]
    gnss = fleet.sensors[fleet.sensor_names.index("gnss")]
    truth, commands = recorded.pop("truth"), recorded.pop("command")
    assert truth.shape[1] == SIZE
    believed = Believed(**recorded)
    epochs = np.arange(0, len(truth), period_ticks(gnss.period, world.time_step))
    fixes = (epochs, believed.position_ned[epochs, :2])
    air = np.zeros((len(truth), 3))
    model: Any = fleet.vehicle
    return make_flight(f"{name}, seed {seed}", world.time_step, ticks, model, truth, believed, commands, air, fixes)


def ranging_of(flight: Flight, seed: int, std: float = ranging.RANGE_STD, vehicle: int = 0) -> Ranging:
    """Simulate a flight's ranges to the landmarks of its seed; the noise follows from seed and vehicle alone."""
    landmarks, guesses = ranging.landmarks_of(seed, CENTRE), ranging.guesses_of(seed, CENTRE)
    return ranging.measure_ranges(flight.truth[:, :3], landmarks, guesses, seed, std, ranging.RANGE_LIMIT, vehicle)
