"""Scenarios for tests: the default one with changes, and a quiet one to fly into trouble.

Each structure of a world costs seconds to compile, so the tests share these few.
"""

from __future__ import annotations

from typing import Any

from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.reading import read_scenario
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.simulation import Simulation


def noisy(*, vehicle_more: bool = False, fleet_more: bool = False, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the default scenario, which has every kind of noise, with something added or taken away.

    Its five vehicles, fleet pelicans, are the same whatever else is there; a second fleet comes before theirs.
    """
    _, content = read_scenario("patrol_published")
    pelicans = content["fleets"]["pelicans"]
    for sensor in without:
        del pelicans["sensors"][sensor]
    if vehicle_more:
        pelicans["vehicles"].append({"position_ned": [80.0, 80.0, -30.0]})
    if fleet_more:
        others = {
            "controller": {"type": "waypoint", "feed": "truth"},
            "sensors": {"barometer": {"type": "barometer"}},
            "vehicles": [{"position_ned": [-80.0, 80.0, -15.0]}],
        }
        content["fleets"] = {"others": others, "pelicans": pelicans}
    return content


def simulate(content: dict[str, Any], **options: Any) -> Simulation:
    """Return the simulation of a scenario, reset."""
    precision = options.pop("precision", "float32")
    simulation = Simulation(load_scenario(content).world(precision), **options)
    simulation.reset()
    return simulation


# (start, waypoint, velocity in body axes): three that fly side by side, and two elsewhere.
Flight = tuple[list[float], list[float], list[float]]
STILL = [0.0, 0.0, 0.0]
ALPHA: list[Flight] = [([0.0, 10.0 * i, -20.0], [20.0, 10.0 * i, -22.0], STILL) for i in range(3)]
BRAVO: list[Flight] = [([-20.0, -20.0 * i, -10.0], [-20.0, -20.0 * i, -12.0], STILL) for i in range(2)]


def quiet(alpha: list[Flight] | None = None, bravo: list[Flight] | None = None, **parts: Any) -> dict[str, Any]:
    """Return a scenario of two fleets without wind or noise, in a box of 100 x 100 x 40 m with one mast.

    However the numbers are chosen, it is one and the same program.

    Args:
        alpha: three flights on the truth, with sensors of three periods.
        bravo: two flights on the truth, with one sensor and a battery.
        parts: vehicle, limits and battery of fleet bravo.
    """
    sensors = {
        "gyroscope": {"type": "ideal_gyroscope"},
        "barometer": {"type": "ideal_barometer", "period": 0.06},
        "gnss": {"type": "ideal_gnss"},
    }
    bounds = {"x_min": -50.0, "x_max": 50.0, "y_min": -50.0, "y_max": 50.0, "z_min": -40.0, "z_max": 0.0}
    return {
        "name": "quiet",
        "duration": 10.0,
        "world": {
            "area": {"type": "box", **bounds},
            "obstacles": [{"type": "cylinder", "x": -40.0, "y": 40.0, "radius": 1.0, "z_min": -30.0}],
        },
        "fleets": {
            "alpha": _quiet_fleet(sensors, alpha or ALPHA, {}),
            "bravo": _quiet_fleet({"height": {"type": "ideal_barometer"}}, bravo or BRAVO, parts),
        },
    }


def _quiet_fleet(sensors: dict[str, Any], flights: list[Flight], parts: dict[str, Any]) -> dict[str, Any]:
    return {
        "vehicle": {"type": "pelican", "process_noise": 0.0, **parts.get("vehicle", {})},
        "controller": {"type": "waypoint", "feed": "truth"},
        "limits": parts.get("limits", {}),
        "battery": {"type": "lithium_polymer", **parts.get("battery", {})},
        "sensors": sensors,
        "vehicles": [
            {"position_ned": start, "waypoints_ned": [waypoint], "velocity_body": velocity}
            for start, waypoint, velocity in flights
        ],
    }


def pair(**parts: Any) -> Scenario:
    """Return two vehicles that take every kind of set-point, on ideal sensors in still air, with process noise.

    Args:
        parts: in place of those here; other numbers are one and the same program.
    """
    routes = [[[6.0, 0.0, -10.0], [6.0, 5.0, -11.0]], [[6.0, 9.0, -12.0]]]
    starts = [[0.0, 0.0, -10.0], [0.0, 9.0, -12.0]]
    given = {
        "vehicles": [
            {"position_ned": start, "waypoints_ned": route} for start, route in zip(starts, routes, strict=True)
        ],
        "name": "pair",
        "duration": 10.0,
        "controller": "offboard",
        "area": {"type": "box", "x_min": -40.0, "x_max": 40.0, "y_min": -40.0, "y_max": 40.0, "z_min": -40.0},
    }
    return make_scenario(**given | parts)


def noisy_pair(**parts: Any) -> Scenario:
    """Return the pair on noisy sensors, in wind and gusts."""
    air = {
        "wind": {"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 225.0},
        "turbulence": "dryden_first_order",
        "sky": {"errors": {"type": "ou", "std": 1.5}},
    }
    sensors = {"gnss": "gnss_receiver", "barometer": "barometer", "attitude": "attitude_estimator"}
    return pair(**{"sensors": sensors, "name": "noisy_pair", **air, **parts})


def bare_pair(**parts: Any) -> Scenario:
    """Return the pair on the truth, without sensors: the quickest to compile."""
    return pair(**{"sensors": {}, "controller": {"type": "offboard", "feed": "truth"}, "name": "bare_pair", **parts})
