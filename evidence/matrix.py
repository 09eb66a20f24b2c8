"""Shipped vehicles under every suitable controller and sensor set, in wind: flights completed and tracking error.

A flight is completed if the vehicle does not stop and reaches the end of its route. A flight counts as possible if
loading the scenario gives no warning about the wind.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

import qrsim
from qrsim.scenarios.sensor_sets import ESTIMATOR, SETS
from qrsim.world.state import State

DOC = "vehicles x controllers x winds x sensors x routes: share of flights completed, and tracking error"
SEED = 20261126
WINDS = (0.0, 3.0, 6.0, 9.0)
SEEDS = 3
OWN: dict[str, Any] = {
    "mass": 1.2,
    "arm": 0.225,
    "rotors": 4,
    "hover_throttle": 0.5,
    "thrust_to_weight": 2.2,
    "attitude_bandwidth": 8.0,
}
VEHICLES: dict[str, dict[str, Any]] = {
    "pelican": {"vehicle": "pelican", "ground": "parked"},
    "x500": {"vehicle": {"type": "multirotor", "model": "x500"}},
    "hexa4": {"vehicle": {"type": "multirotor", "model": "hexa4"}},
    "hummingbird": {"vehicle": {"type": "multirotor", "model": "hummingbird"}},
    "crazyflie": {"vehicle": {"type": "multirotor", "model": "crazyflie"}},
    "own": {"vehicle": {"type": "multirotor", "own": OWN}},
    "rover": {"vehicle": "rover"},
    "fixed_wing": {"vehicle": "fixed_wing"},
}
CONTROLLERS = {"pelican": ("cascade", "waypoint"), "rover": ("rover",), "fixed_wing": ("fixed_wing",)}
HEIGHT = 20.0
# Duration of a route [s].
ROUTES = {"hover": 30.0, "short_legs": 60.0, "long_legs": 120.0, "take_off_and_land": 90.0}
AIRSPEED = {"ideal": "ideal_airspeed", "noisy": "airspeed"}


def square(side: float, down: float) -> list[list[float]]:
    """Return the corners of a square [m], NED, the start last."""
    return [[side, 0.0, down], [side, side, down], [0.0, side, down], [0.0, 0.0, down]]


def vehicle_of(kind: str, controller: str, route: str) -> dict[str, Any]:
    """Return start and route of a vehicle."""
    if kind == "rover":
        sides = {"hover": [], "short_legs": square(5.0, 0.0)}.get(route, square(30.0, 0.0))
        return {"position_ned": [0.0, 0.0, 0.0], "waypoints_ned": sides}
    if kind == "fixed_wing":
        sides = {"hover": [], "short_legs": square(300.0, -80.0)[:2]}.get(route, square(500.0, -80.0)[:3])
        return {"position_ned": [0.0, 0.0, -80.0], "waypoints_ned": sides}
    if route == "take_off_and_land" and controller != "waypoint":
        legs = [{"type": "take_off", "height": HEIGHT}, {"to_ned": [40.0, 0.0, -HEIGHT]}, {"type": "land"}]
        return {"position_ned": [0.0, 0.0, 0.0], "on_ground": True, "legs": legs}
    sides = {"hover": [], "short_legs": square(5.0, -HEIGHT)}.get(route, square(60.0, -HEIGHT))
    return {"position_ned": [0.0, 0.0, -HEIGHT], "waypoints_ned": sides}


def scenario(kind: str, controller: str, sensors: str, route: str, wind: float) -> tuple[Any, bool]:
    """Return a scenario, and whether its check calls the flight possible."""
    fleet: dict[str, Any] = {**VEHICLES[kind], "controller": {"type": controller}}
    if controller == "cascade":
        fleet["guidance"] = {"type": "mission"}
    elif controller == "waypoint":
        fleet["guidance"] = {"type": "route", "repeat": False}
    elif kind == "fixed_wing":
        # The tightest circle that 9 m/s allows has a radius of 183 m.
        fleet["guidance"] = {"type": "fixed_wing", "radius": 200.0}
    chosen: dict[str, Any] = dict(SETS[sensors])
    if kind == "fixed_wing":
        chosen["airspeed"] = AIRSPEED[sensors]
    if controller in ("waypoint", "rover", "fixed_wing"):
        # They are fed with measured attitudes.
        chosen["attitude"] = "ideal_attitude" if sensors == "ideal" else "attitude_estimator"
    elif sensors == "noisy":
        fleet["estimator"] = ESTIMATOR
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = qrsim.make_scenario(
            [vehicle_of(kind, controller, route)],
            name=f"{kind}_{route}",
            duration=ROUTES[route],
            sensors=chosen,
            area={"type": "box", "x_min": -2000.0, "x_max": 2000.0, "y_min": -2000.0, "y_max": 2000.0},
            wind={"type": "log_shear", "speed_20ft": wind, "wind_from_deg": 225.0},
            turbulence="dryden_field",
            **fleet,
        )
    return made, not any("world.wind" in str(each.message) for each in told)


def progress(state: State) -> Any:
    """Return how many waypoints or legs each vehicle has reached."""
    return state.fleets[0].guidance.reached


def flights(kind: str, controller: str, sensors: str, route: str, winds: tuple[float, ...], seeds: int) -> list[Any]:
    """Return a row for each wind."""
    made = [scenario(kind, controller, sensors, route, wind) for wind in winds]
    ticks = round(ROUTES[route] / made[0][0].spec.time_step)
    worlds = [each.world() for each, _ in made for _ in range(seeds)]
    numbers = [SEED + seed for _ in made for seed in range(seeds)]
    flown = qrsim.rollout(worlds, ticks=ticks, seeds=numbers, record=progress, record_every=ticks)
    wanted = len(vehicle_of(kind, controller, route).get("waypoints_ned", ()))
    reached = np.asarray(flown.recorded)[:, -1, 0] >= wanted
    done = (flown["reason"][:, 0] == 0) & (flown["unfinished"][:, 0] == 0) & reached
    rows = []
    for i, (_, possible) in enumerate(made):
        own = slice(seeds * i, seeds * (i + 1))
        error = float(np.nanmean(flown["tracking_error_rms_m"][own, 0]))
        why = sorted({reason for world in range(own.start, own.stop) for reason in flown.reasons(world) if reason})
        rows.append(
            {
                "vehicle": kind,
                "controller": controller,
                "sensors": sensors,
                "route": route,
                "wind_m_s": winds[i],
                "possible": possible,
                "completed": int(done[own].sum()),
                "flights": seeds,
                "tracking_error_m": error,
                "stopped": why[:2],
            }
        )
    return rows


def rows_of(full: bool) -> list[dict[str, Any]]:
    """Fly the matrix and return a row for each vehicle, controller, sensor set, route and wind."""
    kinds = tuple(VEHICLES) if full else ("pelican", "hexa4")
    routes = tuple(ROUTES) if full else ("take_off_and_land",)
    winds, seeds = (WINDS, SEEDS) if full else ((0.0, 6.0), 1)
    return [
        row
        for kind in kinds
        for controller in CONTROLLERS.get(kind, ("cascade",))[: None if full else 1]
        for sensors in (SETS if full else ("noisy",))
        for route in routes
        for row in flights(kind, controller, sensors, route, winds, seeds)
    ]


def failed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows whose flights are possible and were not all completed."""
    return [row for row in rows if row["possible"] and row["completed"] < row["flights"]]


