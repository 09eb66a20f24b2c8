"""Flights of PX4's stand-ins that the tests share."""

from __future__ import annotations

from typing import Any

import numpy as np
from px4_stand_in import Px4StandIn, free_ports

from qrsim.links.autopilot.px4_flight import Px4Flight, prepared
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

RATE = 250.0
# Of the scenarios below: 2026-06-21, 10:00 UTC.
START_USEC = 1_782_036_000_000_000
# Two vehicles with all sensors that PX4 takes.
PAIR: dict[str, Any] = {
    "name": "pair",
    "extends": "mavlink_field",
    "fleets": {
        "field": {
            "vehicles": [{"position_ned": [0.0, east, -0.2]} for east in (0.0, 8.0)],
            "sensors": {"range": {"type": "rangefinder"}, "flow": {"type": "optical_flow"}},
        }
    },
}


class Flown:
    """A flight of the pair, and what it says."""

    def __init__(self, content: Any = PAIR, seed: int = 3, **options: Any):
        scenario, fleets = prepared(load_scenario(content, quiet=True), (), "x500", RATE)
        self.simulation = Simulation(scenario.world(), seed=seed, name=scenario.name, site=scenario.site)
        self.simulation.reset()
        self.said: list[str] = []
        self.port = free_ports(self.simulation.size)
        options = {"wait": 20.0, "say": self.said.append, **options}
        self.flight = Px4Flight(self.simulation, fleets, START_USEC, self.port, **options)

    def fly(self, seconds: float, **options: Any) -> list[Px4StandIn]:
        """Fly with a stand-in for each vehicle; an option may be a list of one for each."""
        pilots = []
        for i in range(self.simulation.size):
            own = {name: value[i] if isinstance(value, list) else value for name, value in options.items()}
            pilots.append(Px4StandIn(self.port + i, i, **own))
            pilots[-1].start()
        with self.flight:
            self.flight.advance(round(seconds * RATE))
        for pilot in pilots:
            pilot.stop.set()
            pilot.join(10.0)
            assert pilot.problem == ""
        return pilots

    @property
    def state(self) -> np.ndarray:
        return np.asarray(self.simulation.packed[1][0]).copy()

    @property
    def heights(self) -> list[float]:
        return (-np.asarray(self.simulation.truth.position_ned)[:, 2]).tolist()


def own(geometry: str, rotors: int, count: int | None = None) -> dict[str, Any]:
    numbers = {"mass": 2.0, "arm": 0.25, "hover_throttle": 0.5, "thrust_to_weight": 2.0, "attitude_bandwidth": 8.0}
    vehicle = {"type": "multirotor", "own": {**numbers, "rotors": rotors, "geometry": geometry}, "model": None}
    places = [{"position_ned": [0.0, 20.0 * i, -50.0]} for i in range(count or rotors)]
    fleet = {"vehicle": vehicle, "vehicles": places}
    return {"name": "geometry", "extends": "mavlink_field", "world": {"wind": {"type": "calm"}, "turbulence": {
        "type": "still"}}, "fleets": {"field": fleet}}  # fmt: skip


def world_of(content: Any) -> Any:
    """Return the only fleet of a scenario, not compiled."""
    return prepared(load_scenario(content, quiet=True), (), "x500", RATE)[0].world().fleets[0]