def counted(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts of flights, and the mean tracking errors of those that are possible by their sensors."""
    possible = [row for row in rows if row["possible"]]
    found: dict[str, Any] = {
        "flights": sum(row["flights"] for row in rows),
        "possible": sum(row["flights"] for row in possible),
        "completed": sum(row["completed"] for row in possible),
    }
    for sensors in SETS:
        errors = [row["tracking_error_m"] for row in possible if row["sensors"] == sensors]
        if errors:
            found[f"{sensors}_m"] = round(float(np.mean(errors)), 2)
    return found


def run(full: bool) -> dict[str, Any]:
    """Return counts and tracking errors, in all and by vehicle with its controller and by wind."""
    rows = rows_of(full)
    crews = dict.fromkeys((row["vehicle"], row["controller"]) for row in rows)
    winds = dict.fromkeys(row["wind_m_s"] for row in rows)

    def own(vehicle: str, controller: str, wind: float) -> list[dict[str, Any]]:
        wanted = (vehicle, controller, wind)
        return [row for row in rows if (row["vehicle"], row["controller"], row["wind_m_s"]) == wanted]

    return {
        "all": counted(rows),
        "by_vehicle": {
            "_".join(dict.fromkeys(crew)): {f"wind_{wind:g}": counted(own(*crew, wind)) for wind in winds}
            for crew in crews
        },
    }
